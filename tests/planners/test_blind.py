import numpy as np
import pytest
from drives import along, grid, moving, scenario, straight_road

from replan.logs.agents import AgentKind
from replan.logs.plan import PlanStatus
from replan.logs.trace import EndReason
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.reference_drives import BAD_PERIODS_S
from replan.replay.loop_config import LoopConfig

LOOP = LoopConfig(*BAD_PERIODS_S, vehicle="perfect")


def driven(planner: str, v: float, **config: object) -> object:
    car = ("1", AgentKind.CAR, (4.5, 1.8), moving(80.0, 0.0, 0.0, 0.0, yaw=0.0))
    log = scenario(along(grid(12.0), v), [car], road=straight_road(limit=13.9))
    return run_closed_loop(
        log, planner, planner_config=config, config=LOOP, keep_internals=False
    ).trace


def test_the_blind_driver_drives_into_a_standing_car_and_idm_does_not() -> None:
    assert driven("blind", 10.0).end is EndReason.COLLISION
    assert driven("idm", 10.0).end is not EndReason.COLLISION


@pytest.mark.parametrize("v", [0.0, 3.0, 10.0])
def test_the_parked_driver_stops_comfortably_and_stays(v: float) -> None:
    ego = driven("parked", v).ego
    assert ego.v[-1] == pytest.approx(0.0, abs=1e-6)
    assert ego.a.min() >= -3.0 - 1e-9
    assert ego.x[-1] - ego.x[0] == pytest.approx(v * v / 6.0 + v, abs=v + 0.1)
    assert (np.diff(ego.x) >= -1e-9).all()


@pytest.mark.parametrize("v", [0.0, 10.0])
def test_a_creeping_driver_comes_to_its_speed(v: float) -> None:
    assert driven("parked", v, speed_mps=2.0).ego.v[-1] == pytest.approx(2.0, abs=1e-6)


@pytest.mark.parametrize("v", [0.0, 12.0, 25.0])
@pytest.mark.parametrize("wish", [0.0, 2.0])
def test_a_drive_does_not_depend_on_how_often_it_is_planned(v: float, wish: float) -> None:
    """Plans follow each other without a jump, however far the ego drives on one of them."""
    log = scenario(along(grid(12.0), v), [], road=straight_road(limit=30.0))
    ends = []
    for period in (0.1, 4.0):
        loop = LoopConfig(period, 0.1, vehicle="perfect")
        trace = run_closed_loop(
            log, "parked", planner_config={"speed_mps": wish}, config=loop
        ).trace
        assert all(frame.plan.status is PlanStatus.PLANNED for frame in trace.frames)
        ends.append(trace.ego.x[-1])
    assert ends[0] == pytest.approx(ends[1], abs=0.2)
