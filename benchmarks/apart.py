"""What it costs to keep a planner apart: per frame among crowds, and per drive.

    python benchmarks/apart.py [--rounds 5]

The same planner (`constant_speed`) plans the frames of the same drive in this process and in its
own, in turn; the difference of the medians of `plan()` is the boundary: frame out, plan back. A
drive costs the start of its process besides, which is forked from a warm one; that one is started
once per worker.
"""

from __future__ import annotations

import argparse
import time
from statistics import median

from crowds import CROWDS, LASTS_S, crowded

from replan.logs.catalogue import CATALOGUE
from replan.logs.scenario import Scenario
from replan.replay.loop.open_loop import run_open_loop
from replan.replay.loop_config import LoopConfig
from replan.replay.perception import Perception
from replan.replay.planner_process.messages import encode, frame_message
from replan.replay.planner_process.processes import _launcher
from replan.replay.world import World, logged_ego

BUILT_IN, APART = "constant_speed", "replan.planners.constant_speed:ConstantSpeed"


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    log = CATALOGUE["everyday/junction"].scenario()
    begin = time.perf_counter()
    run_open_loop(log, APART)
    print(f"first drive of a worker, its launcher started: {time.perf_counter() - begin:.2f} s")
    print("agents  frame [kB]  in process [ms]  apart [ms]  boundary p50 [ms]  p95 [ms]")
    for agents in (0, *CROWDS):
        made = crowded(log, agents) if agents else log
        inside, outside = [], []
        for _ in range(rounds):
            inside += plan_ms(made, BUILT_IN)
            outside += plan_ms(made, APART)
        p95 = sorted(outside)[int(0.95 * len(outside))] - median(inside)
        gap = median(outside) - median(inside)
        here, there = median(inside), median(outside)
        print(
            f"{agents:6d}  {size_kb(made):10.0f}  {here:15.3f}  {there:10.3f}  {gap:17.3f}  "
            f"{p95:8.3f}"
        )
    costs = [drive_s(log, APART) - drive_s(log, BUILT_IN) for _ in range(4 * rounds)]
    print(f"a drive of one frame more: {1e3 * median(costs):.1f} ms (warm)")
    assert _launcher(()).alive


def plan_ms(log: Scenario, planner: str) -> list[float]:
    """How long each plan of an open loop took while the crowd is there, but the first, ms."""
    times = run_open_loop(log, planner, keep_internals=False).timings
    return [1e3 * lap.seconds for lap in times if lap.stage == "total" and 0.0 < lap.t <= LASTS_S]


def drive_s(log: Scenario, planner: str) -> float:
    """How long a drive of one frame takes, s."""
    begin = time.perf_counter()
    run_open_loop(log, planner, config=LoopConfig(plan_period_s=1e3))
    return time.perf_counter() - begin


def size_kb(log: Scenario) -> float:
    """The first frame's message, kB."""
    config = LoopConfig()
    world = World(logged_ego(log.ego, log.vehicle, float(log.ego.t[0])), log.tracks)
    return len(encode(frame_message(Perception(log, config).frame(world, None)))) / 1e3


if __name__ == "__main__":
    main()
