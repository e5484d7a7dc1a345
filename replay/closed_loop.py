"""Closed loop: frame -> plan -> control -> step -> trace, until the drive ends."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from logs.errors import PlannerError
from logs.scenario import Scenario
from logs.trace import EndReason, Mode, Trace
from replay.drive import DEFAULT_LOOP, Drive, LoopConfig
from replay.ending import Ending
from replay.journal import Journal
from replay.latency import Latency
from replay.perception import Perception
from replay.planning import Planning
from replay.rig import Rig


def run_closed_loop(
    scenario: Scenario,
    planner: str,
    *,
    planner_config: Mapping[str, object] = MappingProxyType({}),
    config: LoopConfig = DEFAULT_LOOP,
) -> Drive:
    """Drive a scenario with a planner: plan at `config.plan_period_s`, control and step at `config.control_period_s`.

    The ego starts as logged and is then moved by the vehicle model; the others by `config.traffic`.

    Raises:
        LogError: The log has no time to drive.
        ConfigError: A name of `config` or a keyword of the planner is unknown.
        PlannerError: The planner cannot be loaded or built. (One that fails while driving ends the drive.)
    """
    rig = Rig.of(scenario, config)
    world, latency = rig.world(), Latency(config.plan_delay_steps)
    planning = Planning(scenario, planner, planner_config, config, world.ego)
    perception = Perception(scenario, config)
    ending = Ending(scenario, planning.goal, world)
    journal = Journal(len(rig.steps) + 1)
    end = (EndReason.END_OF_LOG, "")

    for step in rig.steps:
        if step % rig.steps_per_plan == 0:
            try:
                frame = perception.frame(world, latency.before(step))
                made = planning.plan(frame)
            except PlannerError as failure:
                end = (EndReason.PLANNER_FAILURE, str(failure))
                break
            journal.planned(frame, made)
            latency.planned(step, made)
        plan = latency.at(step)
        command = rig.controller.control(world.ego, plan)
        journal.add(world.ego, command, rig.vehicle.actuation, plan)
        rig.vehicle.step(command, rig.period)
        world = rig.world()
        ended = ending.of(world)
        if ended:
            end = ended
            break

    journal.close(world.ego, rig.vehicle.actuation)
    trace = Trace(
        scenario=scenario.name,
        planner=planner,
        mode=Mode.CLOSED,
        oracle=planning.is_oracle or perception.is_oracle,
        ego=journal.ego,
        agents=world.tracks,
        frames=tuple(journal.frames),
        end=end[0],
        detail=end[1],
        commands=journal.commands,
        actuation=journal.actuation,
        tracking=journal.errors,
        notes=(*planning.notes, *perception.notes, *rig.notes, *rig.told),
        perceived=perception.shown,
    )
    return Drive(trace, tuple(planning.timings))
