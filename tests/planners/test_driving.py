"""What every planner that follows a lane does among others: one table of scenes for IDM, PDM and
the lattice.
"""

from collections.abc import Callable

import numpy as np
import pytest
from followed import Drive, check_mirrored, decided, followed, gaps
from roads import along_x, curve, lanes
from scenes import CAR, Other, driving, frame, standing

from replan.logs.agents import AgentKind
from replan.logs.catalogue import CATALOGUE
from replan.logs.frame import PlannerContext
from replan.logs.plan import DecisionKind
from replan.logs.road import Goal, Road
from replan.logs.states import EgoState
from replan.planners.base import Planner
from replan.planners.idm import Idm
from replan.planners.lattice import Lattice
from replan.planners.pdm import Pdm

Kind = Callable[[PlannerContext], Planner]
every = pytest.mark.parametrize("kind", [Idm, Pdm, Lattice])


def drives(kind: Kind, road: Road, ego: EgoState, *others: Other, seconds: float) -> Drive:
    def build(road: Road, ego: EgoState, goal: Goal | None = None) -> Planner:
        return kind(PlannerContext(road, goal, CAR, 0.1, ego))

    return followed(road, ego, others, seconds=seconds, build=build)


@pytest.mark.parametrize(("kind", "atol"), [(Idm, 2e-3), (Pdm, 5e-3), (Lattice, 2e-3)])
@pytest.mark.parametrize("name", CATALOGUE)
def test_a_mirrored_world_gives_the_mirrored_plan(
    name: str, kind: type[Planner], atol: float
) -> None:
    check_mirrored(kind, CATALOGUE[name].scenario(), atol=atol)


@pytest.mark.parametrize(("kind", "aside"), [(Idm, 0.6), (Pdm, 0.0), (Lattice, 0.6)])
def test_a_free_drive_reaches_the_limit_and_keeps_the_lanes_middle(
    kind: Kind, aside: float
) -> None:
    ego = EgoState(0.0, 0.0, aside, 0.0, 5.0)
    drive = drives(kind, lanes(along_x(end=900.0), limit=12.0), ego, seconds=30.0)
    assert drive[-1][0].ego.v == pytest.approx(12.0, abs=0.5)
    assert max(now.ego.v for now, _ in drive) <= 12.51
    assert abs(drive[-1][0].ego.y) < 0.05


@pytest.mark.parametrize(
    ("kind", "gap", "within"),
    [
        (Idm, (2.0 + 8.0 * 1.5) / np.sqrt(1.0 - (8.0 / 13.89) ** 4), 0.6),
        (Pdm, (1.0 + 8.0 * 1.5) / np.sqrt(1.0 - (8.0 / 13.89) ** 10), 1.5),
        (Lattice, 10.5, 5.5),
    ],
)
def test_the_ego_settles_behind_a_slower_leader_at_its_gap(
    kind: Kind, gap: float, within: float
) -> None:
    leader = driving("lead", 40.0, 0.0, 8.0)
    drive = drives(kind, lanes(along_x()), EgoState(0.0, 0.0, 0.0, 0.0, 10.0), leader, seconds=30.0)
    assert gaps(drive, "lead").min() > 3.0
    assert gaps(drive, "lead")[-1] == pytest.approx(gap, abs=within)
    assert drive[-1][0].ego.v == pytest.approx(8.0, abs=0.4)
    assert decided(drive[-1][1], "lead", "speed") is DecisionKind.FOLLOW
    assert not any(plan.status.is_fallback for _, plan in drive)


@pytest.mark.parametrize("kind", [Idm, Pdm])
def test_the_ego_slows_for_a_curve(kind: Kind) -> None:
    road = lanes(curve((100.0, 0.0), (60.0, 1.0 / 20.0), (100.0, 0.0)), limit=14.0)
    drive = drives(kind, road, EgoState(0.0, 0.0, 0.0, 0.0, 12.0), seconds=16.0)
    assert min(now.ego.v for now, _ in drive) < 11.0
    lateral = [abs(plan.trajectory.kappa[0]) * now.ego.v**2 for now, plan in drive]
    assert max(lateral) > 2.0 and (kind is Pdm or max(lateral) < 3.6), "PDM slows by comfort alone"


@pytest.mark.parametrize("kind", [Idm, Lattice])
def test_the_ego_lets_a_pedestrian_cross_and_drives_on(kind: Kind) -> None:
    walker = driving(
        "walker", 60.0, -6.0, 0.0, 1.2, kind=AgentKind.PEDESTRIAN, length=0.5, width=0.5
    )
    drive = drives(kind, lanes(along_x()), EgoState(0.0, 0.0, 0.0, 0.0, 10.0), walker, seconds=16.0)
    assert gaps(drive, "walker").min() > 0.45
    assert drive[-1][0].ego.v > 8.0


@every
def test_the_ego_stays_behind_a_standing_leader(kind: Kind) -> None:
    lead = standing("lead", CAR.axle_to_front + 2.25 + 1.0, 0.0)
    drive = drives(kind, lanes(along_x()), EgoState(0.0, 0.0, 0.0, 0.0, 0.0), lead, seconds=3.0)
    assert max(now.ego.x for now, _ in drive) < 0.05


@every
def test_outside_the_lines_frame_the_ego_stops(kind: Kind) -> None:
    road, ego = lanes(along_x()), EgoState(0.0, 0.0, 0.0, 1.5, 5.0)
    plan = kind(PlannerContext(road, None, CAR, 0.1, ego)).plan(frame(ego))
    assert plan.status.is_fallback and plan.trajectory.v[-1] == 0.0
