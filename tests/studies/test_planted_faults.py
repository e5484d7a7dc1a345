"""The study of planted faults: which drives fail for a fault."""

from types import SimpleNamespace
from typing import Any

import pandas as pd

from studies.diagnosis import broken


def run(**outcomes: tuple[str, str]) -> Any:
    """The verdicts of two gates by log."""
    rows = [(log, gate, said) for log, two in outcomes.items() for gate, said in zip("ab", two, strict=True)]
    return SimpleNamespace(verdicts=pd.DataFrame(rows, columns=["log", "gate", "outcome"]))


def test_a_drive_fails_for_a_fault_if_it_passes_all_of_its_gates_without_it() -> None:
    faulty = run(mended=("fail", "pass"), fails=("fail", "fail"), unsure=("fail", "pass"), well=("pass", "pass"))
    sound = run(mended=("pass", "fail"), fails=("pass", "fail"), unsure=("inconclusive", "pass"), well=("pass", "pass"))
    assert broken(faulty, sound) == ["mended"]
