"""What many logs cost: CPU per log by number of workers, the rate over time, and the memory of each
process over time.

    python benchmarks/many_logs.py [--logs 1000] [--workers 1 --workers 2] [--out FOLDER] [-- OPTIONS OF EVALUATE]

The first cells of the catalogue (`replan.logs.catalogue.ordered`) are written as MCAP files and
evaluated by the command line. CPU time is that of the run and all its workers, start and first
compilation included; memory is the resident set, sampled every second. Times mean this machine on
this day; the ratio of CPU per log should not.
"""  # noqa: E501

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice, pairwise
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from replan.logs.catalogue import ordered, scenario
from replan.logs.mcap import write_scenario
from replan.results.tables import safe_name

QUIET = ("--no-recording", "--set", "internals=none")
TENTHS = 10
TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")
PAGE_MB = os.sysconf("SC_PAGE_SIZE") / 2**20


@dataclass(frozen=True)
class Sample:
    """A run at one instant: s since its start, logs done, CPU seconds so far, MB of the parent and
    of each worker.
    """

    t: float
    done: int
    cpu: float
    parent: float
    workers: tuple[float, ...]


def synthesise(folder: Path, count: int) -> None:
    """The first `count` cells of the catalogue as files; those that are there stay."""
    folder.mkdir(parents=True, exist_ok=True)
    for index, name in enumerate(islice(ordered(), count)):
        path = folder / f"{index:04d}-{safe_name(name)}.mcap"
        if not path.exists():
            write_scenario(path, scenario(name))


def run(folder: Path, out: Path, workers: int, options: Sequence[str]) -> list[Sample]:
    """Evaluate the folder's logs; a sample a second until it ends."""
    main = "from replan.cli import main; main()"
    command = [sys.executable, "-c", main, "evaluate", str(folder), "-q", *options]
    process = subprocess.Popen(
        [*command, "--workers", str(workers), "--out", str(out)], stdout=subprocess.DEVNULL
    )
    begin, samples, cpu = time.perf_counter(), list[Sample](), dict[int, float]()
    while process.poll() is None:
        family = [process.pid, *_children(process.pid)]
        found = {pid: seen for pid in family if (seen := _seen(pid)) is not None}
        cpu |= {pid: seconds for pid, (seconds, _) in found.items()}
        memory = {pid: resident for pid, (_, resident) in found.items()}
        parent = memory.pop(process.pid, 0.0)
        done = sum(1 for _ in out.glob("*/log.json")) if out.exists() else 0
        samples.append(
            Sample(
                time.perf_counter() - begin, done, sum(cpu.values()), parent, tuple(memory.values())
            )
        )
        time.sleep(1.0)
    return samples


def _children(pid: int) -> Iterator[int]:
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in task.read_text().split():
            yield int(child)
            yield from _children(int(child))


def _seen(pid: int) -> tuple[float, float] | None:
    """CPU seconds and resident MB of a process; None where it has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return (int(fields[11]) + int(fields[12])) * TICK_S, int(fields[21]) * PAGE_MB


def tenths(samples: Sequence[Sample]) -> Table:
    """Rate, CPU and memory in each tenth of the logs."""
    table = Table("logs", "logs/min", "CPU s/log", "parent MB", "largest worker MB")
    done = np.array([sample.done for sample in samples])
    edges = np.searchsorted(done, np.linspace(0, done[-1], TENTHS + 1))
    for first, last in pairwise(edges):
        a, b, part = samples[first], samples[last], samples[first : last + 1]
        if b.done > a.done:
            count, largest = (
                b.done - a.done,
                max((mb for one in part for mb in one.workers), default=0.0),
            )
            cells = (
                60.0 * count / (b.t - a.t),
                (b.cpu - a.cpu) / count,
                max(one.parent for one in part),
                largest,
            )
            table.add_row(
                f"{a.done}-{b.done}",
                *(f"{cell:.{2 if k == 1 else 0}f}" for k, cell in enumerate(cells)),
            )
    return table


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=1000)
    parser.add_argument("--workers", type=int, action="append")
    parser.add_argument("--out", type=Path)
    parser.add_argument(
        "options", nargs="*", help=f"of replan evaluate; without: {' '.join(QUIET)}"
    )
    chosen = parser.parse_args()
    console, out = Console(), chosen.out or Path(tempfile.mkdtemp())
    folder = out / f"logs-{chosen.logs}"
    synthesise(folder, chosen.logs)
    per_log = []
    for workers in chosen.workers or (1, 2):
        samples = run(folder, out / f"workers-{workers}", workers, chosen.options or QUIET)
        console.print(f"workers {workers}:", tenths(samples))
        per_log.append(samples[-1].cpu / max(samples[-1].done, 1))
        wall = samples[-1].t / max(samples[-1].done, 1)
        console.print(f"{samples[-1].done} logs; a log: wall {wall:.2f} s, CPU {per_log[-1]:.2f} s")
        console.print(f"CPU per log against the first: {per_log[-1] / per_log[0]:.3f}")


if __name__ == "__main__":
    main()
