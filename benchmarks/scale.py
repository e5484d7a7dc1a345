"""What many logs cost: wall per log by engine, Ray's overhead, bytes per log, and what the end of a
run needs per log.

python -m benchmarks.scale curve       a quarter of the suite "smoke" by 0, 1, 2 workers and on Ray
                                       (docs/use.md)
python -m benchmarks.scale overhead    a task that does nothing and returns the folder of a log
python -m benchmarks.scale end         `judge_and_write` on N logs: seconds and peak memory of this
                                       process
python -m benchmarks.scale share [LOG ...]   metrics' and reference drives' part of the CPU; no LOG:
                                             the built-in suite
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from replan import metrics
from replan.config import RunConfig
from replan.logs.catalogue import scenario
from replan.logs.mcap import write_scenario
from replan.metrics import health
from replan.replay.loop import reference_drives
from replan.results.log_result import LogResult
from replan.run import evaluate_logs, one_log
from replan.run.evaluate import Engine, Local
from replan.run.judging import gates_of, judge_and_write
from replan.run.log_source import LogSource
from replan.run.on_ray import OnRay
from replan.run.pool import run_all
from replan.run.shards import Shard
from replan.run.sources import Selection

RUN = RunConfig(recording=False, internals="none")
END = replace(RUN, planners=("constant_speed",))
SUITE = "smoke"
ITEMS = 200
JUDGING = (
    (metrics, "evaluate"),
    (health, "findings"),
    (one_log, "with_avoidability"),
    (one_log, "with_references"),
    (one_log, "discriminating_tables"),
    (one_log, "late_follower"),
    (reference_drives, "with_follower"),
)


def main(word: str, *logs: str) -> None:
    """Run one of the measurements."""
    {"curve": curve, "overhead": overhead, "end": end, "share": share}[word](*logs)


def timed(call: Callable[[], Any]) -> tuple[float, float, Any]:
    """Wall s, CPU s of this process and of the children that it waited for, and what came of it."""
    begin, used = time.perf_counter(), _cpu()
    result = call()
    return time.perf_counter() - begin, _cpu() - used, result


def _cpu() -> float:
    found = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in found)


def curve() -> None:
    """Each engine over the suite; kernels are compiled and loaded by a run before."""
    engines: dict[str, Engine] = {
        "local 0": Local(0),
        "local 1": Local(1),
        "local 2": Local(2),
        "ray 1": OnRay(workers=1),
        "ray 2": OnRay(workers=2),
    }
    with tempfile.TemporaryDirectory() as folder:
        _evaluated(Local(0), Path(folder))
        for name, engine in engines.items():
            wall, cpu, logs = timed(lambda engine=engine: _evaluated(engine, Path(folder)))
            inside, n = sum(log.seconds for log in logs), len(logs)
            each = f"wall {wall / n:.2f} s, CPU {cpu / n:.2f} s, in drives {inside / n:.2f} s"
            print(f"{name:8s} {n} logs: a log {each}")
        sizes = [file.stat().st_size for file in Path(folder).glob("*/*")]
        print(f"{sum(sizes) / n / 1e3:.0f} kB of files a log")


def _evaluated(engine: Engine, folder: Path) -> list[LogResult]:
    """The logs of a quarter of the suite, driven."""
    logs: list[LogResult] = []
    evaluate_logs(
        (), END, folder, suite=SUITE, engine=engine, shard=Shard(1, 4), on_log=logs.append
    )
    return logs


def share(*logs: str) -> None:
    """Parts of an evaluation with recordings in this process, each without the parts called in it;
    once before.
    """
    spent: Counter[str] = Counter()

    def clocked(name: str, call: Callable[..., Any]) -> Callable[..., Any]:
        def called(*arguments: Any, **keywords: Any) -> Any:
            begin, before = time.process_time(), spent.total()
            try:
                return call(*arguments, **keywords)
            finally:
                spent[name] += time.process_time() - begin - (spent.total() - before)

        return called

    for owner, name in JUDGING:
        setattr(owner, name, clocked(name, getattr(owner, name)))
    with tempfile.TemporaryDirectory() as folder:
        for out in ("before", "now"):
            spent.clear()
            begin = time.process_time()
            evaluate_logs(logs, RunConfig(), Path(folder) / out, engine=Local(0))
            whole = time.process_time() - begin
    for name, seconds in (*spent.most_common(), ("together", spent.total())):
        print(f"{name:20s} {seconds:7.3f} s {seconds / whole:6.1%} of {whole:.2f} CPU-s")


def answer(_: int) -> tuple[Any, dict[str, bytes]]:
    """As much as the task of a log returns: its metrics, and 300 kB in 6 files."""
    return pd.DataFrame({"metric": ["gap.min"] * 400, "value": 1.0}), {
        str(k): bytes(50_000) for k in range(6)
    }


def overhead() -> None:
    """Wall per item that does nothing, where the workers are warm."""
    one = OnRay(workers=4)
    with one._ray_connection(RUN) as ray:
        task = ray.remote(answer).options(max_retries=3, num_cpus=1)
        list(one._stream_results(ray, task.remote, range(20)))
        wall, cpu, _ = timed(lambda: list(one._stream_results(ray, task.remote, range(ITEMS))))
    print(
        f"ray:   {1e3 * wall / ITEMS:.1f} ms wall, {1e3 * cpu / ITEMS:.1f} ms CPU of the driver a "
        "log"
    )
    stream = run_all(answer, range(ITEMS + 20), 2)
    for _ in range(20):
        next(stream)
    wall, cpu, _ = timed(lambda: list(stream))
    print(f"local: {1e3 * wall / ITEMS:.1f} ms wall a log")


def end() -> None:
    """The end of a run of N logs, copied from one that was driven."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        write_scenario(out / "log.mcap", scenario("paper/free_road"))
        out = out / "run"
        driven: list[LogResult] = []
        evaluate_logs([out.parent / "log.mcap"], END, out, on_log=driven.append)
        (log,) = driven
        for count in (100, 400):
            named = [f"log/{k:07d}" for k in range(count)]
            logs = [_named(log, name) for name in named]
            selection = Selection(tuple(LogSource(name) for name in named))
            wall, _, _ = timed(
                lambda logs=logs, s=selection: judge_and_write(
                    out, END, s, logs, gates_of(END, None), ()
                )
            )
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
            sizes = {
                name: (out / name).stat().st_size / count
                for name in ("metrics.parquet", "timings.parquet")
            }
            sizes["summary.json"] = (out / "summary.json").stat().st_size / count
            said = ", ".join(f"{name} {size:.0f} B" for name, size in sizes.items())
            print(
                f"{count} logs: {1e3 * wall / count:.1f} ms a log, peak {peak:.0f} MB; a log: "
                f"{said}"
            )


def _named(log: LogResult, name: str) -> LogResult:
    drives = tuple(replace(drive, log=name) for drive in log.drives)
    return replace(
        log,
        name=name,
        drives=drives,
        table=log.table.assign(log=name),
        health=log.health.assign(log=name),
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
