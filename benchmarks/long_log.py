"""What a long log costs: peak memory and CPU time by stage, of one drive after the other.

    python benchmarks/long_log.py [--seconds 3600] [--planner constant_speed] [--mode open --mode closed]
                                  [--internals summary] [--no-recording] [--denser 1] [--write FILE]

The log: a straight road of two lanes, 10 m/s, and some thirty road users at a time who come and go:
cars on the facing lane, pedestrians on both sides. Peaks are of the resident set (Linux), set back
before each stage.
"""  # noqa: E501

from __future__ import annotations

import argparse
import gc
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from math import pi
from pathlib import CurveSamples as File
from time import process_time

import numpy as np
from rich.console import Console

from replan.core.arrays import FloatArray
from replan.core.memory import trim_memory
from replan.logs.agents import AgentKind
from replan.logs.catalogue.family_parts import ADULT, CAR, Agent, tracks
from replan.logs.catalogue.roads import LANE_WIDTH_M, CurveSamples, curve, two_way
from replan.logs.mcap import read_scenario, write_scenario
from replan.logs.road import Lane, Road
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.trace import Mode

SPEED_MPS, SAMPLE_S = 10.0, 0.1
PIECE_M = 400.0
SEEN_M, BESIDE_M = 300.0, 4.0
CARS_M, PEDESTRIANS_M = 30.0, 60.0
"""Between two of a kind, m; those who come the other way are met twice as often."""


def long_log(seconds: float, denser: float = 1.0) -> Scenario:
    """The log of the module docstring; so many times as many road users."""
    path = curve((SPEED_MPS * (seconds + 60.0), 0.0, 0.0))
    t = np.round(SAMPLE_S * np.arange(round(seconds / SAMPLE_S) + 1), 9)
    x, y, yaw, kappa = path.at(50.0 + SPEED_MPS * t)
    ego = Trajectory(t, x, y, yaw, np.full(len(t), SPEED_MPS), np.zeros(len(t)), kappa)
    return Scenario("long", ego, tracks(list(_others(path, t, denser))), _road(path), seconds)


def _road(path: CurveSamples) -> Road:
    """Two lanes, a piece after the other."""
    lanes: dict[int, Lane] = {}
    count = int(path.length // PIECE_M)
    for k in range(count):
        own, back = two_way(path.part(k * PIECE_M, (k + 1) * PIECE_M), SPEED_MPS).lanes.values()
        own_next, back_next = (2 * k + 3,) if k + 1 < count else (), (2 * k,) if k else ()
        lanes[2 * k + 1] = _numbered(own, 2 * k + 1, 2 * k + 2, own_next)
        lanes[2 * k + 2] = _numbered(back, 2 * k + 2, 2 * k + 1, back_next)
    return Road(lanes, default_speed_limit=SPEED_MPS)


def _numbered(lane: Lane, name: int, beside: int, successors: tuple[int, ...]) -> Lane:
    return Lane(
        name,
        lane.left,
        lane.right,
        successors=successors,
        left_neighbour=beside,
        left_opposite=True,
        left_crossable=True,
        speed_limit=SPEED_MPS,
    )


def _others(path: CurveSamples, t: FloatArray, denser: float) -> Iterator[Agent]:
    """Who is within `SEEN_M` of the ego is in the log; each comes and goes once."""
    ego = 50.0 + SPEED_MPS * t
    for k, start in enumerate(np.arange(100.0, 2.0 * ego[-1], CARS_M / denser)):
        yield from _seen(
            path, f"car{k}", AgentKind.CAR, CAR, t, start - SPEED_MPS * t, ego, LANE_WIDTH_M, pi
        )
    for k, start in enumerate(np.arange(80.0, ego[-1], PEDESTRIANS_M / denser)):
        aside = BESIDE_M if k % 2 else -BESIDE_M
        left = aside + (LANE_WIDTH_M if k % 2 else 0.0)
        yield from _seen(
            path, f"walker{k}", AgentKind.PEDESTRIAN, ADULT, t, start + 0.0 * t, ego, left, 0.0
        )


def _seen(
    path: CurveSamples,
    name: str,
    kind: AgentKind,
    size: tuple[float, float],
    t: FloatArray,
    s: FloatArray,
    ego: FloatArray,
    left: float,
    turned: float,
) -> Iterator[Agent]:
    there = (np.abs(s - ego) <= SEEN_M) & (s > 0.0) & (s < path.length)
    if np.count_nonzero(there) < 2:
        return
    xy, yaw = path.beside(s[there], left), np.unwrap(path.at(s[there])[2] + turned)
    vx, vy = (np.gradient(xy[:, c], t[there]) for c in (0, 1))
    yield Agent(name, kind, size, np.column_stack([t[there], xy, yaw, vx, vy]))


@contextmanager
def stage(console: Console, name: str) -> Iterator[None]:
    """Say what it took."""
    gc.collect()
    trim_memory()  # as a worker does between the stages of a long drive
    File("/proc/self/clear_refs").write_text("5")
    begin = process_time()
    yield
    took, lines = process_time() - begin, dict(_status())
    console.print(
        f"{name:34} peak {lines['VmHWM']:6.0f} MB  after {lines['VmRSS']:6.0f} MB  CPU {took:6.1f} "
        "s"
    )


def _status() -> Iterator[tuple[str, float]]:
    for line in File("/proc/self/status").read_text().splitlines():
        if line.endswith(" kB"):
            yield line.partition(":")[0], int(line.split()[1]) / 1024.0


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=3600.0)
    parser.add_argument("--planner", default="constant_speed")
    parser.add_argument("--mode", action="append", choices=[mode.value for mode in Mode])
    parser.add_argument("--internals", default="summary")
    parser.add_argument("--no-recording", action="store_true")
    parser.add_argument(
        "--denser", type=float, default=1.0, help="so many times as many road users"
    )
    parser.add_argument("--write", type=File, help="write the log there, and no more")
    chosen = parser.parse_args()
    if chosen.write:
        write_scenario(chosen.write, long_log(chosen.seconds, chosen.denser))
        return
    console = Console()
    console.print(vars(chosen))
    with tempfile.TemporaryDirectory() as folder:
        file = File(folder) / "long.mcap"
        with stage(console, "synthesise and write"):
            write_scenario(file, long_log(chosen.seconds, chosen.denser))
        with stage(console, "read"):
            scenario = read_scenario(file)
        console.print(f"{len(scenario.tracks)} road users, {len(scenario.tracks.t)} samples")
        for mode in chosen.mode or ("open", "closed"):
            measured(console, scenario, Mode(mode), chosen, File(folder))


def measured(
    console: Console, scenario: Scenario, mode: Mode, chosen: argparse.Namespace, folder: File
) -> None:
    """The stages of one drive, as a worker has them (`replan.run.one_log`)."""
    from replan import metrics
    from replan.draw.panels import MEASURED
    from replan.logs.mcap import write_trace
    from replan.replay.loop.reference_drives import reference_table
    from replan.results.log_result import Steps, StepsFile
    from replan.run.one_log import LOOPS

    keep = not chosen.no_recording or chosen.internals != "none"
    if mode is Mode.CLOSED:
        with stage(console, "reference drivers"):
            reference_table(scenario)
    with stage(console, f"{mode.value}: drive"):
        drive = LOOPS[mode](scenario, chosen.planner, keep_internals=keep)
    with stage(console, f"{mode.value}: metrics"):
        steps, found = StepsFile(folder), dict[str, Steps]()
        keeping = lambda name, series: found.setdefault(name, steps.put(name, series))  # noqa: E731
        table = metrics.evaluate(drive.trace, scenario, found=keeping)
        steps.add(chosen.planner, mode.value, tuple(found.values()))
        shown = steps.table([found[name] for name in MEASURED if name in found])
    with stage(console, f"{mode.value}: frames.parquet"):
        steps.write()
    with stage(console, f"{mode.value}: trace"):
        write_trace(folder / "drive.mcap", drive.trace, scenario, internals=chosen.internals)
    if not chosen.no_recording:
        from replan.draw.recording import write_recording

        with stage(console, f"{mode.value}: recording"):
            write_recording(folder / "drive.rrd", drive, scenario, table, shown)
    sizes = ", ".join(
        f"{file.name} {file.stat().st_size / 1e6:.1f} MB" for file in sorted(folder.glob("drive.*"))
    )
    console.print(f"{drive.trace.end.value} at {drive.trace.ego.t[-1]:.0f} s; {sizes}")


if __name__ == "__main__":
    main()
