"""How long a command takes, per controller: on the paper's S-curve with the single-track vehicle.

    python benchmarks/control.py [--controller NAME ...] [--vehicle single_track] [--repeat 3]

Microseconds of `control()`, median and 99th percentile over all commands but the first of each
drive; for the MPC, which solves at every fifth, those that solve apart. CPU time of the thread,
since a shared machine takes the processor away for milliseconds at a time; it means this machine on
this day.
"""

from __future__ import annotations

import argparse
import os
from time import thread_time

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from rich.console import Console
from rich.table import Table

from replan.core.arrays import FloatArray
from replan.logs.plan import Plan
from replan.logs.vehicle import VehicleParameters
from replan.paper.manoeuvres import PERIOD_S, s_curve
from replan.replay.loop.simulation_setup import controller_of
from replan.replay.parts import CONTROLLER, VEHICLE, Part

SOLVES_EVERY = {"mpc": 5}


def step_times(controller: str, vehicle: str) -> FloatArray:
    """Seconds of each command of one drive `(n,)`."""
    car, reference = VehicleParameters(), s_curve(50.0, 12.0, "").reference
    ego = VEHICLE.builtin[vehicle](car, reference.state(0))
    driver, plan, times = (
        controller_of(ego, car, Part(CONTROLLER, controller), PERIOD_S),
        Plan(reference),
        [],
    )
    for _ in range(round(float(reference.t[-1]) / PERIOD_S)):
        state = ego.state
        begin = thread_time()
        command = driver.control(state, plan)
        times.append(thread_time() - begin)
        ego.step(command, PERIOD_S)
    return np.array(times)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--controller", action="append", choices=list(CONTROLLER.builtin))
    parser.add_argument("--vehicle", default="single_track", choices=list(VEHICLE.builtin))
    parser.add_argument("--repeat", type=int, default=3)
    chosen = parser.parse_args()
    table = Table("controller", "commands", "p50 us", "p99 us")
    for name in chosen.controller or CONTROLLER.builtin:
        step_times(name, chosen.vehicle)  # compiles, fills tables
        drives = [step_times(name, chosen.vehicle) for _ in range(chosen.repeat)]
        every = SOLVES_EVERY.get(name, 1)
        groups = {"all": [one[1:] for one in drives]}
        if every > 1:
            groups = {"all": groups["all"], "that solve": [one[every::every] for one in drives]}
        for said, times in groups.items():
            p50, p99 = 1e6 * np.percentile(np.concatenate(times), [50.0, 99.0])
            table.add_row(name, said, f"{p50:.1f}", f"{p99:.1f}")
    Console().print(table)


if __name__ == "__main__":
    main()
