"""Memory goes in and comes out; what a plan came from is built once, and only for who looks."""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
from followed import PERIOD_S, Drive, followed, planner
from hypothesis import given, strategies as st
from roads import along_x, lanes, two_way
from scenes import CAR, Other, driving, frame, standing

from replan.logs.agents import AgentKind
from replan.logs.frame import PlannerContext
from replan.logs.plan import Artefact, Internals, PlanStatus, SolverReport, StGraph
from replan.logs.states import EgoState
from replan.planners.dp_qp import DpQpConfig
from replan.planners.dp_qp.lane import LaneMemory, LanePlan, LanePlanner
from replan.planners.dp_qp.planner import PassMemory, passing
from replan.planners.frenet.lane_sequences import LaneSequences

TWO, EGO = lanes(along_x(), 2), EgoState(0.0, 0.0, 0.0, 0.0, 9.0)


def hesitates(t: float) -> tuple[float, float, float, float, float]:
    """Walks to the lane's edge, and stands there."""
    y = min(-5.0 + 1.4 * t, -2.4)
    return 45.0, y, 0.5 * np.pi, 0.0, 1.4 if y < -2.4 else 0.0


CROWD = (
    standing("parked", 30.0, -2.2),
    driving("rider", 60.0, -0.8, 3.0, length=1.8, width=0.6, kind=AgentKind.BICYCLE),
    Other("walker", hesitates, AgentKind.PEDESTRIAN, 0.5, 0.6),
    driving("beside", -15.0, 3.5, 9.0),
)


def same(one: object, two: object) -> bool:
    """Whether two values are equal to the last bit, field by field."""
    if is_dataclass(one):
        return type(one) is type(two) and all(
            same(getattr(one, f.name), getattr(two, f.name)) for f in fields(one)
        )
    if isinstance(one, np.ndarray):
        return (
            isinstance(two, np.ndarray)
            and one.shape == two.shape
            and one.tobytes() == two.tobytes()
        )
    if isinstance(one, Mapping):
        return (
            isinstance(two, Mapping)
            and [*one] == [*two]
            and all(same(one[key], two[key]) for key in one)
        )
    if isinstance(one, tuple | list):
        return len(one) == len(two) and all(map(same, one, two))  # type: ignore[arg-type]
    return bool(one == two)


def lane_planner() -> LanePlanner:
    context = PlannerContext(two_way(), None, CAR, PERIOD_S, EGO)
    return LanePlanner(LaneSequences(context).start(EGO), context)


def found(plan: LanePlan) -> tuple[object, ...]:
    """What a plan is, without who made it."""
    speed = plan.speed
    assert speed is not None
    return (
        plan.path.path,
        plan.path.passed,
        speed.profile,
        speed.reason,
        plan.costs,
        plan.artefacts(),
    )


@pytest.mark.parametrize(
    ("others", "remembered"), [(CROWD, {"came", "standing"}), (CROWD[1:2], {"came", "passed"})]
)
def test_the_same_scene_and_memory_give_the_same_plan_and_memory(
    others: Sequence[Other], remembered: set[str]
) -> None:
    """All along a drive, in a lane and past who is slower in it.

    What went in is what it was, to the last bit.
    """
    driver, other = lane_planner(), lane_planner()
    memory, past, ego, kept = LaneMemory(), PassMemory(), EGO, set()
    for k in range(40):
        now = frame(ego, others, t=k * PERIOD_S)
        before = deepcopy((memory, past))
        scene = driver.scene(now, ego, memory)
        keep, after = driver.plan("keep", scene, memory)
        plan, _, passed = passing(keep, driver, past, DpQpConfig(), passes_left=True)
        again, after_again = other.plan("keep", other.scene(now, ego, memory), memory)
        plan_again, _, passed_again = passing(again, other, past, DpQpConfig(), passes_left=True)
        assert same(found(keep), found(again)) and same(found(plan), found(plan_again))
        assert same(after, after_again) and same(passed, passed_again)
        assert same((memory, past), before)
        memory, past = after, passed
        kinds = {"came": memory.speed.came, "standing": memory.path.standing, "passed": past.passed}
        kept |= {name for name, value in kinds.items() if value}
        assert (
            plan.speed is not None and plan.speed.profile is not None and plan.path.path is not None
        )
        way = plan.path.path
        s, v, a = plan.speed.profile[:, 1]
        x, y, yaw, kappa = (
            float(np.interp(s, way.sigma, c)) for c in (way.x, way.y, way.yaw, way.kappa)
        )
        ego = EgoState((k + 1) * PERIOD_S, x, y, yaw, float(v), float(a), kappa)
    assert kept == remembered  # that is: there was something to remember


@given(
    st.integers(0, 4),
    st.lists(st.one_of(st.integers(-1, 0), st.just(slice(None)), st.none()), max_size=5),
)
def test_internals_are_built_once_and_on_demand(
    count: int, looks: list[int | slice | None]
) -> None:
    report, built = SolverReport("a stage", True, "solved", 3, 0.0, 0.0), []
    parts: tuple[Artefact, ...] = (report, *(replace(report, iterations=i) for i in range(count)))

    def build() -> tuple[Artefact, ...]:
        built.append(1)
        return parts

    internals = Internals((report,), build)
    assert internals.reports == (report,) and not built
    for look in looks:
        assert len(internals) == len(parts) if look is None else internals[look] == parts[look]
    assert len(built) == min(len(looks), 1)
    assert tuple(internals) == parts and report in internals and len(built) == 1


def driven() -> Drive:
    return followed(TWO, EGO, CROWD, seconds=2.0)


def test_internals_that_are_read_late_equal_those_read_at_once() -> None:
    """The plans of a drive, each looked at when it was made; and all of them after the drive."""
    driver, eager = planner(TWO, EGO), []
    late = driven()
    for now, plan in late:
        made = driver.plan(replace(now, previous=now.previous))
        assert made.status is PlanStatus.PLANNED and same(made.trajectory, plan.trajectory)
        eager.append(tuple(made.internals))
    for (_, plan), at_once in zip(late, eager, strict=True):
        assert same(tuple(plan.internals), at_once)
    assert any(isinstance(item, StGraph) and len(item.obstacles) for some in eager for item in some)
