"""NAVSIM's scores: equal to the original's own values.

Laws; the human's trajectory; the versions.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings, strategies as st

from replan.logs.catalogue import scenario as catalogue
from replan.logs.edit.cut import cut
from replan.logs.edit.transform import mirrored, moved
from replan.logs.rules import Colour, TrafficLight
from replan.logs.scenario import Scenario
from replan.replay.loop.open_loop import run_open_loop
from replan.replay.loop_config import DEFAULT_LOOP
from replan.score.navsim import VERSIONS, human_poses, window_at
from replan.score.navsim_tracker import fitted, simulated
from replan.score.submitted_plans import plans_of_trace
from replan.score.yardstick import ScoredPlan, scored, total

VALUES = Path(__file__).parents[2] / "support" / "leaderboards"
LOGS = {
    "everyday_cut_in": "everyday/cut_in",
    "everyday_junction": "everyday/junction",
    "paper_crossing_pedestrian": "paper/crossing_pedestrian",
}
PARTS = ("NC", "DAC", "DDC", "TLC", "EP", "TTC", "LK", "HC")
V2 = VERSIONS["navsim-v2"]


@cache
def log(name: str) -> Scenario:
    return catalogue(LOGS[name])


@cache
def plans() -> pd.DataFrame:
    return pd.read_parquet(VALUES / "navsim_plans.parquet")


def poses(drive: str, t: float) -> np.ndarray:
    rows = plans()[(plans().drive == drive) & (plans().t == t)].sort_values("after_s")
    return rows[["x", "y", "yaw"]].to_numpy()


@cache
def before(drive: str) -> dict[float, np.ndarray]:
    """The plans of the drive's planner every 0.5 s."""
    name, planner = drive.rsplit("__", 1)
    found = run_open_loop(log(name), planner, config=replace(DEFAULT_LOOP, plan_period_s=0.5))
    return {round(one.t, 3): one.poses for one in plans_of_trace(found.trace, log(name))}


def test_parts_and_scores_are_those_of_the_original() -> None:
    values = pd.read_csv(VALUES / "navsim_original.csv")
    rows = []
    for row in values.itertuples():
        name = row.drive.rsplit("__", 1)[0]
        plan = scored(window_at(log(name), row.t), poses(row.drive, row.t), V2)
        assert total({**plan.parts, "EC": row.EC}, V2) == pytest.approx(row.EPDMS, abs=1e-4)
        pdms = plan.parts["NC"] * plan.parts["DAC"]
        mean = (5 * plan.parts["EP"] + 5 * plan.parts["TTC"] + 2 * plan.parts["HC"]) / 12
        assert pdms * mean == pytest.approx(row.PDMS, abs=1e-4)
        rows.append([abs(plan.parts[part] - getattr(row, part)) for part in PARTS])
    assert len(rows) == 62
    assert np.max(rows) < 1e-4


def test_extended_comfort_is_that_of_the_original() -> None:
    """The planners of idm and constant_speed have not changed since the values were computed.

    Dp_qp may.
    """
    values = pd.read_csv(VALUES / "navsim_original.csv")
    values = values[values.drive.str.contains("idm|constant_speed")]
    for row in values.itertuples():
        name = row.drive.rsplit("__", 1)[0]
        was = before(row.drive)
        assert was[round(row.t, 3)] == pytest.approx(poses(row.drive, row.t), abs=1e-3)
        earlier = scored(window_at(log(name), row.t - 0.5), was[round(row.t - 0.5, 3)], V2)
        plan = scored(window_at(log(name), row.t), poses(row.drive, row.t), V2, earlier)
        assert plan.parts["EC"] == row.EC
        assert plan.score == pytest.approx(row.EPDMS, abs=1e-4)


def one(scenario: Scenario, t: float, plan: np.ndarray, version: str = "navsim-v2") -> ScoredPlan:
    return scored(window_at(scenario, t), plan, VERSIONS[version])


@settings(max_examples=6, deadline=None)
@given(st.floats(-3.0, 3.0), st.floats(-200.0, 200.0), st.sampled_from([6.0, 10.0, 14.0]))
def test_scores_do_not_change_with_the_world(turn: float, shift: float, t: float) -> None:
    for name, drive in (("everyday_junction", "everyday_junction__dp_qp"),):
        plan = poses(drive, t)
        whole = one(log(name), t, plan)
        c, s = np.cos(turn), np.sin(turn)
        placed = np.column_stack(
            [
                c * plan[:, 0] - s * plan[:, 1] + shift,
                s * plan[:, 0] + c * plan[:, 1] - shift,
                plan[:, 2] + turn,
            ]
        )
        turned = one(moved(log(name), shift, -shift, turn), t, placed)
        assert turned.parts == pytest.approx(whole.parts, abs=1e-5, nan_ok=True)
        flipped = one(mirrored(log(name)), t, plan * [1.0, -1.0, -1.0])
        # the proposals beside the centre line change their order: of equal ones the other may be
        # the first
        assert flipped.parts == pytest.approx(whole.parts, abs=0.05, nan_ok=True)


def test_a_longer_log_does_not_change_a_windows_score() -> None:
    """The log until 2 s after the window has the same lanes on its route, and so the same score."""
    for name, drive, t in (
        ("everyday_cut_in", "everyday_cut_in__idm", 6.0),
        ("paper_crossing_pedestrian", "paper_crossing_pedestrian__dp_qp", 8.0),
    ):
        shorter = cut(log(name), 0.0, t + 6.0)
        assert one(shorter, t, poses(drive, t)).parts == pytest.approx(
            one(log(name), t, poses(drive, t)).parts, nan_ok=True
        )


def test_a_route_that_the_log_names_is_the_route() -> None:
    """Naming the lanes of the driver's route changes nothing.

    Lanes beyond its begin alone lose the score.
    """
    name, drive, t = "everyday_junction", "everyday_junction__dp_qp", 6.0
    whole = one(log(name), t, poses(drive, t))
    ground = window_at(log(name), t).ground
    driven = tuple(
        ground.lanes.lanes[i].id
        for block in ground.route.blocks
        for i in sorted(ground.route.lanes)
        if ground.lanes.block[i] == block
    )
    named = replace(log(name), road=replace(log(name).road, route=(*driven, 10**6)))
    assert one(named, t, poses(drive, t)).parts == pytest.approx(whole.parts, nan_ok=True)
    assert len(driven) > 1 and set(driven) < {lane.id for lane in ground.lanes.lanes}
    short = replace(log(name), road=replace(log(name).road, route=driven[-1:]))
    assert window_at(short, t).ground.route.lanes < ground.route.lanes


def test_parts_that_the_logged_driver_fails_are_excused() -> None:
    """A human who drives over a red light: their own trajectory, and any other that does so too, is
    not marked down.
    """
    light = catalogue("everyday/traffic_light")
    red = replace(light, lights=(TrafficLight(1, np.zeros(1), (Colour.RED,)),))
    # The driver waits, and goes on at what was green
    t = float(light.ego.t[np.argmax(light.ego.v < 0.1)]) + 4.0
    window = window_at(red, t)
    drives_on = one(red, t, human_poses(window))
    assert drives_on.parts["TLC"] == 1.0
    assert one(red, t, human_poses(window), "navsim-v2-old-filter").parts["TLC"] == 1.0


def test_red_lights_and_the_old_filter() -> None:
    """Over a red light at which the human stops: no score.

    Off the road with a human who is, too: by version.
    """
    light = catalogue("everyday/traffic_light")
    t = float(light.ego.t[np.argmax(light.ego.v < 0.1)]) - 4.5
    ego = light.ego.resampled(np.array([t])).state(0)
    straight = np.column_stack(
        [ego.x + 13.9 * 0.5 * np.arange(1, 9), np.full(8, ego.y), np.zeros(8)]
    )
    assert one(light, t, straight).parts["TLC"] == one(light, t, straight).score == 0.0
    assert one(light, t, human_poses(window_at(light, t))).parts["TLC"] == 1.0
    off = replace(
        log("everyday_cut_in"),
        ego=replace(log("everyday_cut_in").ego, y=log("everyday_cut_in").ego.y + 1.0),
    )
    beside = human_poses(window_at(off, 4.0))
    new, old = one(off, 4.0, beside), one(off, 4.0, beside, "navsim-v2-old-filter")
    assert new.parts == pytest.approx(old.parts, nan_ok=True)
    assert new.parts["DAC"] == 1.0
    assert old.score == 0.0 < new.score
    first = one(off, 4.0, beside, "navsim-v1")
    assert first.parts["DAC"] == first.parts["EP"] == first.score == 0.0


def test_the_tracker_fits_and_follows_a_constant_turn() -> None:
    v, kappa = 8.0, 0.02
    s = 0.1 * v * np.arange(41)
    circle = np.column_stack(
        [np.sin(kappa * s) / kappa, (1.0 - np.cos(kappa * s)) / kappa, kappa * s]
    )
    speed, bend = fitted(circle)
    assert speed == pytest.approx(np.full(40, v), abs=0.02)
    assert bend[5:] == pytest.approx(np.full(35, kappa), abs=1e-3)
    start = np.array([0.0, 0.0, 0.0, v, 0.0, 0.0, np.arctan(3.089 * kappa), v * kappa, 0.0])
    states = simulated(circle, start, 3.089)
    assert np.hypot(*(states[-1, :2] - circle[-1, :2])) < 0.5
