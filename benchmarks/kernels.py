"""What each kernel costs to compile, and what it saves: calls and CPU time of a log, compiled and
as plain Python.

    python benchmarks/kernels.py [LOG ...] [--calls 20]

LOGs are files and folders; without any, the built-in suite. Three processes drive them in both
loops without recording, from a copy of the sources without machine code. One compiles everything;
one counts the calls that come from Python and keeps the arguments of some; one repeats these as
plain Python (`NUMBA_DISABLE_JIT=1`). A row is a kernel that Python calls; its compilation includes
that of the kernels which it was the first to call. "pays after" is the number of logs after which
compiling it was cheaper.
"""

from __future__ import annotations

import argparse
import os
import pickle
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from copy import deepcopy
from math import inf
from pathlib import Path
from typing import Any

from numba.core import event
from numba.core.dispatcher import Dispatcher
from rich.console import Console
from rich.table import Table

from replan.config import RunConfig
from replan.run.evaluate import evaluate_logs

ROOT = Path(__file__).resolve().parents[1]
LOG_S, PAYS_WITHIN = 20.0, 100.0
MOST_S = 20.0
"""No more calls of a kernel are repeated after this time, s."""
PACKAGES = {"replan": "replan"} | {
    name: f"replan/{name}" for name in ("logs", "metrics", "planners", "replay")
}


def drive(logs: Sequence[str]) -> float:
    """Evaluate the logs in this process; the seconds of their drives."""
    with tempfile.TemporaryDirectory() as folder:
        results = evaluate_logs(logs, RunConfig(recording=False), Path(folder) / "out")
    drives = results.drives
    return float(drives[drives["mode"] == "open"]["t_end_s"].sum())


class Compilations(event.Listener):
    """The CPU seconds of compiling by kernel, with what it calls."""

    def __init__(self) -> None:
        self.seconds, self._begun = Counter[str](), list[tuple[str, float]]()

    def on_start(self, started: Any) -> None:
        """Numba begins to compile a function."""
        function = started.data["dispatcher"].py_func
        self._begun.append((f"{function.__module__}.{function.__qualname__}", time.process_time()))

    def on_end(self, _: Any) -> None:
        """It ends; a function that compiles itself for other types counts once."""
        name, begin = self._begun.pop()
        if not any(outer == name for outer, _ in self._begun):
            self.seconds[name] += time.process_time() - begin


class Counted:
    """Stands for a kernel in the modules that call it from Python; keeps evenly spaced calls."""

    def __init__(self, kernel: Any, most: int) -> None:
        self.kernel, self.most, self.calls, self.seconds, self.kept, self.spaced = (
            kernel,
            most,
            0,
            0.0,
            list[Any](),
            1,
        )

    def __call__(self, *args: Any, **named: Any) -> Any:
        """Call the kernel."""
        if self.calls % self.spaced == 0:
            self.kept.append(deepcopy((args, named)))
            if len(self.kept) > self.most:
                self.kept, self.spaced = self.kept[::2], 2 * self.spaced
        begin = time.thread_time()
        found = self.kernel(*args, **named)
        self.seconds += time.thread_time() - begin
        self.calls += 1
        return found


def of_modules() -> Iterator[tuple[Any, str, Any]]:
    """Yield module, name and value of the globals of this repository's modules."""
    for module in [one for name, one in sys.modules.items() if name.split(".")[0] in PACKAGES]:
        for name, value in list(vars(module).items()):
            yield module, name, value


def compile_all(logs: Sequence[str], out: Path) -> None:
    """Process 1: drive with an empty cache."""
    listener = Compilations()
    event.register("numba:compile", listener)
    drive(logs)
    out.write_bytes(pickle.dumps(dict(listener.seconds)))


def count(logs: Sequence[str], out: Path, most: int) -> None:
    """Process 2: drive with the machine code of the first, whose functions must be loaded before
    they are counted.
    """
    seconds = drive(logs)
    counted = dict[int, Counted]()
    for module, name, value in of_modules():
        if isinstance(value, Dispatcher):
            setattr(module, name, counted.setdefault(id(value), Counted(value, most)))
    drive(logs)
    rows = {
        f"{each.kernel.py_func.__module__}.{each.kernel.py_func.__qualname__}": (
            each.calls,
            each.seconds,
            each.kept,
        )
        for each in counted.values()
        if each.calls
    }
    out.write_bytes(pickle.dumps((seconds, rows)))


def repeat(found: Path, out: Path) -> None:
    """Process 3: the kept calls as plain Python; seconds per call by kernel."""
    _, rows = pickle.loads(found.read_bytes())  # made by this program a moment ago
    python = {}
    for name, (_, _, kept) in rows.items():
        module, function = name.rsplit(".", 1)
        call: Callable[..., Any] = getattr(__import__(module, fromlist=[function]), function)
        begin, done = time.process_time(), 0
        for args, named in kept:
            if time.process_time() - begin > MOST_S:
                break
            call(*args, **named)
            done += 1
        python[name] = (time.process_time() - begin) / done
    out.write_bytes(pickle.dumps(python))


def main() -> None:
    """Run the three processes, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("logs", nargs="*")
    parser.add_argument(
        "--calls", type=int, default=20, help="calls of each kernel that are repeated in Python"
    )
    parser.add_argument("--part", nargs="+", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.part:
        part, *files = asked.part
        {
            "compile": lambda: compile_all(asked.logs, Path(files[0])),
            "count": lambda: count(asked.logs, Path(files[0]), asked.calls),
            "repeat": lambda: repeat(Path(files[0]), Path(files[1])),
        }[part]()
        return
    with tempfile.TemporaryDirectory() as folder:
        compiled, counted, python = (
            Path(folder) / name for name in ("compiled", "counted", "python")
        )
        without = shutil.ignore_patterns("__pycache__")
        for name, package in PACKAGES.items():
            shutil.copytree(ROOT / name, Path(folder) / package, ignore=without, dirs_exist_ok=True)
        parts = (
            ["compile", str(compiled)],
            ["count", str(counted)],
            ["repeat", str(counted), str(python)],
        )
        for part, disabled in zip(parts, "001", strict=True):
            environment = {**os.environ, "PYTHONPATH": folder, "NUMBA_DISABLE_JIT": disabled}
            command = [
                sys.executable,
                __file__,
                *asked.logs,
                "--calls",
                str(asked.calls),
                "--part",
                *part,
            ]
            subprocess.run(command, check=True, env=environment)
        cost: dict[str, float] = pickle.loads(compiled.read_bytes())
        seconds, rows = pickle.loads(counted.read_bytes())
        plain: dict[str, float] = pickle.loads(python.read_bytes())
    table = Table(
        title=f"{seconds:.0f} s of logs; all per 20 s of driving in both loops; CPU times"
    )
    for head in (
        "kernel",
        "compiling, s",
        "calls",
        "compiled, ms",
        "Python, ms",
        "pays after, logs",
    ):
        table.add_column(head, justify="left" if head == "kernel" else "right", no_wrap=True)
    share, found = LOG_S / seconds, []
    for name, (calls, spent, _) in rows.items():
        saved = share * (calls * plain[name] - spent)
        found.append(
            (
                cost.get(name, 0.0) / saved if saved > 0.0 else inf,
                name,
                calls * share,
                spent * share,
                plain[name],
            )
        )
    for pays, name, calls, spent, each in sorted(found, reverse=True):
        row = (
            f"{cost.get(name, 0.0):.2f}",
            f"{calls:.0f}",
            f"{1e3 * spent:.1f}",
            f"{1e3 * calls * each:.1f}",
        )
        table.add_row(name, *row, f"{pays:.2g}" if pays < inf else "never")
    Console(width=140).print(table)
    late = [cost.get(name, 0.0) for pays, name, *_ in found if pays > PAYS_WITHIN]
    print(
        f"{len(found)} kernels, {sum(cost.get(row[1], 0.0) for row in found):.0f} CPU-s to compile;"
        f" {len(late)} of them, {sum(late):.1f} s, pay after more than {PAYS_WITHIN:.0f} logs"
    )


if __name__ == "__main__":
    main()
