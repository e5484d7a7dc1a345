"""Reference drivers against closed forms, the tendencies of the regulation's grids, and what must
not count.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from handmade import drive, lanes_along, scenario, straight, track, tracks
from hypothesis import given, settings, strategies as st

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind
from replan.logs.mcap import read_scenario, write_scenario
from replan.logs.reference_line import ReferenceLine
from replan.logs.scenario import Avoidability, DriverVerdict, References, Scenario
from replan.logs.trace import EndReason, Mode, Trace
from replan.metrics import evaluate
from replan.metrics.driver_models import CC_BRAKE_MPS2, STEP_S, fsm_critical, fsm_proactive
from replan.metrics.reference_drivers import (
    JERK_MPS3,
    MARGINAL_M,
    careful_drive,
    careful_driver,
    fuzzy_driver,
)
from replan.replay.loop.reference_drives import reference_line, with_avoidability

CAR = scenario(drive(straight, 10.0, 1.0)).vehicle
NOSE = CAR.axle_to_front
KMH = 1.0 / 3.6
SIZE = {"length": 4.3, "width": 1.9}
LINE = ReferenceLine.through(np.array([[-50.0, 0.0], [900.0, 0.0]]))
T = np.round(np.arange(0.0, 20.01, 0.1), 9)


ROAD = lanes_along(drive(straight, 20.0, 20.0))


def log(v: float, *agents: dict[str, object]) -> Scenario:
    return scenario(drive(straight, v, 0.5), agents=tracks(*agents), road=ROAD, duration=20.0)


def standing(gap: float, **more: object) -> dict[str, object]:
    """An obstacle whose rear is `gap` m ahead of the ego's front."""
    return track("obstacle", [0.0], [NOSE + gap + 2.15], [0.0], static=True, **SIZE, **more)


def stopping_distance(v: float) -> float:
    """From the begin of the careful driver's braking: a ramp of constant jerk, then a constant
    deceleration.
    """
    ramp = CC_BRAKE_MPS2 / JERK_MPS3
    slower = v - 0.5 * JERK_MPS3 * ramp**2
    assert slower > 0.0
    return v * ramp - JERK_MPS3 * ramp**3 / 6.0 + slower**2 / (2.0 * CC_BRAKE_MPS2)


@given(
    st.floats(8.0, 29.0).filter(lambda v: abs(stopping_distance(v) - 2.0 * v) > 1.5 * v * STEP_S)
)
def test_cc_begins_to_brake_before_an_obstacle_at_ttc_two_seconds(v: float) -> None:
    verdict = careful_driver(log(v, standing(120.0)), LINE)
    assert verdict.outcome is (
        Avoidability.AVOIDABLE if stopping_distance(v) < 2.0 * v else Avoidability.UNAVOIDABLE
    )
    assert verdict.brakes == pytest.approx(120.0 / v - 2.0 + 1.0 / JERK_MPS3, abs=2.0 * STEP_S)


@given(st.floats(5.0, 22.0))
def test_the_nearest_avoidable_obstacle_is_the_distance_of_reaction_and_braking(v: float) -> None:
    """0.4 s and 0.75 s of reaction.

    The released pedal takes off 0.12 m, 0.3 m/s, and the begin of the ramp.
    """
    least, released = (
        1.15 * v + stopping_distance(v),
        0.12 + (0.3 / CC_BRAKE_MPS2 + 0.4 / JERK_MPS3) * v,
    )
    near, far = least - released - 2.0 * STEP_S * v, least + 2.0 * STEP_S * v
    assert careful_driver(log(v, standing(near)), LINE).outcome is Avoidability.UNAVOIDABLE
    if far < 2.0 * v:  # nearer than where it would brake anyway
        assert careful_driver(log(v, standing(far)), LINE).outcome is Avoidability.AVOIDABLE


@given(st.floats(0.0, 80.0), st.floats(0.0, 40.0), st.floats(0.0, 40.0), st.floats(-8.0, 2.0))
def test_fuzzy_measures_lie_between_0_and_1_and_fall_with_the_gap(
    gap: float, v: float, u: float, a: float
) -> None:
    for measure in (lambda g: fsm_proactive(g, v, u), lambda g: fsm_critical(g, v, u, a)):
        values = [measure(gap + more) for more in (0.0, 0.5, 5.0, 50.0)]
        assert all(0.0 <= value <= 1.0 for value in values)
        assert values == sorted(values, reverse=True)
    assert fsm_critical(gap, v, v, a) == 0.0, "without a difference of speed nothing is critical"
    assert fsm_critical(0.0, v + 1e-12, v, 0.0) in (0.0, 1.0), (
        "no division by the difference of speed"
    )


@given(st.floats(1.0, 40.0))
def test_fuzzy_measures_are_1_at_unsafe_and_0_at_safe(v: float) -> None:
    safe, unsafe = 0.75 * v + v * v / 8.0 + 4.0, 0.75 * v + v * v / 12.0 + 2.0
    assert fsm_proactive(safe, v, 0.0) == pytest.approx(0.0, abs=1e-9)
    assert fsm_proactive(unsafe, v, 0.0) == pytest.approx(1.0, abs=1e-9)
    assert fsm_proactive(0.5 * (safe + unsafe), v, 0.0) == pytest.approx(0.5)
    assert fsm_critical(0.75 * v + v * v / 12.0, v, 0.0, 0.0) == pytest.approx(1.0, abs=1e-9)


def cut_in(v: float, gap: float, slower: float, lateral: float) -> Scenario:
    """A car changes from the left lane to the ego's with a constant lateral speed; `gap` when it
    begins, after 1 s.
    """
    u = v - slower
    x = NOSE + v * 1.0 + gap + 2.15 + u * (T - 1.0)
    y = np.clip(3.5 - lateral * np.maximum(T - 1.0, 0.0), 0.0, 3.5)
    return log(v, track("cutter", T, x, y, **SIZE))


@pytest.fixture(scope="module")
def grid() -> dict[str, np.ndarray]:
    """Who gets through at 60 km/h, over gaps (rows) and differences of speed (columns).

    With smaller gaps and greater differences the ego would be past before the other is in its lane.
    """
    gaps, slower = np.arange(15.0, 61.0, 5.0), np.arange(10.0, 51.0, 5.0) * KMH
    found = {}
    for name, driver in (("cc", careful_driver), ("fsm", fuzzy_driver)):
        outcomes = [
            [driver(cut_in(60.0 * KMH, g, d, 1.2), LINE).outcome for d in slower] for g in gaps
        ]
        found[name] = np.array(
            [[outcome is not Avoidability.UNAVOIDABLE for outcome in row] for row in outcomes]
        )
    return found


def test_cut_ins_get_worse_with_a_smaller_gap_and_a_greater_difference_of_speed(
    grid: dict[str, np.ndarray],
) -> None:
    for through in grid.values():
        assert (through[:-1] <= through[1:]).all(), "a larger gap never harms"
        assert (through[:, 1:] <= through[:, :-1]).all(), "a faster leader never harms"
        assert not through[0, -1], "15 m at 50 km/h of difference"
        assert through[-1].all(), "60 m"
        assert through[:, 0].all(), "10 km/h of difference"


def test_fsm_gets_through_where_cc_does(grid: dict[str, np.ndarray]) -> None:
    assert (grid["fsm"] >= grid["cc"]).all()
    assert (grid["fsm"] > grid["cc"]).any(), "it anticipates"


def mirrored(made: Scenario) -> Scenario:
    flipped = replace(made.tracks, y=-made.tracks.y, yaw=-made.tracks.yaw, vy=-made.tracks.vy)
    return replace(made, tracks=flipped)


@settings(max_examples=15)
@given(st.floats(10.0, 60.0), st.floats(3.0, 14.0), st.floats(0.5, 2.0))
def test_the_mirrored_log_gets_the_same_verdict(gap: float, slower: float, lateral: float) -> None:
    made = cut_in(16.7, gap, slower, lateral)
    for driver in (careful_driver, fuzzy_driver):
        one, two = driver(made, LINE), driver(mirrored(made), LINE)
        assert (one.outcome, one.reason) == (two.outcome, two.reason)


# --- known cases


def braking_lead(v: float, gap: float, decel: float, to: float = 0.0) -> Scenario:
    speed = np.maximum(v - decel * np.maximum(T - 1.0, 0.0), to)
    x = NOSE + gap + 2.15 + np.r_[0.0, np.cumsum(0.5 * np.diff(T) * (speed[1:] + speed[:-1]))]
    return log(v, track("lead", T, x, np.zeros(len(T)), **SIZE))


def test_ccrb_needs_a_reaction_of_less_than_gap_over_speed() -> None:
    """50 km/h, 6 m/s2: 12 m leave 0.86 s, less than the careful driver's 1.15 s; 40 m suffice."""
    v = 50.0 * KMH
    assert (
        careful_driver(braking_lead(v, 12.0, 6.0, 2.0 * KMH), LINE).outcome
        is Avoidability.UNAVOIDABLE
    )
    assert (
        careful_driver(braking_lead(v, 40.0, 6.0, 2.0 * KMH), LINE).outcome
        is Avoidability.AVOIDABLE
    )
    assert (
        fuzzy_driver(braking_lead(v, 40.0, 6.0, 2.0 * KMH), LINE).outcome is Avoidability.AVOIDABLE
    )


def walker(
    v: float, at: float, begins: float, side: float, speed: float = 5.0 * KMH
) -> dict[str, object]:
    y: FloatArray = -side + speed * np.maximum(T - begins, 0.0)
    return track(
        "walker",
        T,
        np.full_like(T, at + NOSE),
        y,
        kind=AgentKind.PEDESTRIAN,
        length=0.5,
        width=0.6,
        yaw=0.5 * np.pi,
    )


@pytest.mark.parametrize("kmh", [40.0, 60.0])
def test_a_pedestrian_in_sight_can_be_avoided(kmh: float) -> None:
    """5 km/h from 5 m beside, so that the ego's middle would meet it."""
    v = kmh * KMH
    made = log(v, walker(v, v * 6.0, 6.0 - 5.0 / (5.0 * KMH), 5.0))
    for driver in (careful_driver, fuzzy_driver):
        verdict = driver(made, LINE)
        assert verdict.outcome is Avoidability.AVOIDABLE, verdict
        assert verdict.brakes < 6.0


def test_a_pedestrian_who_steps_out_a_second_ahead_cannot() -> None:
    v = 60.0 * KMH
    made = log(v, walker(v, v * 6.0, 5.0, 1.5, 1.5))
    for driver in (careful_driver, fuzzy_driver):
        assert driver(made, LINE).outcome is Avoidability.UNAVOIDABLE


def test_a_pedestrian_who_is_gone_in_time_is_no_hazard() -> None:
    v = 40.0 * KMH
    verdict = careful_driver(log(v, walker(v, v * 8.0, 0.0, 4.0), standing(v * 12.0)), LINE)
    assert verdict.brakes == pytest.approx(10.0, abs=0.2), "it brakes for the obstacle behind only"


# --- what does not count


def crossing(v: float, at: float, speed: float, begins: float, *, sideways: bool) -> Scenario:
    """A car that crosses the line from the right; `sideways` as a box that is as wide as it is
    long, not turned.
    """
    y = -12.0 + speed * np.maximum(T - begins, 0.0)
    size = {"length": 1.9, "width": 4.3} if sideways else SIZE
    return log(
        v, track("crosser", T, 0.0 * T + at, y, yaw=0.0 if sideways else 0.5 * np.pi, **size)
    )


@settings(max_examples=60)
@given(st.floats(6.0, 16.0), st.floats(40.0, 80.0), st.floats(1.5, 6.0), st.floats(0.0, 4.0))
def test_a_crossing_road_user_is_in_the_band_for_its_extent(
    v: float, at: float, speed: float, begins: float
) -> None:
    """The same box on the same way gets the same verdict, whichever of its sides is called its
    length.
    """
    long, wide = (
        careful_driver(crossing(v, at, speed, begins, sideways=one), LINE) for one in (False, True)
    )
    assert long.outcome is wide.outcome
    assert [long.brakes, long.margin] == pytest.approx([wide.brakes, wide.margin], nan_ok=True)


def test_a_drive_without_a_hazard_is_not_applicable() -> None:
    lead = track("lead", T, 20.0 + 10.0 * T, np.zeros(len(T)))
    for made in (log(10.0), log(10.0, lead), log(0.0, standing(5.0))):
        for driver in (careful_driver, fuzzy_driver):
            assert driver(made, LINE).outcome is Avoidability.NOT_APPLICABLE


def test_a_hit_from_behind_does_not_count() -> None:
    follower = track("follower", T, -12.0 + 14.0 * T, np.zeros(len(T)))
    assert careful_driver(log(10.0, follower), LINE).outcome is Avoidability.NOT_APPLICABLE
    braking = careful_driver(log(10.0, follower, standing(80.0)), LINE)
    assert braking.outcome is Avoidability.AVOIDABLE
    assert careful_drive(log(10.0, follower), LINE).meets == -1


def test_the_line_and_the_verdicts_come_from_replay() -> None:
    made = log(15.0, standing(100.0))
    assert reference_line(made).length == pytest.approx(460.0, abs=2.0)
    found = with_avoidability(made).references.verdicts
    assert found["cc"].outcome is Avoidability.AVOIDABLE and found["cc"].margin > 0.0
    assert found["cc"].agent == found["fsm"].agent == "obstacle"
    nobody = with_avoidability(log(15.0)).references.verdicts["cc"]
    assert nobody.outcome is Avoidability.NOT_APPLICABLE and not nobody.agent


def test_verdicts_stored_in_a_log_are_computed_anew(tmp_path: Path) -> None:
    made = log(15.0, standing(100.0))
    forged = {
        name: DriverVerdict(name, Avoidability.UNAVOIDABLE, "because") for name in ("cc", "hero")
    }
    told = replace(made, references=References(forged, 80.0), metadata={"seed": "7"})
    write_scenario(tmp_path / "log.mcap", told)
    assert read_scenario(tmp_path / "log.mcap").references == References()
    # as texts: a NaN is not equal to itself
    assert repr(with_avoidability(told).references) == repr(with_avoidability(made).references)


def test_the_verdict_is_on_the_car_that_is_driven() -> None:
    """10 cm beside the band of a car of the log's width is in that of a wider one."""
    beside = track("b", [0.0], [80.0], [0.5 * (CAR.width + 1.9) + 0.1], static=True, **SIZE)
    made = with_avoidability(log(10.0, beside))
    assert made.references.verdicts["cc"].outcome is Avoidability.NOT_APPLICABLE
    wide = with_avoidability(replace(made, vehicle=replace(CAR, width=CAR.width + 0.4)))
    assert wide.references.verdicts["cc"].outcome is Avoidability.AVOIDABLE
    driven = with_avoidability(replace(wide, vehicle=CAR))
    assert repr(driven.references) == repr(made.references)


# --- margins


@settings(max_examples=20)
@given(st.floats(6.0, 22.0), st.floats(10.0, 80.0))
def test_the_margin_before_an_obstacle_is_the_remaining_gap(v: float, gap: float) -> None:
    """Avoided: where it stands.

    Not avoided: how far it would have come into it, at most as deep as the boxes are.
    """
    verdict, stop = (
        careful_driver(log(v, standing(gap)), LINE),
        careful_drive(log(v, standing(gap + 60.0)), LINE),
    )
    if verdict.outcome is Avoidability.AVOIDABLE:
        rest = careful_drive(log(v, standing(gap)), LINE)
        assert rest.v[-1] == 0.0
        assert verdict.margin == pytest.approx(gap - rest.s[-1] + 50.0, abs=1e-6)
    else:
        assert stop.meets < 0
        assert -0.5 * (CAR.width + 1.9) - 1e-9 <= verdict.margin <= 0.0
    assert verdict.agent == "obstacle"
    assert f"{verdict.outcome.value} by {abs(verdict.margin):.1f} m" in verdict.reason
    assert ("marginal" in verdict.reason) == verdict.marginal


def test_the_margin_passes_through_0_where_the_verdict_changes() -> None:
    """50 km/h before an obstacle 20 to 40 m ahead, every 10 cm: it does not jump, but for the steps
    of the clock.
    """
    v = 50.0 * KMH
    gaps = np.arange(18.0, 40.0, 0.1)
    found = [careful_driver(log(v, standing(gap)), LINE) for gap in gaps]
    margins = np.array([one.margin for one in found])
    assert [one.outcome is Avoidability.AVOIDABLE for one in found] == (margins > 0.0).tolist()
    flip = int(np.argmax(margins > 0.0))
    assert 0 < flip < len(gaps) - 1 and (margins[flip:] > 0.0).all()
    assert np.abs(np.diff(margins)).max() < 0.1 + 2.0 * STEP_S * v
    assert found[flip].marginal and found[flip - 1].marginal, "on either side it says so"
    assert not found[0].marginal and not found[-1].marginal


def test_a_pass_by_a_hairs_breadth_is_marginal() -> None:
    for aside, outcome in ((0.05, Avoidability.NOT_APPLICABLE), (-0.05, Avoidability.AVOIDABLE)):
        beside = track("b", [0.0], [80.0], [0.5 * (CAR.width + 1.9) + aside], static=True, **SIZE)
        verdict = careful_driver(log(10.0, beside), LINE)
        assert (verdict.outcome, verdict.marginal) == (outcome, True)
    assert verdict.margin > MARGINAL_M, (
        "there is room ahead, but little aside decides whether it matters"
    )
    far = track(
        "b", [0.0], [80.0], [0.5 * (CAR.width + 1.9) + MARGINAL_M + 0.1], static=True, **SIZE
    )
    missed = careful_driver(log(10.0, far), LINE)
    assert missed.margin == pytest.approx(MARGINAL_M + 0.1) and not missed.marginal


# --- noise


@pytest.mark.parametrize("driver", [careful_driver, fuzzy_driver])
@pytest.mark.parametrize("rate", [10.0, 25.0, 100.0])
def test_5_cm_of_noise_leave_verdicts_that_are_not_marginal(
    rate: float, driver: Callable[..., DriverVerdict]
) -> None:
    """Rows of cut-ins and pedestrians without velocities; before, a third of them flipped."""
    t, v, flips = np.round(np.arange(0.0, 14.0, 1.0 / rate), 9), 60.0 * KMH, 0
    made = [
        cut_in(v, gap, slower * KMH, 1.2)
        for gap in (20.0, 30.0, 40.0)
        for slower in (15.0, 25.0, 35.0)
    ]
    made += [
        log(v, walker(v, v * 6.0, begins, side))
        for begins in (1.5, 3.0, 4.5)
        for side in (2.5, 4.0)
    ]
    for seed, one in enumerate(made):
        x, y = (np.interp(t, one.tracks.t, getattr(one.tracks, c)) for c in "xy")
        noise = 0.05 * np.random.default_rng(seed).standard_normal((2, len(t)))
        unknown = np.full(len(t), np.nan)
        new = {
            "offsets": [0, len(t)],
            "t": t,
            "yaw": np.full(len(t), one.tracks.yaw[0]),
            "vx": unknown,
            "vy": unknown,
        }
        clean, noisy = (
            driver(
                replace(
                    one, tracks=replace(one.tracks, x=x + s * noise[0], y=y + s * noise[1], **new)
                ),
                LINE,
            )
            for s in (0.0, 1.0)
        )
        flips += clean.outcome is not noisy.outcome
        assert clean.outcome is noisy.outcome or clean.marginal or noisy.marginal, (clean, noisy)
    assert flips <= 1


@pytest.mark.parametrize(
    ("outcome", "applies", "avoids"),
    [
        (Avoidability.AVOIDABLE, 1.0, 1.0),
        (Avoidability.UNAVOIDABLE, 1.0, 0.0),
        (Avoidability.NOT_APPLICABLE, 0.0, None),
        (None,) * 3,
    ],
)
def test_the_table_counts_outcomes(
    outcome: Avoidability | None, applies: float | None, avoids: float | None
) -> None:
    made = log(10.0)
    if outcome is not None:
        margin = {Avoidability.AVOIDABLE: 0.8, Avoidability.UNAVOIDABLE: -0.3}.get(outcome, 5.0)
        verdict = DriverVerdict("cc", outcome, "because", margin=margin)
        made = replace(made, references=References({"cc": verdict}))
    trace = Trace(
        made.name, "p", Mode.CLOSED, False, made.ego, made.tracks, (), EndReason.END_OF_LOG
    )
    rows = evaluate(trace, made).set_index("metric")
    for name, value in (("reference_cc.applies", applies), ("reference_cc.avoids", avoids)):
        assert applies != 1.0 or rows.loc["reference_cc.margin", "value"] == margin
        assert bool(rows.loc[name, "available"]) == (value is not None)
        if value is not None:
            assert rows.loc[name, "value"] == value
        elif outcome is not None:
            assert rows.loc[name, "reason"] == "not applicable: because"
