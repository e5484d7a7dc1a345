"""Open loop: plans from the logged state at each frame of a grid over the logged drive.

The ego is not moved.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from types import MappingProxyType

import numpy as np

from replan.core.errors import PlannerError
from replan.logs.frame_store import FrameStore
from replan.logs.scenario import Scenario
from replan.logs.states import TRAJECTORY_COLUMNS, Trajectory
from replan.logs.trace import EndReason, Mode, PlannedFrame, Trace
from replan.replay.drive import Drive
from replan.replay.loop.planning import Planning, Seat
from replan.replay.loop_config import DEFAULT_LOOP, LoopConfig
from replan.replay.perception import Perception
from replan.replay.world import World, logged_ego


def run_open_loop(
    scenario: Scenario,
    planner: str,
    *,
    planner_config: Mapping[str, object] = MappingProxyType({}),
    config: LoopConfig = DEFAULT_LOOP,
    keep_internals: bool = True,
    until_s: float = inf,
    seat: Seat = Planning,
) -> Drive:
    """Plan at every `config.plan_period_s` of the ego's log, from its first sample to its last.

    Between two samples of the log, the earlier one is extrapolated: no later sample is used. The
    planner's memory is fresh at every frame (`Frame.previous` is None). The planner's internals are
    only built where they are kept. The last frame is at `until_s`, s since the scenario's start.
    `seat` builds the object that calls the planner.

    Raises:
        ConfigError: A name of `config` or a keyword of the planner is unknown.
        PlannerError: The planner cannot be loaded or built. (One that fails at a frame ends the
            loop there.)
    """
    every = frame_times(scenario.ego, config.plan_period_ns)
    grid = every[:1] + [t for t in every[1:] if t <= until_s]
    egos = [logged_ego(scenario.ego, scenario.vehicle, t) for t in grid]
    planning = seat(
        scenario, planner, planner_config, config, egos[0], keep_internals=keep_internals
    )
    perception = Perception(scenario, config)
    frames = FrameStore()
    end, detail = EndReason.END_OF_LOG, ""

    for ego in egos:
        try:
            frame = perception.frame(World(ego, scenario.tracks), None)
            plan = planning.plan(frame)
        except PlannerError as failure:
            end, detail = EndReason.PLANNER_FAILURE, str(failure)
            break
        frames.append(PlannedFrame.of(frame, plan))

    driven = egos[: max(len(frames), 1)]
    trace = Trace(
        scenario=scenario.name,
        planner=planner,
        mode=Mode.OPEN,
        oracle=planning.is_oracle or perception.is_oracle,
        ego=Trajectory(
            *(np.array([getattr(ego, name) for ego in driven]) for name in TRAJECTORY_COLUMNS)
        ),
        agents=scenario.tracks,
        frames=frames.frames,
        end=end,
        detail=detail,
        notes=(*planning.notes, *perception.notes),
        perceived=perception.shown,
    )
    return Drive(trace, planning.timings, planning.marks)


def frame_times(log: Trajectory, period_ns: int) -> list[float]:
    """Return the frame times of a log, s: from its first sample to its last at most.

    At least one frame.
    """
    first, last = round(float(log.t[0]) * 1e9), round(float(log.t[-1]) * 1e9)
    return [ns / 1e9 for ns in range(first, last + 1, period_ns)]
