"""The part of a drive that a planner can drive.

Drives are made of pieces: curvature, way, speed (below 0: reverse).
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st

from replan.core.errors import LogError
from replan.logs.complete import ONE_LANE, REVERSES
from replan.logs.forward import drivable_part, forward_part, reversals, tighter_than_vehicle
from replan.logs.mcap import write_scenario
from replan.logs.readers import LogSettings, read_log
from replan.logs.readers.table import from_frames
from replan.logs.road import Road, RoadSource
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.summary import evaluations

STAND = (0.0, 0.0, 0.0)
"""A piece: stands for 3 s."""


def ego(*pieces: tuple[float, float, float], hz: float = 10.0, signed: bool = True) -> pd.DataFrame:
    """A drive at 1.5 m/s2, with a standstill of 1 s between forward and reverse."""
    rows, at = [(0.0, 0.0, 0.0, 0.0, 0.0)], np.zeros(4)  # x, y, yaw, t
    for kappa, way, speed in pieces:
        for _ in range(100 if way else 300):
            at[3] += 0.01
            rows.append((at[3], *at[:3], 0.0))
        done = v = 0.0
        while done < way - 1e-4:
            v = min(v + 0.015, abs(speed), max(np.sqrt(3.0 * (way - done)), 0.02))
            d = np.sign(speed) * v * 0.01
            middle = at[2] + 0.5 * kappa * d
            at += d * np.cos(middle), d * np.sin(middle), kappa * d, 0.01
            done += abs(d)
            rows.append((at[3], *at[:3], np.sign(speed) * v))
    fine = np.array(rows).T
    t = np.arange(0.0, fine[0, -1], 1.0 / hz)
    table = pd.DataFrame(
        {
            n: np.interp(t, fine[0], row)
            for n, row in zip(("t", "x", "y", "yaw", "v"), fine, strict=True)
        }
    )
    return table if signed else table.assign(v=table.v.abs())


def driven(*pieces: tuple[float, float, float], **more: float) -> Scenario:
    return from_frames(ego(*pieces, **more), name="drive")


FORWARD_BACK = (0.0, 30.0, 4.0), STAND, (0.0, 20.0, -2.5), STAND
THREE_POINT = (
    (0.0, 30.0, 4.0),
    (0.2, 8.0, 2.0),
    (-0.2, 6.0, -1.5),
    (0.2, 6.0, 1.5),
    (0.0, 40.0, 4.0),
)
BACKS_OUT = (0.0, 6.0, -1.5), (1.0 / 6.0, 8.0, -1.5), STAND, (0.0, 80.0, 7.0)
PARKS = (0.0, 60.0, 6.0), (1.0 / 6.0, 4.0, -1.2), (-1.0 / 6.0, 4.0, -1.2), (0.0, 1.5, 0.8)


@pytest.mark.parametrize("hz", [5.0, 10.0, 50.0, 100.0])
@pytest.mark.parametrize("kind", ["signed", "unsigned", "noisy"])
@pytest.mark.parametrize(
    ("pieces", "way", "turns"),
    [(FORWARD_BACK, 30.0, 1), (THREE_POINT, 38.0, 1), (BACKS_OUT, 80.0, 1), (PARKS, 60.0, 1)],
)
def test_the_part_to_drive_is_the_first_that_goes_forward(
    pieces: tuple[tuple[float, float, float], ...], way: float, turns: int, hz: float, kind: str
) -> None:
    table = ego(*pieces, hz=hz, signed=kind != "unsigned")
    if kind == "noisy":
        noise = np.random.default_rng(1).normal(0.0, (0.0, 0.02, 0.02, 0.01, 0.03), (len(table), 5))
        table += noise
    log = from_frames(table, name="drive")
    assert len(reversals(log.ego)) == turns
    part = drivable_part(log)
    assert part.duration == pytest.approx(part.ego.t[-1]) and part.ego.t[0] in log.ego.t
    (lane,) = log.road.lanes.values()
    assert lane.length == pytest.approx(10.0 + way + 250.0, abs=4.0)
    assert (
        np.diff(lane.center @ [np.cos(part.ego.yaw[0]), np.sin(part.ego.yaw[0])])[: int(0.7 * way)]
        > 0.0
    ).all()
    assert any(note.startswith(REVERSES) for note in log.notes)


def test_the_times_of_a_reversal_are_those_between_the_standstills() -> None:
    """30 m forward, 4 s at rest, 20 m back, as a car park sees it.

    The lane's limit is that of the way forward.
    """
    t = np.arange(0.0, 30.0, 0.1)
    v = np.interp(t, [0, 2, 8, 10, 14, 16, 22, 24, 30], [0, 4, 4, 0, 0, -2.5, -2.5, 0, 0])
    table = pd.DataFrame(
        {"t": t, "x": np.r_[0.0, np.cumsum(0.05 * (v[1:] + v[:-1]))], "y": 0.0, "yaw": 0.0, "v": v}
    )
    log = from_frames(table, name="drive")
    ((first, last),) = reversals(log.ego)
    assert (log.ego.t[first], log.ego.t[last]) == pytest.approx((14.0, 24.0), abs=0.15)
    assert drivable_part(log).duration == pytest.approx(14.0, abs=0.15)


@settings(max_examples=25, deadline=None)
@given(st.floats(-3.0, 3.0), st.floats(-50.0, 50.0), st.booleans())
def test_reversals_do_not_depend_on_the_frame(turn: float, shift: float, mirrored: bool) -> None:
    here = from_frames(ego(*THREE_POINT), name="drive").ego
    sign = -1.0 if mirrored else 1.0
    c, s, x, y = np.cos(turn), np.sin(turn), here.x, sign * here.y
    x, y, yaw = c * x - s * y + shift, s * x + c * y - shift, sign * here.yaw + turn
    moved = replace(here, x=x, y=y, yaw=yaw, kappa=sign * here.kappa)
    assert reversals(moved) == reversals(here)


def test_motion_without_reverse_gear_does_not_end_the_lane() -> None:
    """A roll back of 0.7 m, a correction of the localisation by 4 m at speed, a drift of 3 m within
    5 min at rest.
    """
    rolls = driven((0.0, 50.0, 6.0), STAND, (0.0, 0.7, -0.5), (0.0, 50.0, 6.0)).ego
    ahead = driven((0.0, 100.0, 10.0)).ego
    corrected = replace(ahead, x=ahead.x - 4.0 * (ahead.t > 6.0))
    t = np.arange(0.0, 300.0, 0.1)
    drifts = Trajectory(t, -0.01 * t, 0.0 * t, 0.0 * t, 0.0 * t, 0.0 * t, 0.0 * t)
    for one in (rolls, corrected, drifts):
        assert reversals(one) == () and forward_part(one, ()) == (0, len(one) - 1)


def test_a_log_that_only_reverses_is_refused_and_not_driven() -> None:
    log = driven((0.0, 40.0, -2.0), signed=False)
    with pytest.raises(LogError, match=r"reverses from .* planners drive forward only") as refusal:
        drivable_part(log)
    assert "--from" in str(refusal.value)
    loops = {
        one.name: one.possible for one in evaluations(log, has_vehicle=False) if "loop" in one.name
    }
    assert len(loops) == 2 and not any(loops.values())
    (note,) = (note for note in log.notes if note.startswith(REVERSES))
    assert "not negative" in note and "not negative" not in " ".join(
        driven((0.0, 40.0, -2.0)).notes
    )


def test_on_the_lanes_of_a_map_all_is_driven() -> None:
    log = driven(*FORWARD_BACK)
    mapped = replace(log, road=Road(log.road.lanes, RoadSource.LANES))
    assert drivable_part(mapped) is mapped
    forward = driven((0.0, 50.0, 5.0))
    assert drivable_part(forward) is forward


def test_a_part_has_a_lane_of_its_own(tmp_path: Path) -> None:
    """The first nine seconds alone, as a log of their own.

    From a table and from a converted log.
    """
    table = ego(*FORWARD_BACK)
    alone = from_frames(table[table.t < 9.0 + 1e-6], name="drive")
    (tmp_path / "log").mkdir()
    table.to_csv(tmp_path / "log" / "ego.csv", index=False)
    write_scenario(tmp_path / "log.mcap", read_log(tmp_path / "log"))
    for path in (tmp_path / "log", tmp_path / "log.mcap"):
        part = read_log(path, LogSettings(end=9.0))
        np.testing.assert_allclose(part.road.lanes[0].left, alone.road.lanes[0].left, atol=1e-6)
        assert part.road.limit(0) == alone.road.limit(0) and drivable_part(part) is part
        assert [note for note in part.notes if note.startswith((ONE_LANE, REVERSES))] == list(
            alone.notes[-1:]
        )
    whole, again = read_log(tmp_path / "log"), read_log(tmp_path / "log.mcap")
    assert (
        again.road.lanes[0].left == whole.road.lanes[0].left
    ).all() and again.notes == whole.notes
    assert (drivable_part(again).ego.x == drivable_part(whole).ego.x).all()


@pytest.mark.parametrize(("radius", "tight"), [(2.0, True), (4.5, False), (15.0, False)])
def test_circles_are_tighter_than_a_car_below_its_turning_circle(
    radius: float, tight: bool
) -> None:
    log = driven((1.0 / radius, 6.0 * np.pi * radius, 2.5))
    assert bool(tighter_than_vehicle(log)) is tight
