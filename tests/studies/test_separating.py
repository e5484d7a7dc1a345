"""Planted faults fail logs that `dp_qp` passes without them."""

from pathlib import Path

import pytest

from studies.planted_inputs import driven
from studies.separating import row

FAMILIES = {
    "near_side": "fast_car",
    "short_steps": "hard_braking_lead",
    "green": "two_stop_lines",
    "old": "close_cut_in",
    "left": "rider_at_left_edge",
    "slow_and_forgetful": "late_amber",
}


@pytest.mark.slow
@pytest.mark.nightly
@pytest.mark.parametrize("fault", list(FAMILIES))
def test_a_fault_in_the_input_fails_each_log_of_its_family(fault: str, tmp_path: Path) -> None:
    """And no log of it fails without the fault."""
    family = f"separating/{FAMILIES[fault]}"
    baseline, faulty = (driven(name, tmp_path, 0, family) for name in ("baseline", fault))
    assert row(fault, faulty, baseline)["logs"] == len(baseline.logs)
