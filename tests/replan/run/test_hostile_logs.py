"""Hostile logs through the command line: judged with a verdict or refused in a line, never anything
else.
"""

from pathlib import Path

import fuzz_evaluate
import pytest


@pytest.mark.slow
@pytest.mark.parametrize(
    ("names", "count"), [("table", 3), pytest.param("", 24, marks=pytest.mark.nightly)]
)
def test_hostile_logs_are_judged_or_refused(tmp_path: Path, names: str, count: int) -> None:
    chosen = [
        case for case in fuzz_evaluate.cases(tmp_path / "made") if case.name.startswith(names)
    ]
    outcomes = fuzz_evaluate.campaign(chosen, count, 23, tmp_path)
    assert set(outcomes) <= set(fuzz_evaluate.GOOD) and outcomes.total() == count
    assert count < 10 or all(outcomes[each] for each in fuzz_evaluate.GOOD)
