"""The contract of a planner, executable: every planner of the table, on scenarios made by hand and
of the catalogue.

The laws are those of `replan.contract`; for a planner of your own, call `replan.check_planner`.
"""

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from handmade import drive, s_curve, scenario, square, straight, track, tracks
from hypothesis import given, strategies as st

from replan.contract.planner_rules import (
    check_planner,
    context_of,
    frame_times_of,
    future_changes,
    until,
)
from replan.core.errors import PlannerError
from replan.logs.agents import AgentKind
from replan.logs.catalogue import CATALOGUE
from replan.logs.frame import Frame, PlannerContext
from replan.logs.plan import Plan
from replan.logs.road import Goal
from replan.logs.scenario import Scenario
from replan.logs.states import EgoState, OnboardPlan
from replan.planners.constant_speed import arc
from replan.replay.parts import PLANNER
from replan.replay.planner_process.planner_config import planner_part


def busy_street() -> Scenario:
    """An S-curve with a slower car ahead, a parked car at the edge and a pedestrian who walks
    across.
    """
    ego = drive(s_curve, 12.0, 10.0)
    lead = drive(s_curve, 8.0, 10.0)
    parked, t = ego.at(8.0), np.arange(0.0, 10.01, 0.1)
    return scenario(
        ego,
        agents=tracks(
            track(
                "lead",
                lead.t,
                lead.x + 30.0 * np.cos(lead.yaw),
                lead.y + 30.0 * np.sin(lead.yaw),
                yaw=lead.yaw,
            ),
            track("parked", [0.0], [parked.x], [parked.y - 2.5], yaw=parked.yaw, static=True),
            track(
                "walker",
                t,
                np.full_like(t, 70.0),
                -4.0 + 1.4 * t,
                kind=AgentKind.PEDESTRIAN,
                length=0.5,
                width=0.5,
            ),
        ),
    )


SCENES = {
    "free": lambda: scenario(drive(s_curve, 12.0, 10.0)),
    "busy": busy_street,
    "standing": lambda: scenario(
        drive(straight, lambda t: np.interp(t, [0.0, 2.0, 8.0], [0.0, 0.0, 9.0]), 8.0),
        agents=tracks(track("ahead", [0.0], [40.0], [0.0], static=True)),
    ),
    "goal": lambda: scenario(drive(straight, 10.0, 8.0), goal=Goal((square(60.0, 0.0, 3.0),))),
}


def scenes() -> dict[str, Scenario]:
    made = {name: build() for name, build in SCENES.items()}
    return made | {name: family.scenario() for name, family in CATALOGUE.items()}


@pytest.fixture(scope="module")
def all_scenes() -> dict[str, Scenario]:
    return scenes()


QUICK = ("idm", "constant_speed")


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in QUICK else pytest.mark.slow)
        for name in PLANNER.causal
    ],
)
def test_the_contract_holds(name: str, all_scenes: dict[str, Scenario]) -> None:
    check_planner(name, scenarios=all_scenes.values())


class Nosy:
    """Its plan depends on everything in the frame: the witness that a leak would be seen."""

    def __init__(self, context: PlannerContext) -> None:
        pass

    def plan(self, frame: Frame) -> Plan:
        seen = [getattr(frame.agents, n).sum() for n in ("x", "y", "yaw", "vx", "vy")]
        seen += [len(frame.agents), frame.predictions.x.sum(), frame.predictions.y.sum()]
        return Plan(arc(replace(frame.ego, x=frame.ego.x + sum(seen)), frame.t + np.arange(3.0)))


@pytest.mark.parametrize("name", [*PLANNER.oracles, "nosy"])
def test_no_later_sample_of_an_agent_changes_an_oracles_plan(
    name: str, all_scenes: dict[str, Scenario]
) -> None:
    oracle: Any = PLANNER.builtin.get(name)

    def build(log: Scenario) -> Any:
        return Nosy(context_of(log)) if oracle is None else oracle(context_of(log), log)

    for made in all_scenes.values():
        onboard = (OnboardPlan(0.0, arc(made.ego.state(0), np.arange(0.0, 9.0, 0.5))),)
        known = replace(made, onboard=onboard if name == "onboard" else ())
        for t in frame_times_of(known):
            assert not future_changes(build, known, t)


@given(st.floats(0.0, 4.0), st.integers(0, 2**32 - 1))
def test_no_agent_sample_later_than_the_frame_is_perceived(t: float, seed: int) -> None:
    """Ragged tracks, with and without logged velocities, at any time."""
    rng = np.random.default_rng(seed)
    agents = []
    for i in range(4):
        when = np.sort(rng.uniform(0.0, 4.0, rng.integers(1, 12)))
        speed = (
            {"vx": rng.normal(size=len(when)), "vy": rng.normal(size=len(when))} if i % 2 else {}
        )
        agents.append(
            track(str(i), when, rng.normal(size=len(when)), rng.normal(size=len(when)), **speed)
        )
    whole = tracks(*agents)
    one, two = whole.perceived(t), until(whole, t).perceived(t)
    assert one.ids == two.ids
    for column in ("x", "y", "yaw", "vx", "vy"):
        np.testing.assert_array_equal(getattr(one, column), getattr(two, column))


@given(st.floats(-5.0, 30.0), st.floats(-0.2, 0.2), st.floats(-4.0, 4.0))
def test_constant_speed_is_the_arc_of_the_kinematic_equations(
    v: float, kappa: float, yaw: float
) -> None:
    t = np.linspace(0.0, 5.0, 5001)
    way = arc(EgoState(0.0, 3.0, -2.0, yaw, v, 0.0, kappa), t)
    heading = yaw + v * kappa * t
    middle = 0.5 * (heading[1:] + heading[:-1])
    x = 3.0 + np.r_[0.0, np.cumsum(v * np.cos(middle)) * 1e-3]
    y = -2.0 + np.r_[0.0, np.cumsum(v * np.sin(middle)) * 1e-3]
    np.testing.assert_allclose(way.x, x, atol=1e-4)
    np.testing.assert_allclose(way.y, y, atol=1e-4)
    np.testing.assert_allclose(way.yaw - way.yaw[0], heading - heading[0], atol=1e-9)


@pytest.fixture
def own_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A working directory for modules of the user's."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    known = set(sys.modules)
    yield tmp_path
    for name in set(sys.modules) - known:
        del sys.modules[name]


def test_a_users_planner_is_found_in_the_working_directory(own_module: Path) -> None:
    (own_module / "mine_a.py").write_text(
        "from replan.planners.constant_speed import ConstantSpeed as MyPlanner\n"
    )
    assert planner_part("mine_a:MyPlanner").factory.__name__ == "ConstantSpeed"
    with pytest.raises(PlannerError, match="did you mean 'MyPlanner'"):
        _ = planner_part("mine_a:MyPlaner").factory
    with pytest.raises(PlannerError, match="is not a planner"):
        _ = planner_part("mine_a:__name__").factory
