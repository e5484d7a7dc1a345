"""The side of nuPlan's planners as far as it needs no devkit: plans, messages of errors, syntax."""

from __future__ import annotations

import ast
from collections.abc import Callable
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

import replan.nuplan as nuplan
from replan.nuplan.replan_nuplan.nuplan_channel import column
from replan.nuplan.replan_nuplan.nuplan_faults import called, describe
from replan.nuplan.replan_nuplan.nuplan_plans import BLEND_KAPPA, BLEND_MPS2, plan_message

FILES = [nuplan.START, *sorted((nuplan.START.parent / "replan_nuplan").glob("*.py"))]
Pose = Callable[[float], tuple[float, float]]


class Seconds:
    """The clock of a drive whose times are seconds."""

    def seconds(self, time: float) -> float:
        return time


def trajectory(
    pose: Pose, begin: float = 3.0, steps: int = 81, heading: float | None = None
) -> Any:
    """A trajectory of the devkit as far as a plan needs it: `pose(t)` after its begin; its heading
    is given, else that of the motion.
    """
    states = []
    for t in 0.1 * np.arange(steps):
        (x, y), (next_x, next_y) = pose(t), pose(t + 0.01)
        yaw = float(np.arctan2(next_y - y, next_x - x)) if heading is None else heading
        axle = SimpleNamespace(x=x, y=y, heading=yaw)
        states.append(SimpleNamespace(rear_axle=axle, time_point=begin + float(t)))
    return SimpleNamespace(get_sampled_trajectory=lambda: states)


def message_of(
    pose: Pose, v: float, yaw: float = 0.0, steps: int = 81, heading: float | None = None
) -> dict[str, Any]:
    frame = {"t": 3.0, "ego": {"x": 0.0, "y": 0.0, "yaw": yaw, "v": v}}
    path = trajectory(pose, steps=steps, heading=heading)
    return plan_message(path, frame, Seconds())  # type: ignore[arg-type]


def columns(pose: Pose, v: float, yaw: float = 0.0, **more: Any) -> dict[str, Any]:
    message = message_of(pose, v, yaw, **more)
    return {name: column(data) for name, data in message["trajectory"].items()}


@given(v=st.floats(1.0, 30.0), aside=st.floats(-1.0, 1.0), turn=st.floats(-0.05, 0.05))
def test_a_plan_begins_at_the_ego_and_ends_on_the_trajectory(
    v: float, aside: float, turn: float
) -> None:
    def pose(t: float) -> tuple[float, float]:
        return v * t, aside + 0.5 * turn * t * t

    plan = columns(pose, v)
    assert (plan["x"][0], plan["y"][0], plan["v"][0]) == (0.0, 0.0, v)
    assert plan["t"][0] == 3.0
    assert plan["t"][-1] == pytest.approx(11.0)
    assert plan["y"][-1] == pytest.approx(pose(8.0)[1], abs=0.05)
    assert plan["v"][-1] == pytest.approx(np.hypot(v, turn * 8.0), rel=0.02)


@given(v=st.floats(2.0, 12.0), kappa=st.floats(-0.05, 0.05))
def test_curvature_is_that_of_the_path(v: float, kappa: float) -> None:
    def pose(t: float) -> tuple[float, float]:
        if abs(kappa) < 1e-6:
            return v * t, 0.0
        return float(np.sin(kappa * v * t) / kappa), float((1 - np.cos(kappa * v * t)) / kappa)

    plan = columns(pose, v)
    assert plan["kappa"][20:60] == pytest.approx(np.full(40, kappa), abs=0.002)


@pytest.mark.parametrize("v", [0.0, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_an_ego_brakes_to_a_stand_where_poses_go_backward(v: float, yaw: float) -> None:
    """As PDM-Closed brakes in an emergency: poses at 1.1 (v - 4.05)."""
    speed = 1.1 * (v - 4.05)
    plan = columns(
        lambda t: (speed * t * np.cos(yaw), speed * t * np.sin(yaw)), v, yaw, heading=yaw
    )
    assert plan["v"][10:] == pytest.approx(np.zeros(71))
    assert (np.diff(plan["v"]) <= 0.0).all()
    gone = np.hypot(plan["x"][-1], plan["y"][-1])
    assert gone == pytest.approx(0.5 * v * v / (v - speed), abs=1e-6)
    assert gone == pytest.approx(plan["x"][-1] * np.cos(yaw) + plan["y"][-1] * np.sin(yaw))
    assert plan["yaw"] == pytest.approx(np.full(81, yaw))


def test_a_trajectory_that_goes_back_after_a_brake_stands_there() -> None:
    """As PLUTO's emergency brake: it stops after 2 s, and comes back by a metre."""
    plan = columns(
        lambda t: (8.0 * t - 2.0 * t * t if t < 2.5 else 7.5 - 0.1 * t, 0.0), 8.0, heading=0.0
    )
    assert (np.diff(plan["x"]) >= -1e-9).all()
    assert plan["x"][-1] == pytest.approx(8.0, abs=0.3)
    assert plan["yaw"] == pytest.approx(np.zeros(81), abs=1e-6)
    assert np.abs(plan["a"]).max() < 6.0


@given(v=st.floats(0.0, 10.0))
def test_a_trajectory_that_stands_keeps_the_heading_of_the_ego(v: float) -> None:
    plan = columns(lambda t: (0.0, 0.0), v, yaw=1.0)
    assert (plan["v"][10:] == 0.0).all()
    assert np.isfinite(list(plan.values())).all()
    if v == 0.0:
        assert (plan["yaw"] == 1.0).all()


def turns_after(begin: float, kappa: float) -> Pose:
    """Straight on at 14 m/s, and after some seconds on an arc."""

    def pose(t: float) -> tuple[float, float]:
        s = 14.0 * max(t - begin, 0.0)
        x = 14.0 * min(t, begin) + float(np.sin(kappa * s)) / kappa
        return x, float(1.0 - np.cos(kappa * s)) / kappa

    return pose


def test_a_plan_ends_before_what_no_car_can_drive() -> None:
    message = message_of(turns_after(5.0, 1.0 / 7.5), 14.0)
    t = column(message["trajectory"]["t"])
    assert 7.0 < t[-1] <= 8.1  # it starts at 3.0
    assert "asks for" in message["reason"]
    assert all(len(column(data)) == len(t) for data in message["trajectory"].values())


@pytest.mark.parametrize(("begin", "kappa"), [(5.0, 1.0 / 40.0), (1.0, 1.0 / 7.5)])
def test_a_plan_is_whole_if_a_car_can_drive_it_or_not_even_its_first_seconds(
    begin: float, kappa: float
) -> None:
    message = message_of(turns_after(begin, kappa), 14.0)
    last = column(message["trajectory"]["t"])[-1]
    assert last == pytest.approx(11.0) if kappa < 0.1 else last < 6.5


@given(v=st.floats(2.0, 30.0), aside=st.floats(-2.0, 2.0), drift=st.floats(-1.0, 1.0))
def test_the_way_from_the_ego_to_the_path_can_be_driven(
    v: float, aside: float, drift: float
) -> None:
    """It begins in the ego's heading, and bends no more than a car can."""
    yaw = -drift / v
    plan = columns(lambda t: (v * t, aside), v, yaw)
    bound = 2.0 * min(BLEND_KAPPA, BLEND_MPS2 / v**2)
    assert abs(plan["yaw"][0] - yaw) < 0.1 * v * bound
    assert np.abs(plan["kappa"]).max() < bound


@pytest.mark.parametrize("v", [2.0, 8.0, 25.0])
@pytest.mark.parametrize("drift", [-1.0, 0.0, 1.0])
def test_an_ego_that_plans_again_at_each_step_comes_to_the_path_and_stays(
    v: float, drift: float
) -> None:
    """The ego follows each plan for a step; the path is the x axis, at a constant speed; the ego
    begins 1 m beside it, and drifts, m/s.
    """
    ego = {"x": 0.0, "y": 1.0, "yaw": drift / v, "v": v}
    offsets = []
    for _ in range(150):
        begin = ego["x"]
        path = trajectory(partial(along_x, begin, v))
        plan = plan_message(path, {"t": 3.0, "ego": ego}, Seconds())  # type: ignore[arg-type]
        step = {name: float(column(data)[1]) for name, data in plan["trajectory"].items()}
        ego = {name: step[name] for name in ego}
        offsets.append(ego["y"])
    assert np.abs(offsets[-20:]).max() < 0.05
    assert min(offsets) > -0.5


def along_x(begin: float, v: float, t: float) -> tuple[float, float]:
    return begin + v * t, 0.0


def test_the_message_of_an_error_names_call_line_and_remedy() -> None:
    def lacks() -> None:
        raise ModuleNotFoundError("No module named 'natten'", name="natten")

    with pytest.raises(Exception, match="initialize") as caught:
        called("initialize", lacks)
    text = describe(caught.value)
    assert text.startswith("initialize raised ModuleNotFoundError: No module named 'natten'")
    assert "test_nuplan_side.py:" in text
    assert "path" in text.rpartition(";")[2]


def test_the_cause_of_an_error_of_hydra_is_named() -> None:
    class InstantiationException(Exception):  # noqa: N818 - as hydra calls it
        pass

    def build() -> None:
        try:
            raise ModuleNotFoundError("No module named 'natten'", name="natten")
        except ImportError as error:
            raise InstantiationException("Error locating target") from error

    with pytest.raises(Exception, match="its constructor") as caught:
        called("its constructor", build)
    assert "raised ModuleNotFoundError: No module named 'natten'" in describe(caught.value)


def test_an_error_of_the_conversion_names_no_call() -> None:
    with pytest.raises(ValueError, match="no pose after") as caught:
        columns(lambda t: (t, 0.0), 1.0, steps=1)
    assert describe(caught.value).startswith("ValueError: the trajectory has no pose")


def test_a_call_gives_what_the_planner_answers() -> None:
    assert called("sum", sum, [1, 2]) == 3


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_the_side_of_nuplan_is_valid_for_python_3_9(file: Any) -> None:
    tree = ast.parse(file.read_text(encoding="utf-8"), feature_version=(3, 9))
    later = {("zip", "strict"), ("dataclass", "slots")}  # keywords that Python 3.9 does not have
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    used = {(ast.unparse(call.func), keyword.arg) for call in calls for keyword in call.keywords}
    assert not used & later
