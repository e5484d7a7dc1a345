"""Why two planners drive differently: a planted fault is named with its size, and nothing is named
without one.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from command_line import replan

from replan.core.settings import flat, nested
from replan.experiments.input_search import rounded
from replan.logs.mcap import write_scenario
from replan.results.tables import safe_name
from replan.run.log_source import LogSource

FAULTY = '''
from dataclasses import replace

import numpy as np

from replan.planners.dp_qp.planner import DpQp


class NearSide:
    """Sees only who is at most 3 m to the side."""

    def __init__(self, context):
        self._planner = DpQp(context)

    def plan(self, frame):
        return self._planner.plan(self.change(frame))

    def change(self, frame):
        agents, ego = frame.agents, frame.ego
        left = (agents.y - ego.y) * np.cos(ego.yaw) - (agents.x - ego.x) * np.sin(ego.yaw)
        rows = np.flatnonzero(abs(left) <= 3.0)
        new = {row: i for i, row in enumerate(rows)}
        futures = frame.predictions
        kept = np.flatnonzero(np.isin(futures.agent, rows))
        columns = {n: getattr(futures, n)[kept] for n in ("probability", "x", "y", "yaw")}
        owners = np.array([new[row] for row in futures.agent[kept]], dtype=np.int64)
        return replace(
            frame,
            agents=agents.some(rows),
            predictions=replace(futures, agent=owners, **columns),
        )


class SlowPredictions(NearSide):
    """Predicts 0.6 of each displacement, and forgets its plan."""

    def change(self, frame):
        futures = frame.predictions
        x, y = (
            column[:, :1] + 0.6 * (column - column[:, :1]) for column in (futures.x, futures.y)
        )
        return replace(frame, predictions=replace(futures, x=x, y=y), previous=None)


class Rough(NearSide):
    """Plans as dp_qp, and slows the plan down."""

    def change(self, frame):
        return frame

    def plan(self, frame):
        plan = self._planner.plan(frame)
        slower = np.linspace(1.0, 0.98, len(plan.trajectory.t))
        speeds = replace(plan.trajectory, v=slower * plan.trajectory.v)
        return replace(plan, trajectory=speeds)
'''
LOGS = ("paper/crossing_pedestrian", "everyday/cut_in", "everyday/junction")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs of dp_qp, and of planners with a fault, over the same logs."""
    folder = tmp_path_factory.mktemp("against")
    (folder / "faulty_planners.py").write_text(FAULTY, encoding="utf-8")
    (folder / "logs").mkdir()
    for name in LOGS:
        write_scenario(folder / "logs" / f"{safe_name(name)}.mcap", LogSource(name).read())
    return folder


def run_of(folder: Path, planner: str) -> Path:
    """The results of a planner, driven once."""
    results = folder / planner.replace(":", "_")
    if not results.exists():
        ran = replan(
            "evaluate",
            folder / "logs",
            "-p",
            planner,
            "--mode",
            "closed",
            "--no-recording",
            "--workers",
            0,
            "--set",
            "loop.apart.trust=true",
            "-o",
            results,
        )
        assert ran.exit_code in (0, 1), ran.output
    return results


def attributed(folder: Path, planner: str) -> dict[str, Any]:
    """The attribution of a planner's run against that of dp_qp."""
    ran = replan(
        "diagnose", run_of(folder, planner), "--against", run_of(folder, "dp_qp"), "--json"
    )
    assert ran.exit_code == 0, ran.output
    document: dict[str, Any] = json.loads(ran.stdout)
    return document


@pytest.mark.slow
@pytest.mark.parametrize(
    ("planner", "cause", "changes"),
    [
        ("NearSide", "input", {"drop agents beside 3"}),
        ("SlowPredictions", "prediction and input", {"scale predictions 0.6", "no previous plan"}),
    ],
)
def test_a_planted_change_of_the_input_is_named_with_its_size(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    planner: str,
    cause: str,
    changes: set[str],
) -> None:
    monkeypatch.syspath_prepend(folder)
    document = attributed(folder, f"faulty_planners:{planner}")
    options = [document["changes"], *document["not_separated"]]
    assert set(document["cause"].split(" and ")) == set(cause.split(" and "))
    assert changes in map(set, options)
    assert document["equal_frames"] == document["frames"] > document["differing_frames"] > 0


@pytest.mark.slow
def test_a_fault_behind_the_input_is_a_decision_and_no_change_of_the_input_is_named(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(folder)
    document = attributed(folder, "faulty_planners:Rough")
    assert document["cause"] == "decision" and document["stage"] == "plan"
    assert not document["changes"]


@pytest.mark.slow
def test_equal_planners_have_no_cause(folder: Path) -> None:
    document = attributed(folder, "dp_qp")
    assert document["cause"] == "" and document["differing_frames"] == 0
    assert document["said"][0].startswith("No cause found")


def test_values_are_tried_with_few_digits_and_dotted_keys_make_tables() -> None:
    assert rounded(0.5512) == [0.6, 0.55, 0.551] and rounded(-1234.0) == [-1000.0, -1200.0, -1230.0]
    values = {"a.b": 1, "a.c": 2, "d": 3}
    assert (
        nested(values) == {"a": {"b": 1, "c": 2}, "d": 3} and dict(flat(nested(values))) == values
    )
