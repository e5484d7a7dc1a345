"""Drives the logs of a run on a Ray cluster: one task per log, which is retried if a worker or its
node dies.

A node needs the same Python and replan as this machine; the user's own planners and metrics are
sent (`code_of`). It writes a log's folder into its own scratch folder, and sends the files back
with the result; this machine writes them under a temporary name and renames them, as a local worker
does. The number of tasks in flight is bounded, so that neither the scheduler nor this process holds
more than a few logs of a run of any size.

One task has one log: the overhead of a task is milliseconds (docs/use.md), a log takes a second
or more, and only the logs of a node that dies are retried. The processes that run the tasks are
kept by Ray, so that kernels are loaded once in each.
"""

from __future__ import annotations

import importlib.util
import os
import platform
import shutil
import socket
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar
from uuid import uuid4

from replan.config import RunConfig
from replan.core.errors import ConfigError, LogError
from replan.core.own_sources import own_folders
from replan.logs.log_settings import LogSettings
from replan.replay.loop_config import LoopConfig
from replan.replay.parts import OF_LOOP
from replan.replay.planner_process.connection import command_of
from replan.results.log_result import Failure, LogResult, Stamp
from replan.results.tables import write_folder
from replan.run.evaluate import Job, longest_first
from replan.run.log_source import LogSource
from replan.run.pool import WorkerLost, freeze_gc
from replan.run.resume import stamp_of

T = TypeVar("T")

RETRIES = 3
"""Retries of a task whose worker or node died (Ray's own default).

An error that replan raises is not retried.
"""
# Tasks in flight per core of the cluster: each core has its next one waiting, and an autoscaler
# sees a queue
AHEAD = 2
CONNECT_S = 10.0
BEGIN = (
    "`ray start --head` begins a cluster; versions of Ray and Python must be the same on all nodes"
)
ALONE = {"RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0", "RAY_USAGE_STATS_ENABLED": "0"}
"""Environment of Ray on this machine, read when Ray is imported: it listens on the loopback address
only (the first variable, on any system), and sends no usage statistics."""
LONGEST_SESSION_PATH = 25
LEFT_OUT = ("__pycache__", ".*", "*.pyc")


@dataclass(frozen=True)
class OnRay:
    """A Ray cluster."""

    # Its address ("auto", "HOST:6379", "ray://HOST:10001"); "": one on this machine, for this run
    address: str = ""
    # Largest number of tasks in flight, and cores of a cluster on this machine. None: by the
    # cluster's cores.
    workers: int | None = None

    def evaluate(
        self, sources: Sequence[LogSource], run: RunConfig, out: Path, stamp: Stamp
    ) -> Iterator[tuple[int, LogResult | WorkerLost]]:
        """As `Engine.evaluate`.

        ConfigError if Ray is not installed, the cluster cannot be reached, or its Python differs;
        OutputError if a folder cannot be written on this machine.
        """
        absolute = [
            source if source.path is None else replace(source, path=source.path.absolute())
            for source in sources
        ]
        with self._ray_connection(run) as ray:
            job = ray.put((run, stamp, uuid4().hex))
            task = ray.remote(_on_node).options(max_retries=RETRIES, num_cpus=1)
            for index, answer in longest_first(
                absolute,
                lambda ordered: self._stream_results(
                    ray, lambda source: task.remote(source, job), ordered
                ),
                lambda source: source.expected_s,
            ):
                if isinstance(answer, WorkerLost):
                    yield index, answer
                    continue
                result, files = answer
                if result.folder:
                    is_first = write_folder(out / result.folder, partial(_unpack, files))
                    result = replace(result, twin=not is_first)
                yield index, result

    @contextmanager
    def _ray_connection(self, run: RunConfig) -> Iterator[Any]:
        """Ray, with a connection for the time of the run.

        An existing connection of the caller is used.
        """
        if not self.address:
            os.environ.update(ALONE | os.environ)
        try:
            import ray
        except ImportError:
            raise ConfigError("--engine ray needs Ray: pip install 'replan[ray]'") from None
        if ray.is_initialized():
            yield ray
            return
        host, _, port = self.address.rpartition("/")[2].rpartition(":")
        if host and port.isdecimal():  # if nothing answers, Ray itself retries for minutes
            try:
                socket.create_connection((host, int(port)), CONNECT_S).close()
            except OSError as error:
                problem = f"no connection: {error.strerror or error}"
                raise ConfigError(f"--address {self.address}: {problem}; {BEGIN}") from None
        # paths of Ray's sockets in the folder of its session have at most 107 bytes
        short = (
            "/tmp"
            if len(tempfile.gettempdir()) > LONGEST_SESSION_PATH and sys.platform != "win32"
            else None
        )
        with (
            tempfile.TemporaryDirectory(prefix="replan-") as folder,
            tempfile.TemporaryDirectory(
                prefix="replan-", dir=short, ignore_cleanup_errors=True
            ) as session,
        ):
            code = code_of(run, Path(folder))
            options: dict[str, Any] = {
                "address": self.address or "local",
                "runtime_env": {"working_dir": str(code)},
            }
            if not self.address:
                options |= {
                    "num_cpus": self.workers,
                    "include_dashboard": False,
                    "_temp_dir": session,
                }
            try:
                ray.init(log_to_driver=False, configure_logging=False, **options)
            # Of many kinds: no cluster there, another version of Ray or of Python
            except Exception as error:
                where = f"--address {self.address}" if self.address else "Ray on this machine"
                first_line = str(error).strip().partition("\n")[0]
                raise ConfigError(
                    f"{where}: no connection: {type(error).__name__}: {first_line}; {BEGIN}"
                ) from None
            try:
                yield ray
            finally:
                ray.shutdown()

    def _stream_results(
        self, ray: Any, submit: Callable[[T], Any], items: Sequence[T]
    ) -> Iterator[tuple[int, tuple[Any, Any] | WorkerLost]]:
        """The result of each item as it ends; a bounded number of items is in flight."""
        waiting, flying = iter(enumerate(items)), dict[Any, int]()
        try:
            while True:
                limit = self.workers or max(1, AHEAD * int(ray.cluster_resources().get("CPU", 1)))
                while len(flying) < limit and (following := next(waiting, None)) is not None:
                    flying[submit(following[1])] = following[0]
                if not flying:
                    return
                for reference in ray.wait(list(flying), num_returns=1)[0]:
                    index = flying.pop(reference)
                    try:
                        yield index, ray.get(reference)
                    except ray.exceptions.RayTaskError as error:
                        yield (
                            index,
                            WorkerLost(
                                f"its task raised {type(error.cause).__name__}: {error.cause}"
                            ),
                        )
                    except ray.exceptions.RayError as error:
                        first_line, tries = (
                            str(error).strip().partition("\n")[0],
                            f"{RETRIES + 1} tries",
                        )
                        why = (
                            f"lost on the cluster after {tries}: {type(error).__name__}: "
                            f"{first_line}"
                        )
                        yield index, WorkerLost(why)
        finally:
            for reference in flying:
                ray.cancel(reference, force=True)


def code_of(run: RunConfig, folder: Path) -> Path:
    """A copy of the user's code that a run names, for the nodes, in `folder`; returns `folder`.

    For each planner, metric, controller ... "module:NAME" that is not installed, it contains the
    whole package (with weights), or the file; and the other modules beside it, which it may import.
    For "exec:COMMAND" it contains the local files that the command names.
    """
    directory = str(Path.cwd())
    for name in (*run.planners, *run.metrics, *_of_loop(run), run.log.reader):
        if name.startswith("exec:"):
            for word in command_of(name):
                if Path(word).is_file() and not Path(word).is_absolute():
                    (folder / word).parent.mkdir(parents=True, exist_ok=True)
                    shutil.copy2(word, folder / word)
        module, separator, _ = name.partition(":")
        if not separator:
            continue
        if directory not in sys.path:
            sys.path.append(directory)
        spec = importlib.util.find_spec(module.partition(".")[0])
        if spec is None or not spec.origin:
            continue
        file = Path(spec.origin)
        if {"site-packages", "dist-packages"} & set(file.parts) or any(
            map(file.is_relative_to, own_folders())
        ):
            continue  # installed, or part of replan
        code = file.parent if spec.submodule_search_locations else file
        for beside in code.parent.glob("*.py"):
            shutil.copy2(beside, folder / beside.name)
        if code.is_dir():
            shutil.copytree(
                code,
                folder / code.name,
                ignore=shutil.ignore_patterns(*LEFT_OUT),
                dirs_exist_ok=True,
            )
    return folder


def _of_loop(run: RunConfig) -> tuple[str, ...]:
    return tuple(getattr(run.loop, key) for key in OF_LOOP)


def _unpack(files: Mapping[str, bytes], folder: Path) -> None:
    folder.mkdir()
    for file, content in files.items():
        (folder / Path(file).name).write_bytes(content)


def _on_node(
    source: LogSource, job: tuple[RunConfig, Stamp, str]
) -> tuple[LogResult, dict[str, bytes]]:
    """A task: a log's result, and the files of its folder by their names in the result folder."""
    run, stamp, name = job
    node_stamp, wrong = _stamp_here(run.planners, run.metrics, _of_loop(run), run.log.reader), ""
    if node_stamp != stamp:  # the node has other code than this machine
        difference = (
            f"node {platform.node()} has replan {node_stamp.replan} with code {node_stamp.code[:8]}"
        )
        wrong = (
            f"{source.label}: {difference}; install there what is here: {stamp.replan} with code "
            f"{stamp.code[:8]}"
        )
    elif source.path is not None and not source.path.exists():
        remedy = "logs on a cluster must lie in a folder that all nodes share, or be named by URL"
        wrong = str(
            LogError(f"not there on node {platform.node()}", file=source.path, remedy=remedy)
        )
    if wrong:
        return LogResult(source.label, source.label, failures=(Failure(source.label, wrong),)), {}
    with tempfile.TemporaryDirectory(prefix="replan-") as scratch:
        (result,) = Job(run, Path(scratch), stamp, name)([source])
        files = {
            path.relative_to(scratch).as_posix(): path.read_bytes()
            for path in Path(scratch).glob("*/*")
        }
        _settled()
        return result, files


@cache
def _stamp_here(
    planners: tuple[str, ...], metrics: tuple[str, ...], of_loop: tuple[str, ...], reader: str
) -> Stamp:
    """The stamp of this node, computed once in each of its processes."""
    loop = LoopConfig(**dict(zip(OF_LOOP, of_loop, strict=True)))  # type: ignore[arg-type]
    return stamp_of(
        RunConfig(planners=planners, metrics=metrics, loop=loop, log=LogSettings(reader=reader))
    )


_settled = cache(freeze_gc)
"""Freezes garbage collection once in each process, after its first log: by then all kernels are
loaded.
"""
