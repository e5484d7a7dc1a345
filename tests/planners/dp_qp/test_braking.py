"""How hard to brake: bounds are kept, the mildest rung that holds is driven, hard braking waits
only where it may.
"""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from replan.core.arrays import FloatArray
from replan.planners.dp_qp.speed.qp import BrakingLadder, SolvedSpeed, SpeedProblem, SpeedQpConfig
from replan.planners.frenet.profiles import STEP_S, SpeedLimits
from replan.planners.frenet.st_boundaries import StBoundaries

CONFIG, GAP, MOST = SpeedQpConfig(), 1.0, 9.0
T = STEP_S * np.arange(CONFIG.knots)
END = 300.0


def blocked(low: float, high: float, begin: float, end: float) -> StBoundaries:
    """An agent takes the stations from `low` to `high` m from `begin` to `end` s."""
    taken = (begin - 1e-9 <= T) & (end + 1e-9 >= T)
    lower, upper = (np.where(taken, s, np.nan)[None, :] for s in (low, high))
    return StBoundaries(T, np.zeros(1, np.int64), lower, upper, np.zeros(1), np.ones(1))


def problem(v: float, a: float, upper: FloatArray) -> SpeedProblem:
    return SpeedProblem(
        (v, a), np.zeros(len(T)), upper, np.full(len(T), v + 2.0), v * T, np.full(len(T), v), END
    )


def behind(v: float, blocks: StBoundaries, a: float = 0.0) -> SpeedProblem:
    """The ego stays behind the agent who blocks."""
    return problem(v, a, np.fmin(np.full(len(T), END), blocks.lower[0] - GAP))


LADDER = BrakingLadder(CONFIG, GAP, MOST)


def solved(
    v: float, blocks: StBoundaries, ladder: BrakingLadder = LADDER, *, braked_fully: bool = False
) -> SolvedSpeed:
    """What is driven behind the agent who blocks."""
    return ladder.solve(behind(v, blocks), lambda margins: blocks, braked_fully=braked_fully)


speeds = st.floats(3.0, 20.0)
stations = st.floats(2.0, 80.0)


@given(speeds, stations, st.floats(0.0, 4.0), st.floats(0.2, 6.0))
@settings(max_examples=60, deadline=None)
def test_a_plan_without_last_resort_has_no_contact(
    v: float, s: float, begin: float, lasts: float
) -> None:
    blocks = blocked(s, s + 6.0, begin, begin + lasts)
    found = solved(v, blocks)
    assert found.profile is not None
    if not found.unavoidable:
        assert not blocks.meets(T, found.profile[0])
    kept = found.reason in ("", "hard braking, up to 7.5 m/s2, keeps the distance")
    if kept:
        assert (found.profile[0] <= behind(v, blocks).upper + 0.5 * GAP + 0.06).all()


@given(speeds, stations)
@settings(max_examples=40, deadline=None)
def test_braking_is_comfortable_where_that_suffices(v: float, s: float) -> None:
    blocks = blocked(s, s + 6.0, 0.0, 8.0)
    soft = CONFIG.comfort.braking((v, 0.0), CONFIG.knots, share=0.85)
    found = solved(v, blocks)
    if (soft[0] <= s - GAP).all():
        assert found.reason == "" and found.profile is not None
        assert found.profile[2].min() >= -CONFIG.comfort.decel_mps2 - 0.06


@given(speeds, stations, st.floats(0.3, 3.0), st.booleans())
@settings(max_examples=30, deadline=None)
def test_earlier_solves_do_not_change_a_solution(
    v: float, s: float, before: float, full: bool
) -> None:
    """The same case twice gives the same bits, whatever the ladder solved in between."""
    blocks = blocked(s, s + 6.0, 0.0, 8.0)
    used, new = BrakingLadder(CONFIG, GAP, MOST), BrakingLadder(CONFIG, GAP, MOST)
    first = solved(v, blocks, used, braked_fully=full)
    solved(v, blocked(before, before + 5.0, 0.0, 8.0), used)
    for ladder in (used, new):
        again = solved(v, blocks, ladder, braked_fully=full)
        assert again.reason == first.reason
        np.testing.assert_array_equal(again.profile, first.profile)  # type: ignore[arg-type]


@pytest.mark.parametrize(("begin", "onward"), [(2.0, True), (0.8, False)])
def test_driving_on_instead_of_full_braking_only_where_it_does_not_touch(
    begin: float, onward: bool
) -> None:
    found = solved(14.0, blocked(12.0, 20.0, begin, 8.0))
    assert found.reason.startswith("driving on") is onward
    assert found.unavoidable is not onward


@pytest.mark.parametrize("end", [8.0, 12.0, 15.0, 18.0])
def test_the_end_of_the_path_is_not_driven_over_where_braking_can_keep_it(end: float) -> None:
    """The way is free; the path ends where the car could not steer on."""
    free = StBoundaries(
        T,
        np.zeros(0, np.int64),
        np.empty((0, len(T))),
        np.empty((0, len(T))),
        np.empty(0),
        np.empty(0),
    )
    short = problem(10.0, 0.0, np.full(len(T), end))._replace(end=end)
    found = LADDER.solve(short, lambda margins: free)
    hardest = CONFIG.emergency.braking((10.0, 0.0), CONFIG.knots)
    assert found.profile is not None and found.reason
    assert found.profile[0, -1] <= max(end, hardest[0, -1]) + 0.06


def test_braking_that_ends_in_the_way_before_an_agent_comes_does_not_avoid_them() -> None:
    """The hardest stop comes to rest beyond their way just before they take it.

    Driving on is past it by far more.
    """
    v, stop = 10.0, CONFIG.emergency.braking((10.0, 0.0), CONFIG.knots)[0]
    blocks = blocked(stop[-1] - 4.0, stop[-1] - 0.3, 2.0, 6.0)
    assert not blocks.meets(T, stop) and not blocks.leave(T, stop, 0.0)
    found = solved(v, blocks)
    assert found.reason.startswith("driving on") and not found.unavoidable


def test_full_braking_goes_on_until_the_whole_gap_is_kept() -> None:
    """The hardest planned braking would leave half of the gap: enough to begin with, not enough to
    go back to.
    """
    v = 12.0
    hard = CONFIG.emergency.braking((v, 0.0), CONFIG.knots, share=0.97)[0, -1]
    half, none = (
        blocked(float(hard) + room, hard + 50.0, 0.0, 8.0) for room in (0.7 * GAP, -0.3 * GAP)
    )
    assert "keeps half of the distance" in solved(v, half).reason
    assert solved(v, none).is_full
    assert solved(v, half, braked_fully=True).is_full
    assert not solved(v, half).is_full


SURE = BrakingLadder(CONFIG, GAP, MOST, "piqp")
HARDER = [
    f"hard braking, up to {level.decel_mps2:.1f} m/s2, keeps" for level in CONFIG.ladder()[1:]
]


def mildest(v: float, s: float) -> str:
    """What of the ladder holds first behind who stands from station `s` on, by braking alone: the
    reason's first words.

    Driving on is none of it: who stands there for the whole horizon is met.
    """
    comfort, *harder = CONFIG.ladder()

    def keeps(level: SpeedLimits, share: float, given: float) -> bool:
        return bool(
            (level.braking((v, 0.0), CONFIG.knots, share=share)[0] <= s - GAP + given).all()
        )

    if keeps(comfort, 0.97, 0.5 * GAP):
        return ""
    held = [words for words, level in zip(HARDER, harder, strict=True) if keeps(level, 0.85, 0.0)]
    if held:
        return held[0] + " the distance"
    if keeps(harder[-1], 0.97, 0.0):
        return HARDER[-1] + " the distance"
    return (
        HARDER[-1] + " half of the distance"
        if keeps(harder[-1], 0.97, 0.5 * GAP)
        else "full braking"
    )


@given(st.floats(4.0, 20.0), st.floats(0.3, 1.2))
@settings(max_examples=60, deadline=None)
def test_a_milder_rung_that_holds_is_preferred(v: float, share: float) -> None:
    s = GAP + share * float(CONFIG.comfort.braking((v, 0.0), CONFIG.knots)[0, -1])
    expected = mildest(v, s)
    found = solved(v, blocked(s, END, 0.0, 8.0), SURE)
    assert len(found.reports) <= 1
    assert found.reason.startswith(expected) and bool(found.reason) == bool(expected)


def test_every_rung_is_the_mildest_somewhere() -> None:
    """That is: the law above looks at all of them."""
    stop = float(CONFIG.comfort.braking((14.0, 0.0), CONFIG.knots)[0, -1])
    shares = np.arange(0.2, 1.2, 0.005)
    words = {
        solved(14.0, blocked(GAP + share * stop, END, 0.0, 8.0), SURE).reason for share in shares
    }
    for rung in (*HARDER, f"{HARDER[-1]} half", "full braking, which leaves", "full braking comes"):
        assert any(reason.startswith(rung) for reason in words), rung
    assert "" in words


@pytest.mark.parametrize("v", [4.0, 4.5, 7.5, 10.0])
def test_a_rung_that_holds_has_a_profile(v: float) -> None:
    """At all distances about those where the hardest braking ends: what braking keeps, the QP
    keeps.
    """
    stop = float(CONFIG.emergency.braking((v, 0.0), CONFIG.knots)[0, -1])
    found = [solved(v, blocked(stop + more, END, 0.0, 8.0)) for more in np.arange(-0.5, 4.0, 0.1)]
    assert sum(len(one.reports) for one in found) > 20
    assert [report.status for one in found for report in one.reports if not report.solved] == []
