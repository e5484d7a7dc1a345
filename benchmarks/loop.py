"""What a control step costs, by vehicle and controller, and the closed loop around a planner that
costs nothing.

    python benchmarks/loop.py [--vehicle NAME ...] [--controller NAME ...] [--repeat 5] [LOG ...]

Microseconds of control, vehicle and record per control step on the paper's S-curve, run in plan
periods as the closed loop does (`replan.replay.loop.plan_period`); then the closed loop with the
planner `constant_speed` over logs (none: the built-in suite), as times real time. CPU time of the
process, the least of the repetitions; it means this machine on this day.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from pathlib import Path
from time import process_time

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from rich.console import Console
from rich.table import Table

from replan.logs.plan import Plan
from replan.logs.scenario import Scenario
from replan.logs.vehicle import VehicleParameters
from replan.paper.manoeuvres import PERIOD_S, s_curve
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.plan_period import PlanPeriod, TraceRecorder
from replan.replay.loop.simulation_setup import controller_of
from replan.replay.loop_config import LoopConfig
from replan.replay.parts import CONTROLLER, VEHICLE, Part
from replan.run.sources import builtin_suite, select

PERIODS_PER_PLAN = 10
AIM_US = 5.0
SLOW = ("multibody",)
"""Measured only where asked for: a thousand times slower."""


def step_us(vehicle: str, controller: str) -> float:
    """A control step, us, over one drive."""
    car, reference = VehicleParameters(), s_curve(50.0, 12.0, "").reference
    ego = VEHICLE.builtin[vehicle](car, reference.state(0))
    steps = round(float(reference.t[-1]) / PERIOD_S) // PERIODS_PER_PLAN * PERIODS_PER_PLAN
    recorder, plan = TraceRecorder(steps, ego), Plan(reference)
    period = PlanPeriod(
        controller_of(ego, car, Part(CONTROLLER, controller), PERIOD_S), ego, PERIOD_S
    )
    at_once = PERIODS_PER_PLAN if period.is_compiled else 1
    begin = process_time()
    for first in range(0, steps, at_once):
        period.run(plan, recorder.rows, first, at_once)
    return 1e6 * (process_time() - begin) / steps


def times_real_time(scenarios: Sequence[Scenario], vehicle: str, repeat: int) -> float:
    """Driven seconds per CPU second."""
    driven = spent = 0.0
    for scenario in scenarios:
        took = []
        for _ in range(repeat + 1):
            begin = process_time()
            drive = run_closed_loop(scenario, "constant_speed", config=LoopConfig(vehicle=vehicle))
            took.append(process_time() - begin)
        driven, spent = (
            driven + float(drive.trace.ego.t[-1] - drive.trace.ego.t[0]),
            spent + min(took),
        )
    return driven / spent


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("logs", nargs="*", type=Path)
    parser.add_argument("--vehicle", action="append", choices=list(VEHICLE.builtin))
    parser.add_argument("--controller", action="append", choices=list(CONTROLLER.builtin))
    parser.add_argument("--repeat", type=int, default=5)
    chosen = parser.parse_args()
    console, table = (
        Console(),
        Table("vehicle", "controller", "us per step", title=f"aim {AIM_US} us"),
    )
    for vehicle in chosen.vehicle or [name for name in VEHICLE.builtin if name not in SLOW]:
        for controller in chosen.controller or CONTROLLER.builtin:
            # The first may compile
            took = min(step_us(vehicle, controller) for _ in range(chosen.repeat + 1))
            table.add_row(vehicle, controller, f"{took:.1f}")
    console.print(table)
    sources = select(chosen.logs) if chosen.logs else builtin_suite()
    scenarios = [source.read() for source in sources.sources]
    for vehicle in ("kinematic_bicycle", "single_track"):
        console.print(
            f"closed loop, constant_speed, {vehicle}: "
            f"{times_real_time(scenarios, vehicle, chosen.repeat):.0f}x"
        )


if __name__ == "__main__":
    main()
