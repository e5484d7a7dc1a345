"""The study of planted faults: which drives fail for a fault."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pandas as pd

from studies.diagnosis import broken


def run(**outcomes: tuple[str, str]) -> Any:
    """The verdicts of two gates by log."""
    rows = [(log, gate, said) for log, two in outcomes.items() for gate, said in zip("ab", two, strict=True)]
    return SimpleNamespace(verdicts=pd.DataFrame(rows, columns=["log", "gate", "outcome"]))


def test_a_drive_fails_for_a_fault_if_it_passes_without_it() -> None:
    faulty = run(
        mended=("fail", "pass"), fails=("fail", "fail"), unsure=("fail", "pass"), well=("pass", "pass"),
        otherwise=("fail", "pass"),
    )  # fmt: skip
    sound = run(
        mended=("pass", "inconclusive"), fails=("pass", "fail"), unsure=("inconclusive", "pass"), well=("pass", "pass"),
        otherwise=("pass", "fail"),
    )  # fmt: skip
    assert broken(faulty, sound) == ["mended"]
