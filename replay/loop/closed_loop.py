"""Closed loop: frame -> plan -> control -> step -> trace, until the drive ends."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from types import MappingProxyType

from replan.core.errors import PlannerError
from replan.logs.plan import Plan
from replan.logs.scenario import Scenario
from replan.logs.trace import EndReason, Mode, Trace
from replan.logs.tracks import Tracks
from replan.replay.drive import Drive
from replan.replay.loop.plan_period import Latency, TraceRecorder
from replan.replay.loop.planning import Planning, Seat
from replan.replay.loop.simulation_setup import SimulationSetup
from replan.replay.loop.termination import Ended, Termination
from replan.replay.loop_config import DEFAULT_LOOP, LoopConfig
from replan.replay.perception import Perception
from replan.replay.vehicle.state_records import Records


def run_closed_loop(
    scenario: Scenario,
    planner: str,
    *,
    planner_config: Mapping[str, object] = MappingProxyType({}),
    config: LoopConfig = DEFAULT_LOOP,
    keep_internals: bool = True,
    until_s: float = inf,
    seat: Seat = Planning,
) -> Drive:
    """Drive a scenario with a planner, with the plan period and the control period of `config`.

    The ego starts as logged and is then moved by the vehicle model; `config.traffic` moves the
    others. The planner's internals are only built if they are kept. The last frame is at `until_s`,
    s since the scenario's start. `seat` builds the object that calls the planner.

    Raises:
        LogError: The log ends before the first control step.
        ConfigError: A name of `config` or a keyword of the planner is unknown.
        PlannerError: The planner cannot be loaded or built. (One that fails while driving ends the
            drive.)
    """
    setup = SimulationSetup.of(scenario, config, until_s)
    world, latency = setup.world(), Latency(config.plan_delay_steps)
    planning = seat(
        scenario, planner, planner_config, config, world.ego, keep_internals=keep_internals
    )
    perception = Perception(scenario, config)
    ended = (
        _never_ends if config.drives_on else Termination(scenario, planning.goal, world.ego).first
    )
    recorder, period = TraceRecorder(setup.steps, setup.vehicle), setup.plan_period()
    plan: Plan | None = None
    end: Ended | None = None
    step = 0

    while end is None and step < setup.steps:
        if step % setup.steps_per_plan == 0:
            try:
                frame = perception.frame(world, latency.before(step))
                new_plan = planning.plan(frame)
            except PlannerError as failure:
                end = Ended(step, EndReason.PLANNER_FAILURE, str(failure))
                break
            recorder.planned(frame, new_plan)
            latency.planned(step, new_plan)
        plan = latency.at(step)
        until = setup.horizon(step) if period.is_compiled else step + 1
        change = latency.next_change(step)
        until = until if change is None else min(until, change)
        period.run(plan, recorder.rows, step, until - step)
        end = ended(recorder.rows, step + 1, until, world.tracks)
        if end is None:
            world = setup.world()
            end = ended(recorder.rows, until, until + 1, world.tracks)
        step = until

    recorder.close(end.row if end else step, plan)
    trace = Trace(
        scenario=scenario.name,
        planner=planner,
        mode=Mode.CLOSED,
        oracle=planning.is_oracle or perception.is_oracle,
        ego=recorder.ego,
        agents=world.tracks.whole,
        frames=recorder.frames.frames,
        end=end.reason if end else EndReason.END_OF_LOG,
        detail=end.detail if end else setup.end,
        commands=recorder.commands,
        actuation=recorder.actuation,
        tracking=recorder.errors,
        notes=(*planning.notes, *perception.notes, *setup.notes),
        perceived=perception.shown,
    )
    return Drive(trace, planning.timings, planning.marks)


def _never_ends(_rows: Records, _first: int, _end: int, _tracks: Tracks) -> Ended | None:
    """`Termination.first` of a drive that goes on whatever happens (`LoopConfig.drives_on`)."""
    return None
