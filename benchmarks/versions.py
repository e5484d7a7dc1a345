"""Two versions of this repository side by side: how long a plan takes, stage by stage, and the
loops around it.

    python benchmarks/versions.py OLD_CHECKOUT [NEW_CHECKOUT] [--logs FOLDER_OR_FILE ...] [--rounds 3]
    python benchmarks/versions.py OLD_CHECKOUT --evaluate --skip-crowds       whole evaluations as
        well

NEW_CHECKOUT is by default the one that this file is in. Each version is a process of its own with
one thread of NumPy; they take turns log by log, so that what else the machine does disturbs both
alike. All times are CPU time of the one thread, the laps of the stages too, after a round that does
not count. Closed loop, the defaults of `LoopConfig`, over the built-in suite; over `--logs`, all in
one table; and over crowds (`crowds.py`) of 50, 200, 500 agents on the roads of `--logs`, or else of
the suite. Per round: quantiles over all plans (a stage that a plan did not need took no time) and
over all frames (perception and prediction); driven seconds per CPU second of the closed loop, as
without recording, and with the planner's inside kept as for one; with `--evaluate` the CPU seconds
of `evaluate_logs` with one worker, both loops, without recording and internals, and with both. The
table shows the medians over the rounds, and the median of the rounds' ratios.
"""  # noqa: E501

from __future__ import annotations

import argparse
import inspect
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np
from crowds import CROWDS, crowded
from rich.console import Console
from rich.table import Table

SUITE = "built-in suite"
STAGES = (
    "start",
    "path DP",
    "path QP",
    "S-T graph",
    "speed DP",
    "speed QP",
    "passing",
    "lane choice",
    "total",
)
QUANTILES = (50, 95, 99)
FRAME = "perception, prediction"
LOOPS = {"closed loop": "spent", "closed loop, internals kept": "kept"}
"""By what each is spent; a version that cannot choose always keeps them."""
Measured = dict[str, list[float]]
"""Milliseconds per plan by stage and per frame.

Seconds "driven", "spent", and "kept": spent with internals.
"""


def _packages(checkout: Path) -> Path:
    """The folder in which Python finds the packages of a checkout.

    With the one package `replan` these are links; before, the packages lay at the top.
    """
    links = checkout / ".ci" / "links.py"
    if not links.is_file():
        return checkout
    subprocess.run([sys.executable, str(links)], check=True)
    return checkout / "build" / "ns"


class Version:
    """A checkout, measured by its own copy of this file in a process that answers a line with a
    line.
    """

    def __init__(self, checkout: Path) -> None:
        threads = dict.fromkeys(
            ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
        )
        self._process = subprocess.Popen(
            [sys.executable, str(checkout / "benchmarks" / "versions.py"), "--serve"],
            env={**os.environ, **threads, "PYTHONPATH": str(_packages(checkout))},
            cwd=checkout,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def ask(self, **job: Any) -> Any:
        """The answer to a job; SystemExit where the process has ended."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(json.dumps(job) + "\n")
        self._process.stdin.flush()
        answer = self._process.stdout.readline()
        return json.loads(answer) if answer else sys.exit(f"the process ended at {job}")

    def close(self) -> None:
        """No more jobs."""
        self._process.communicate()


def serve() -> None:
    """What a version's process does: answer jobs."""
    answers, jobs = sys.stdout, {"logs": _logs, "drive": _driver(), "evaluate": _evaluated}
    for line in sys.stdin:
        job = json.loads(line)
        with redirect_stdout(sys.stderr):
            answer = jobs[job.pop("what")](**job)
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


def _logs(paths: list[str]) -> list[str]:
    """The labels of the logs that paths hold; no path: the built-in suite."""
    from replan.run.sources import builtin_suite, select

    chosen = select([Path(path) for path in paths]) if paths else builtin_suite()
    return [str(source.path or source.label) for source in chosen.sources]


def _driver() -> Callable[..., Measured]:
    """Drives a log by its label, with `crowd` agents in place of its own.

    What has been read stays.
    """
    from replan.replay import drive
    from replan.replay.loop.closed_loop import run_closed_loop
    from replan.replay.perception import Perception
    from replan.run.log_source import LogSource

    drive.perf_counter = time.thread_time  # type: ignore[attr-defined]
    chooses = "keep_internals" in inspect.signature(run_closed_loop).parameters
    scenarios: dict[tuple[str, int], Any] = {}
    frames: list[float] = []
    make = Perception.frame

    def frame(*args: Any) -> Any:
        begin = time.thread_time()
        made = make(*args)
        frames.append(1e3 * (time.thread_time() - begin))
        return made

    Perception.frame = frame  # type: ignore[method-assign]

    def drive(log: str, crowd: int) -> Measured:
        if (log, crowd) not in scenarios:
            scenario = LogSource(log, Path(log) if Path(log).exists() else None).read()
            scenarios[log, crowd] = crowded(scenario, crowd) if crowd else scenario
        spent = []
        for choice in ({"keep_internals": True}, {"keep_internals": False}) if chooses else ({},):
            frames.clear()
            begin = time.thread_time()
            made = run_closed_loop(scenarios[log, crowd], "dp_qp", **choice)
            spent.append(time.thread_time() - begin)
        driven = [float(made.trace.ego.t[-1] - made.trace.ego.t[0])]
        return {
            **_laps(made.timings),
            FRAME: list(frames),
            "driven": driven,
            "kept": spent[:1],
            "spent": spent[-1:],
        }

    return drive


def _laps(timings: Any) -> Measured:
    """Milliseconds of each stage of each plan."""
    plans: dict[float, dict[str, float]] = {}
    for lap in timings:
        plans.setdefault(lap.t, {})[lap.stage] = 1e3 * lap.seconds
    return {stage: [plan.get(stage, 0.0) for plan in plans.values()] for stage in STAGES}


def _evaluated(paths: list[str], recording: bool) -> float:
    """CPU seconds of a whole evaluation: this process and the worker that it starts and waits
    for.
    """
    from replan.config import RunConfig
    from replan.run import evaluate_logs

    with tempfile.TemporaryDirectory() as out:
        begin = sum(os.times()[:4])
        run = RunConfig(recording=recording, internals="summary" if recording else "none")
        evaluate_logs(paths, run, Path(out) / "run", workers=1)
        return sum(os.times()[:4]) - begin


def _as_file(label: str, folder: Path) -> str:
    """A log of the suite as a file: versions have suites of their own."""
    from replan.logs.mcap import write_scenario
    from replan.run.log_source import LogSource

    path = folder / f"{label.replace('/', '_')}.mcap"
    write_scenario(path, LogSource(label, None).read())
    return str(path)


def one_round(versions: list[Version], logs: list[str], crowd: int) -> list[dict[str, list[float]]]:
    """Per version: quantiles of each stage and of the frame, ms; "closed loop": times real time."""
    found: list[Measured] = [{}, {}]
    for log in logs:
        for version, columns in zip(versions, found, strict=True):
            for name, values in version.ask(what="drive", log=log, crowd=crowd).items():
                columns.setdefault(name, []).extend(values)
    return [
        {name: np.percentile(columns[name], QUANTILES).tolist() for name in (*STAGES, FRAME)}
        | {name: [sum(columns["driven"]) / sum(columns[spent])] for name, spent in LOOPS.items()}
        | {"plans": [float(len(columns["total"]))]}
        for columns in found
    ]


def compared(
    rounds: list[list[dict[str, list[float]]]],
) -> Iterator[tuple[str, int, float, float, float]]:
    """What, which quantile of it, before, after, ratio after / before."""
    for name, values in rounds[0][0].items():
        for q in range(len(values)):
            pairs = np.array([[version[name][q] for version in both] for both in rounds])
            before, after = np.median(pairs, axis=0)
            yield (
                name,
                q,
                before,
                after,
                float(np.median(pairs[:, 1] / np.maximum(pairs[:, 0], 1e-12))),
            )


def print_table(title: str, rounds: list[list[dict[str, list[float]]]]) -> None:
    """One table: a row per stage, before and after and ratio of each quantile."""
    heads = [f"p{q} {what}" for q in QUANTILES for what in ("before", "after", "ratio")]
    table = Table("", *heads, title=title, title_justify="left", box=None, padding=(0, 1, 0, 0))
    for column in table.columns[1:]:
        column.justify = "right"
    rows: dict[str, list[str]] = {}
    for name, _, before, after, ratio in compared(rounds):
        digits = 3 if name in (*STAGES, FRAME) else 1
        rows.setdefault(name, []).extend(
            (f"{before:.{digits}f}", f"{after:.{digits}f}", f"{ratio:.2f}")
        )
    for name, cells in rows.items():
        unit = {"closed loop": "x real time", "plans": "number", "evaluation": "CPU s"}.get(
            name.split(",")[0], "ms"
        )
        table.add_row(f"{name}, {unit}", *cells)
    Console(width=140).print(table)
    sys.stdout.flush()


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("old", type=Path)
    parser.add_argument("new", type=Path, nargs="?", default=Path(__file__).resolve().parents[1])
    parser.add_argument("--logs", type=Path, nargs="+", default=[])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--evaluate", action="store_true")
    parser.add_argument("--skip-crowds", action="store_true")
    asked = parser.parse_args()
    versions = [Version(checkout.resolve()) for checkout in (asked.old, asked.new)]
    paths = [str(path.resolve()) for path in asked.logs]
    folder = tempfile.TemporaryDirectory()
    suite = [_as_file(label, Path(folder.name)) for label in versions[0].ask(what="logs", paths=[])]
    given = versions[0].ask(what="logs", paths=paths) if paths else []
    sets = [(SUITE, suite, suite, 0), *([("logs given", paths, given, 0)] if given else [])]
    crowds = [] if asked.skip_crowds else [(f"{n} agents", [], given or suite, n) for n in CROWDS]
    for title, where, logs, crowd in (*sets, *crowds):
        rounds = [one_round(versions, logs, crowd) for _ in range(asked.rounds + 1)][1:]
        for recording in (False, True) if asked.evaluate and not crowd else ():
            for both in rounds:
                for version, columns in zip(versions, both, strict=True):
                    took = version.ask(what="evaluate", paths=where, recording=recording)
                    columns[f"evaluation, {'with' if recording else 'without'} recording"] = [took]
        print_table(f"\n{title}: {len(logs)} logs", rounds)
    for version in versions:
        version.close()
    folder.cleanup()


if __name__ == "__main__":
    serve() if sys.argv[1:] == ["--serve"] else main()
