"""NAVSIM's two stages: laws of the weights, and a table whose sums are done by hand."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, strategies as st

from replan.core.arrays import FloatArray
from replan.core.errors import ConfigError
from replan.logs.catalogue import scenario as catalogue
from replan.logs.edit.transform import moved
from replan.logs.scenario import Scenario
from replan.score.navsim import human_poses, window_at
from replan.score.navsim_table import navsim_table
from replan.score.submitted_plans import SubmittedPlan, plans_of_table
from replan.score.two_stages import COMBINED, STAGE_ONE, STAGE_TWO, weights

PLACES = st.lists(st.tuples(*[st.floats(-3.0, 3.0)] * 2), min_size=1, max_size=6)


@given(PLACES, st.tuples(*[st.floats(-3.0, 3.0)] * 2), st.floats(-1e3, 1e3))
def test_weights_are_of_distance_alone(
    places: list[tuple[float, float]], end: tuple[float, float], by: float
) -> None:
    begins, last = np.array(places), np.array(end)
    shares = weights(last, begins)
    assert shares.sum() == pytest.approx(1.0)
    assert weights(last + by, begins + by) == pytest.approx(shares, abs=1e-6)
    assert weights(last * [1.0, -1.0], begins * [1.0, -1.0]) == pytest.approx(shares)
    away = np.hypot(*(begins - last).T)
    for i, j in np.ndindex(len(away), len(away)):
        assert away[i] > away[j] or shares[i] >= shares[j] - 1e-12, (
            "what begins nearer counts at least as much"
        )


def test_weights_by_hand() -> None:
    """Scenes at 0 and sqrt(0.2 ln 2) m: twice the weight. All far away: equal weights."""
    near = np.array([[0.0, 0.0], [np.sqrt(0.2 * np.log(2.0)), 0.0]])
    assert weights(np.zeros(2), near) == pytest.approx([2.0 / 3.0, 1.0 / 3.0])
    assert weights(np.array([500.0, 0.0]), near) == pytest.approx([0.5, 0.5])


@cache
def log() -> Scenario:
    return catalogue("everyday/cut_in")


@cache
def shifted() -> Scenario:
    """The log in other coordinates of one map, 0.3 m to the left of where its driver was: another
    follow-up scene.
    """
    origin = 200.0, -40.0
    placed = moved(
        replace(log(), ego=replace(log().ego, y=log().ego.y + 0.3)), -origin[0], -origin[1], 0.0
    )
    return replace(placed, name="shifted", origin=origin)


def plan(
    scenario: Scenario, t: float, token: str, follows: str = "", slower: float = 0.0
) -> SubmittedPlan:
    poses: FloatArray = human_poses(window_at(scenario, t))
    poses = poses - np.outer(slower * np.arange(1, 9) ** 2, [1.0, 0.0, 0.0])
    return SubmittedPlan(scenario.name, "me", token, t, poses, follows)


def asked() -> list[SubmittedPlan]:
    return [
        plan(log(), 3.5, "P"),
        plan(log(), 4.0, "N", slower=0.002),
        plan(log(), 7.5, "P1", "P"),
        plan(log(), 8.0, "N1", "N"),
        plan(shifted(), 7.5, "P2", "P", slower=0.02),
        plan(shifted(), 8.0, "N2", "N", slower=0.02),
    ]


def test_the_score_of_a_window_counts_with_what_follows() -> None:
    logs = {log().name: log(), "shifted": shifted()}
    table = navsim_table("navsim-v2", asked(), logs)
    rows = table.rows.set_index("token")
    assert rows.stage.dropna().to_dict() == {"P": 1, "N": 1, "P1": 2, "N1": 2, "P2": 2, "N2": 2}
    d1, d2 = 0.002 * 64, np.hypot(0.002 * 64, 0.3)
    assert rows.weight["N1"] / rows.weight["N2"] == pytest.approx(
        np.exp((d2**2 - d1**2) / 0.2), rel=1e-6
    )
    for pair in (("P", "N"), ("P1", "N1"), ("P2", "N2")):
        assert rows.two_frame_extended_comfort[list(pair)].nunique(dropna=False) == 1, (
            "both of a pair have the pair's"
        )
    second = {
        name: sum(rows.weight[name + k] * rows.score[name + k] for k in "12") for name in "PN"
    }
    assert rows.score[COMBINED] == pytest.approx(
        0.5 * sum(rows.score[name] * second[name] for name in "PN")
    )
    assert rows.score[STAGE_ONE] == pytest.approx(0.5 * (rows.score["P"] + rows.score["N"]))
    assert rows.score[STAGE_TWO] == pytest.approx(0.5 * sum(second.values()))
    progress = {
        name: sum(rows.weight[name + k] * rows.ego_progress[name + k] for k in "12")
        for name in "PN"
    }
    assert rows.ego_progress[STAGE_TWO] == pytest.approx(0.5 * sum(progress.values()))
    backwards = navsim_table("navsim-v2", asked()[::-1], logs).rows
    pd.testing.assert_frame_equal(backwards, table.rows)


def test_a_window_without_follow_ups_is_left_out_and_noted() -> None:
    alone = asked()[:1] + [one for one in asked() if "N" in one.token]
    table = navsim_table("navsim-v2", alone, {log().name: log(), "shifted": shifted()})
    rows = table.rows.set_index("token")
    assert rows.score[COMBINED] == pytest.approx(
        rows.score["N"] * sum(rows.weight["N" + k] * rows.score["N" + k] for k in "12")
    )
    assert any("1 of 2" in note for note in table.inexact)


@pytest.mark.parametrize(
    ("second", "follows", "name", "says"),
    [
        ("N1", "other", "navsim-v2", "other"),
        ("N", "N", "navsim-v2", "token N"),
        ("N1", "N", "navsim-v1", "navsim-v1 has one stage"),
    ],
)
def test_plans_that_cannot_be_staged_are_refused(
    second: str, follows: str, name: str, says: str
) -> None:
    with pytest.raises(ConfigError, match=says):
        navsim_table(
            name, [plan(log(), 4.0, "N"), plan(log(), 8.0, second, follows)], {log().name: log()}
        )


def test_a_file_names_the_windows_that_its_windows_follow(tmp_path: Path) -> None:
    rows = [
        {
            "log": one.log,
            "t_s": one.t,
            "planner": one.drive,
            "token": one.token,
            "stage_one": one.stage_one or None,
            "x": x,
            "y": y,
            "yaw": yaw,
        }
        for one in asked()
        for x, y, yaw in one.poses
    ]
    pd.DataFrame(rows).to_csv(tmp_path / "plans.csv", index=False)
    logs = {log().name: log(), "shifted": shifted()}
    table = navsim_table(
        "navsim-v2", plans_of_table(tmp_path / "plans.csv", logs, relative=False), logs
    )
    pd.testing.assert_frame_equal(table.rows, navsim_table("navsim-v2", asked(), logs).rows)
