"""Where the CPU time of an evaluation goes that is not planning: one log, stage by stage, and how
it grows.

    python benchmarks/around.py [--planner constant_speed] [--family everyday/junction]

The stages are those of `replan.run.one_log`, without recordings, the best of some passes. Then what
leaving the road, the speed limit and the lane's direction cost on logs of 28 to 600 s; how much
memory is left behind by a drive that is over; and how long the imports take in a new process.
"""

from __future__ import annotations

import argparse
import gc
import subprocess
import sys
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from replan import metrics
from replan.config import RunConfig
from replan.logs.catalogue import CATALOGUE
from replan.logs.mcap import read_scenario, write_scenario, write_trace
from replan.logs.road import Road, RoadSource
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.trace import EndReason, Mode, Trace
from replan.logs.tracks import Tracks
from replan.metrics.lane_position import wrong_way
from replan.metrics.off_road import off_road
from replan.metrics.speed_limits import speed_excess
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.open_loop import run_open_loop
from replan.replay.loop.reference_drives import reference_table, with_avoidability
from replan.results.log_result import Stamp
from replan.run.log_source import LogSource
from replan.run.one_log import evaluate_log

PASSES = 4
LENGTHS_S = (28.0, 120.0, 600.0)
GROWING = (off_road, speed_excess, wrong_way)


def best_ms(act: Callable[[], Any], passes: int = PASSES) -> float:
    """CPU time of the quickest of some passes, after one that does not count, ms."""
    act()
    found = []
    for _ in range(passes):
        begin = time.process_time()
        act()
        found.append(1e3 * (time.process_time() - begin))
    return min(found)


def stages(family: str, planner: str, folder: Path) -> dict[str, float]:
    """Ms of each stage of one log."""
    made = CATALOGUE[family].scenario()
    path = folder / "log.mcap"
    write_scenario(path, made)
    scenario = with_avoidability(made)
    drives = [run(scenario, planner) for run in (run_open_loop, run_closed_loop)]

    def traces(internals: Any) -> None:
        for drive in drives:
            write_trace(folder / "trace.mcap", drive.trace, scenario, internals=internals)

    def judged() -> None:
        for drive in drives:
            metrics.evaluate_with_series(drive.trace, scenario)

    config = RunConfig(planners=(planner,), recording=False, internals="none")
    numbers = iter(range(1000))

    def whole() -> None:
        out = folder / f"run{next(numbers)}"
        out.mkdir()
        evaluate_log(LogSource(str(path), path), config, out, Stamp("", ""))

    return {
        "read the log": best_ms(lambda: read_scenario(path)),
        "careful driver, avoidability": best_ms(lambda: with_avoidability(made)),
        "reference drives, measured": best_ms(lambda: reference_table(scenario)),
        "open loop": best_ms(lambda: run_open_loop(scenario, planner)),
        "closed loop": best_ms(lambda: run_closed_loop(scenario, planner)),
        "metrics and series of both": best_ms(judged),
        "traces of both, internals none": best_ms(lambda: traces("none")),
        "traces of both, internals summary": best_ms(lambda: traces("summary")),
        "the whole log, internals none": best_ms(whole),
    }


def long_drive(seconds: float) -> tuple[Trace, Scenario]:
    """A drive at 13 m/s along one winding lane, at 100 Hz."""
    t = np.arange(0.0, seconds, 0.01)
    x, y = 13.0 * t, 20.0 * np.sin(13.0 * t / 150.0)
    yaw = np.arctan2(np.gradient(y), np.gradient(x))
    ego = Trajectory(t, x, y, yaw, 13.0 + 0.0 * t, 0.0 * t, 0.0 * t)
    road = replace(
        Road.along(np.column_stack([x, y])[::10], speed_limit=13.9), source=RoadSource.LANES
    )
    trace = Trace(
        "long", "nobody", Mode.CLOSED, False, ego, Tracks.empty(), (), EndReason.END_OF_LOG
    )
    return trace, Scenario("long", ego, Tracks.empty(), road, float(t[-1]))


def growing(trace: Trace, scenario: Scenario) -> dict[str, float]:
    """Ms of each metric of `GROWING`; each time of a new trace, of which nothing is known yet."""
    return {
        m.name: best_ms(partial(lambda m: m.measure(replace(trace), scenario), m)) for m in GROWING
    }


def kept_mb(family: str, planner: str) -> float:
    """What some drives and their metrics leave behind when they are over, MB a drive."""
    scenario = CATALOGUE[family].scenario()

    def drive() -> None:
        metrics.evaluate(run_closed_loop(scenario, planner).trace, scenario)

    drive()
    tracemalloc.start()
    drive()
    gc.collect()
    before = tracemalloc.get_traced_memory()[0]
    for _ in range(PASSES):
        drive()
    gc.collect()
    kept = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    return kept / PASSES / 2**20


def import_s() -> float:
    """CPU time of a new process that imports the command line, s; best of some."""
    code = (
        "import time; begin = time.process_time(); import replan.cli; print(time.process_time() "
        "- begin)"
    )
    runs = [
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        for _ in range(3)
    ]
    return min(float(run.stdout) for run in runs)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--planner", default="constant_speed")
    parser.add_argument("--family", default="everyday/junction")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for stage, took in stages(asked.family, asked.planner, Path(folder)).items():
            print(f"{stage:36s} {took:8.1f} ms")
    print("\nms for each second of a drive:")
    for seconds in LENGTHS_S:
        found = growing(*long_drive(seconds))
        print(
            f"{seconds:6.0f} s",
            "  ".join(f"{name} {took / seconds:.3f}" for name, took in found.items()),
        )
    print(f"\nleft behind by a drive: {kept_mb(asked.family, asked.planner):.3f} MB")
    print(f"imports: {import_s():.2f} s")


if __name__ == "__main__":
    main()
