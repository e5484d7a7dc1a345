"""What goes wrong in a failing drive: the words are those of the numbers, and the numbers those of
the drives.
"""

from dataclasses import replace
from math import inf, nan
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from drives import drive, moved, moved_ego, scenario
from hypothesis import given, strategies as st

from replan.experiments.drives import CUT, DrivenLogs, cut_short, worse_peak
from replan.experiments.failure import (
    LATE_S,
    MISSED_M,
    STAYS_M,
    DriveDifference,
    DriveFailure,
    Foresight,
    GoalMiss,
    lane_change,
    waits,
)
from replan.experiments.failure_words import OUTCOMES, DriveFault
from replan.explain.causes import Account, Cause, CauseKind
from replan.explain.course import Course, PlanAction
from replan.logs.agents import AgentKind
from replan.logs.frame import Predictions
from replan.logs.plan import LaneOption, Plan
from replan.logs.road import Goal
from replan.logs.states import Trajectory
from replan.logs.trace import EndReason, PlannedFrame, Trace
from replan.metrics.cut_in import AS_LOGGED_M, SAME_PLACE_M, made_way, unseen
from replan.metrics.judge import Outcome, load_gates
from replan.metrics.route_gain import RoutePace

T = np.arange(0.0, 6.0 + 1e-9, 0.01)
V = 10.0


def braked(at: float, decel: float, left: float = 0.0) -> Trajectory:
    """Straight on; from a time on it brakes; from 1 s on it is `left` m to the left."""
    v = np.maximum(V - decel * np.maximum(T - at, 0.0), 0.0)
    a = np.where((at < T) & (v > 0.0), -decel, 0.0)
    x = np.r_[0.0, np.cumsum(0.5 * np.diff(T) * (v[1:] + v[:-1]))]
    return Trajectory(T, x, np.where(T > 1.0, left, 0.0), 0.0 * T, v, a, 0.0 * T)


AS_LOGGED = braked(9.0, 0.0)
LOG = scenario(AS_LOGGED)
"""Six seconds straight on."""


def compared_drives(
    failing: Trajectory, passing: Trajectory, until: float = inf
) -> DriveDifference:
    return DriveDifference.of(drive(LOG, failing), drive(LOG, passing), until)


@given(
    st.floats(0.5, 3.0),
    st.floats(-0.5, 2.0),
    st.floats(1.0, 4.0),
    st.floats(0.2, 1.0),
    st.floats(-3.0, 3.0),
)
def test_faults_of_braking_are_those_of_the_drives(
    at: float, late: float, decel: float, share: float, turn: float
) -> None:
    passing, failing = braked(at, decel), braked(at + late, share * decel)
    difference = compared_drives(failing, passing)
    fault = difference.fault
    if fault is not DriveFault.NONE:
        assert difference.would_brake_s == pytest.approx(at, abs=0.02) and difference.ahead_m > 0.0
    if fault in (DriveFault.BRAKES_LATE, DriveFault.BRAKES_WEAKLY):
        assert difference.brakes_s == pytest.approx(at + late, abs=0.02)
        assert difference.hardest_mps2 == pytest.approx(-share * decel, abs=1e-6)
    assert fault is not DriveFault.BRAKES_LATE or late > LATE_S - 0.02
    assert fault is not DriveFault.BRAKES_WEAKLY or share < 1.0
    assert fault is not DriveFault.DOES_NOT_BRAKE or share * decel <= 0.5
    failed, passed = (
        drive(moved(LOG, turn, 3.0, 4.0), moved_ego(ego, turn, 3.0, 4.0))
        for ego in (failing, passing)
    )
    assert DriveDifference.of(failed, passed, inf).fault is fault, "wherever the scene lies"


@pytest.mark.parametrize(
    ("failing", "passing", "until", "fault"),
    [
        (braked(3.0, 4.0), braked(2.0, 4.0), inf, DriveFault.BRAKES_LATE),
        (braked(3.0, 4.0), braked(2.0, 4.0), 2.9, DriveFault.BRAKES_LATE),
        (AS_LOGGED, braked(2.0, 4.0), 2.9, DriveFault.DOES_NOT_BRAKE),
        (braked(2.0, 2.0), braked(2.0, 4.0), inf, DriveFault.BRAKES_WEAKLY),
        (braked(2.0, 1.0), braked(2.0, 4.0), 2.1, DriveFault.NONE),
        (braked(2.0, 4.0), AS_LOGGED, inf, DriveFault.NONE),
        (AS_LOGGED, braked(9.0, 0.0, 0.5), inf, DriveFault.KEEPS_RIGHT),
        (AS_LOGGED, braked(9.0, 0.0, -0.5), 3.0, DriveFault.KEEPS_LEFT),
    ],
)
def test_the_fault_of_two_drives(
    failing: Trajectory, passing: Trajectory, until: float, fault: DriveFault
) -> None:
    difference = compared_drives(failing, passing, until)
    assert difference.fault is fault
    if fault in (DriveFault.KEEPS_LEFT, DriveFault.KEEPS_RIGHT):
        assert difference.aside_m == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("fact", "words", "numbers"),
    [
        (
            DriveDifference(1.0, 0.0, 3.0, 2.0),
            "brakes late",
            "brakes at 3.0 s instead of 2.0 s",
        ),
        (
            DriveDifference(1.0, 0.0, 2.0, 2.0, -2.0, -4.0),
            "brakes too weakly",
            "brakes with 2.0 m/s² instead of 4.0 m/s²",
        ),
        (
            GoalMiss(5.0, 0.0, 2.0, ("place",)),
            "keeps too far right",
            "has its goal 2.0 m to its left at 5.0 s",
        ),
        (
            GoalMiss(5.0, 0.0, 0.0, ("time", "speed")),
            "misses the time and speed of its goal",
            "is at its goal's place at 5.0 s, not by time and speed",
        ),
        (Foresight(1.0, False), " not seen", "not seen at 1.0 s"),
    ],
)
def test_the_words_of_a_fault_have_the_numbers_of_its_fact(
    fact: DriveDifference | GoalMiss | Foresight, words: str, numbers: str
) -> None:
    assert (fact.fault.words(fact), fact.fault.numbers(fact)) == (words, numbers)


def shown(speed: float, predicted: float, off: float = 0.0, *, seen: bool = True) -> Trace:
    """A pedestrian who walks across, predicted at 1 s to walk at another speed, and shown beside
    their place.
    """
    log = scenario(
        LOG.ego,
        [
            (
                "ped 7",
                AgentKind.PEDESTRIAN,
                (0.5, 0.5),
                lambda t: (20.0 + 0.0 * t, speed * t, 0.0 * t),
            )
        ],
    )
    t = 1.0 + np.arange(0.0, 8.0 + 1e-9, 0.5)
    y = speed + off + predicted * (t - 1.0)
    rows = np.zeros((2, len(t)))
    some = Predictions(
        t,
        np.zeros(2, np.int64),
        np.array([0.2, 0.8]),
        20.0 + 0.0 * rows,
        np.array([9.0 + y, y]),
        rows,
        "hand",
    )
    frame = PlannedFrame(1.0, Plan(log.ego), ("ped 7",) if seen else (), some)
    return drive(log, frames=(frame,))


@given(st.floats(0.0, 2.0), st.floats(0.0, 2.0), st.floats(-2.0, 2.0), st.booleans())
def test_the_fault_of_a_prediction_is_its_error(
    speed: float, predicted: float, off: float, seen: bool
) -> None:
    foresight = Foresight.of(shown(speed, predicted, off, seen=seen), "ped 7", 1.3)
    if not seen:
        assert foresight.fault is DriveFault.NOT_SEEN
        return
    assert foresight.seen_off_m == pytest.approx(abs(off), abs=1e-5)
    assert foresight.moved_m == pytest.approx(
        3.0 * speed, abs=1e-5
    ) and foresight.off_m == pytest.approx(3.0 * abs(speed - predicted), abs=1e-5)
    if foresight.fault is DriveFault.PREDICTED_TO_STAND:
        assert 3.0 * predicted < STAYS_M + 1e-5 and 3.0 * speed > MISSED_M - 1e-5
    if foresight.fault is DriveFault.PREDICTED_TO_MOVE:
        assert 3.0 * speed < STAYS_M + 1e-5 and 3.0 * predicted > MISSED_M - 1e-5
    is_right = foresight.seen_off_m <= MISSED_M and foresight.off_m <= MISSED_M
    assert (foresight.fault is DriveFault.NONE) == is_right


def test_the_foresight_of_an_absent_road_user_is_empty() -> None:
    trace = shown(1.0, 0.0)
    assert Foresight.of(trace, "car 3", 1.0) == Foresight.of(trace, "ped 7", 0.5) == Foresight()
    assert Foresight().fault is DriveDifference().fault is DriveFault.NONE


LATE = compared_drives(braked(3.0, 4.0), braked(2.0, 4.0))
STOOD = Foresight.of(shown(1.0, 0.0), "ped 7", 1.0)
ANY = DriveFailure("collision_at_fault.count <= 0", "collision_at_fault.count")


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({}, "collides with a road user"),
        ({"who": "object 3"}, "collides with an object"),
        (
            {"who": "pedestrian 7", "foresight": STOOD},
            "collides with a pedestrian predicted to stand",
        ),
        (
            {"who": "pedestrian 7", "foresight": STOOD, "difference": LATE},
            "brakes late, and collides with a pedestrian predicted to stand",
        ),
        (
            {"who": "pedestrian 7", "foresight": STOOD, "difference": LATE, "brakes_for": True},
            "brakes late for a pedestrian predicted to stand, and collides with them",
        ),
        (
            {"who": "car 23f7", "lane": "left"},
            "collides with a car while changing to the left lane",
        ),
        ({"metric": "needless_standing.worst_episode"}, "stands although the road is free"),
        (
            {"metric": "red_light.count", "difference": LATE, "brakes_for": True},
            "brakes late, and runs a red light",
        ),
        (
            {
                "metric": "lon_jerk_nuplan.worst_episode",
                "who": "pedestrian 7",
                "difference": LATE,
                "brakes_for": True,
            },
            "brakes late for a pedestrian, and accelerates or brakes too abruptly",
        ),
        ({"metric": "my.metric", "gate": "my.metric < 3"}, "fails my.metric < 3"),
    ],
)
def test_the_sentence_of_a_failure(changes: dict[str, object], sentence: str) -> None:
    failure = replace(ANY, **changes)  # type: ignore[arg-type]
    assert failure.sentence == sentence
    numbers = failure.difference.fault.numbers(failure.difference)
    assert failure.who in failure.details and numbers in failure.details


def test_every_gate_of_ours_has_words() -> None:
    gates = [
        gate
        for gate in load_gates(None).gates
        if gate.over == "worst" and gate.broken == Outcome.FAIL.value
    ]
    assert {gate.metric.partition(".")[0] for gate in gates} <= set(OUTCOMES)


def test_a_lane_change_is_that_of_the_plan() -> None:
    options = (LaneOption("keep", (), "slower"), LaneOption("left", ()))
    frames = PlannedFrame(0.0, Plan(LOG.ego)), PlannedFrame(1.0, Plan(LOG.ego, internals=options))
    trace = drive(LOG, frames=frames)
    assert [lane_change(trace, at) for at in (0.5, 1.5)] == ["", "left"]


# where the time went ------------------------------------------------------------------------------


@given(
    st.lists(
        st.tuples(st.sampled_from(["17", "18", ""]), st.floats(-1.0, 2.0)), min_size=1, max_size=12
    )
)
def test_lost_time_is_summed_by_cause_less_the_time_made_up(
    steps: list[tuple[str, float]],
) -> None:
    course = Course(PlanAction.HOLDS, 1.0, 1.0, 1.0, 8.0, 0.0, 0.0, 0.0, nan)
    explained = [
        Account(0.5 * k, course, True, (Cause(CauseKind.AGENT, who),) if who else ())
        for k, (who, _) in enumerate(steps)
    ]
    spent = waits(explained, [seconds for _, seconds in steps])
    assert [one.seconds for one in spent] == sorted((one.seconds for one in spent), reverse=True)
    for one in spent:
        lost = [
            (0.5 * k, seconds)
            for k, (who, seconds) in enumerate(steps)
            if who == one.who and seconds > 0.0
        ]
        assert one.since_s == lost[0][0]
        assert one.seconds <= sum(seconds for _, seconds in lost) + 1e-5
    if all(seconds >= 0.0 for _, seconds in steps):
        for one in spent:
            assert one.seconds == pytest.approx(
                sum(each for who, each in steps if who == one.who), abs=1e-5
            )


@given(st.floats(2.0, 9.0), st.floats(0.0, 3.0), st.floats(0.5, 2.5))
def test_the_time_lost_from_frame_to_frame_sums_to_the_delay(
    slow: float, at: float, lasts: float
) -> None:
    v = np.where((at <= T) & (at + lasts > T), slow, V)
    failing = Trajectory(
        T, np.r_[0.0, np.cumsum(0.01 * v[:-1])], 0.0 * T, 0.0 * T, v, 0.0 * T, 0.0 * T
    )
    frames = np.arange(0.0, 6.0, 0.1).tolist()
    lost, wanted = RoutePace.of(AS_LOGGED, LOG).lost(failing, LOG, frames)
    assert sum(lost) == pytest.approx(lasts * (1.0 - slow / V), abs=0.03)
    inside = [at + 0.1 < t < at + lasts - 0.1 for t in frames]
    assert all(each == pytest.approx(V, abs=0.1) for each in wanted[inside]), (
        "the speed that it does not have"
    )
    outside = [not at - 0.1 < t < at + lasts + 0.1 for t in frames]
    assert np.isnan(wanted[outside]).all() and np.abs(lost[outside]).max(initial=0.0) < 0.02
    assert RoutePace.needed(LOG) == RoutePace.of(AS_LOGGED, LOG), "the recorded driver"


@given(
    st.floats(-4.0, 4.0),
    st.floats(-3.0, 20.0),
    st.floats(-3.0, 3.0),
    st.floats(-1e3, 1e3),
    st.floats(0.0, 6.0),
)
def test_a_missed_goal_is_seen_from_the_ego(
    left: float, ahead: float, turn: float, shift: float, speed: float
) -> None:
    middle = LOG.vehicle.axle_to_center
    x, y = AS_LOGGED.x[-1] + middle + ahead, left
    place = np.array([[x, y], [x + 1.0, y], [x + 1.0, y + 1.0], [x, y + 1.0]])
    missed = replace(LOG, goal=Goal((place,), v=(speed, speed)))
    world, ego = moved(missed, turn, shift, -shift), moved_ego(AS_LOGGED, turn, shift, -shift)
    miss = GoalMiss.of(drive(world, ego), world)
    assert miss is not None
    aside = left if left > 0.0 else min(left + 1.0, 0.0)
    if "place" in miss.unmet:
        assert miss.left_m == pytest.approx(aside, abs=1e-3)
        assert miss.ahead_m == pytest.approx(max(ahead, 0.0), abs=0.2)
        assert miss.at_s == pytest.approx(6.0) or ahead < 0.0
    else:
        assert abs(aside) < 1e-3 and ahead <= 0.2 and miss.unmet == ("speed",)
    assert GoalMiss.of(drive(world, ego, end=EndReason.GOAL), world) is None


@given(st.floats(0.0, 4.0), st.floats(-1.0, 1.0))
def test_a_reaction_is_unseen_where_ego_and_road_user_are_as_before(
    off: float, aside: float
) -> None:
    places = -20.0 + V * T, 0.0 * T, 0.0 * T
    shifted = places[0] - np.where(T > 2.5, off, 0.0), *places[1:]
    logged, braking = (
        scenario(AS_LOGGED, [("7", AgentKind.CAR, (4.5, 1.8), lambda t, at=at: at)])
        for at in (places, shifted)
    )
    failing, ego = drive(braking), braked(9.0, 0.0, aside)
    assert unseen(failing, drive(logged), logged.tracks, "7", 2.0)
    assert unseen(failing, drive(logged, ego), logged.tracks, "7", 2.0) == (
        abs(aside) <= SAME_PLACE_M
    )
    assert unseen(failing, drive(braking), logged.tracks, "7", 2.0) == (off <= AS_LOGGED_M)
    assert not unseen(failing, drive(logged), logged.tracks, "8", 2.0)


@given(st.floats(1.0, 6.0), st.floats(0.5, 3.0))
def test_a_road_user_makes_way_by_as_much_as_they_brake_harder_until_the_failure(
    decel: float, at: float
) -> None:
    def behind(hardest: float) -> Trace:
        v = np.maximum(V - hardest * np.maximum(T - at, 0.0), 0.0)
        x = np.r_[0.0, np.cumsum(0.5 * np.diff(T) * (v[1:] + v[:-1]))] - 20.0
        places = x, 0.0 * T + 3.0, 0.0 * T
        return drive(scenario(AS_LOGGED, [("7", AgentKind.CAR, (4.5, 1.8), lambda t: places)]))

    undisturbed, braking = behind(0.0), behind(decel)
    assert made_way(undisturbed, braking, "7", at + 1.0) == pytest.approx(decel, abs=0.05)
    assert made_way(braking, undisturbed, "7", at + 1.0) == pytest.approx(0.0, abs=0.05)
    assert made_way(undisturbed, braking, "7", at - 0.2) == pytest.approx(0.0, abs=0.05)
    assert made_way(undisturbed, braking, "8", at + 1.0) == 0.0


@given(
    st.sampled_from(EndReason),
    st.sampled_from(EndReason),
    st.floats(0.0, 10.0),
    st.floats(0.0, 10.0),
)
def test_a_drive_that_ends_before_the_failure_or_in_another_way_is_no_evidence(
    before: EndReason, now: EndReason, until: float, lasted: float
) -> None:
    cut = cut_short(before.value, until, now.value, lasted)
    assert not cut or now.value in CUT
    assert now.value not in CUT or cut == (before.value not in CUT or lasted < until)
    assert not cut_short(before.value, until, EndReason.GOAL.value, lasted)


def test_a_peak_that_is_farther_out_is_worse() -> None:
    before = {"lon_accel.max_abs": 3.0, "lon_accel.min": -3.0, "gap.min": 0.5}
    assert not worse_peak(before, before) and not worse_peak(before, {})
    assert not worse_peak(
        before, {"lon_accel.max_abs": 3.2, "lon_accel.min": -3.2, "gap.min": 0.46}
    )
    assert worse_peak(before, {"lon_accel.max_abs": 9.0}) and worse_peak(
        before, {"lon_accel.min": -9.0}
    )
    assert worse_peak(before, {"gap.min": 0.4}) and not worse_peak(before, {"gap.min": 5.0})


@pytest.mark.parametrize(
    ("until", "counted"),
    [(inf, {"lon_accel.max", "lon_accel.max_abs"}), (9.0, {"lon_accel.max_abs"})],
)
def test_a_peak_after_the_end_of_the_failing_drive_does_not_count(
    until: float, counted: set[str]
) -> None:
    columns = ["log", "planner", "mode", "metric", "value", "time_s", "available"]
    peaks = (("lon_accel.max", 4.0, 9.5), ("lon_accel.max_abs", 5.0, 2.0), ("ttc.min", 1.0, 2.0))
    rows = pd.DataFrame([("log", "idm", "closed", *peak, True) for peak in peaks], columns=columns)
    results, gate = (
        SimpleNamespace(measured=rows),
        SimpleNamespace(metric="lon_accel.worst_episode"),
    )
    driven = DrivenLogs(results, {"a.mcap": "log"}, "idm", {"gate": gate}, rows)  # type: ignore[arg-type, dict-item]
    assert driven.peaks(Path("a.mcap"), ["gate"], until).keys() == counted
