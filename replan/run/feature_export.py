"""`replan export features`: the features of logs, and what the ego and the agents then did, as
arrays to train on.

A sample is a frame of the logged drive, as a planner in open loop gets it (`replan.features`), with
the targets

    future         (T, 5)     FUTURE_COLUMNS of the ego from the log, at t + 0.1 s ... t + 8 s
    plan           (T, 5)     the same of the plan that was made at the frame: of a trace that of
                              its planner, else the newest of the on-board planner
    agents_future  (N, T, 3)  AGENT_FUTURE_COLUMNS of the agents of the sample, in their order

in the frame of the ego now, and the masks `future_known`, `plan_known` (T,) and
`agents_future_known` (N, T). Futures are targets: no planner may get them.

A log is one .npz file (`numpy.load`), all samples stacked, of a long log several. Arrays of one
shape need no other reader, and load without being parsed; in Parquet they would be nested lists.
`features.json` has the version, the sizes, the names of columns, and a row for each log.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replan import features as form
from replan.config import RunConfig
from replan.core.arrays import FloatArray
from replan.core.errors import OutputError, ReplanError, described
from replan.features import Features, FeatureSizes, features_of
from replan.logs.frame import Frame
from replan.logs.mcap.trace_file import read_trace
from replan.logs.scenario import Scenario
from replan.logs.states import EgoState, OnboardPlan, Trajectory
from replan.logs.tracks import Tracks
from replan.metrics.arrival import goal_of
from replan.replay.loop.open_loop import frame_times
from replan.replay.loop.planning import planner_context
from replan.replay.loop_config import LoopConfig
from replan.replay.perception import Perception
from replan.replay.world import World, logged_ego
from replan.results.tables import safe_names, write_file, write_json
from replan.run.claim import FolderContents, claimed_folder, emptied
from replan.run.log_source import LogSource
from replan.run.pool import WorkerLost, run_all
from replan.run.sources import Selection

MANIFEST = "features.json"
FUTURE_STEPS, FUTURE_STEP_S = 80, 0.1
FUTURE_S = FUTURE_STEP_S * np.arange(1, FUTURE_STEPS + 1)
FUTURE_COLUMNS = ("x", "y", "cos_yaw", "sin_yaw", "v")
AGENT_FUTURE_COLUMNS = ("x", "y", "yaw")
SAMPLES_PER_FILE = 1000
"""About 100 MB in memory."""
SAME_TIME_S = 1e-6


def _is_ours(entry: Path) -> bool:
    return entry.name == MANIFEST or (
        entry.suffix == ".npz" and entry.with_name(MANIFEST).is_file()
    )


CONTENTS = FolderContents("export features", is_ours=_is_ours, resumes=False)
Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class ExportedLog:
    """What was written of a log.

    `error`: why nothing was written; `stopped`: why no file can be.
    """

    label: str
    row: dict[str, Any]
    error: str = ""
    stopped: str = ""


def export_features(
    selection: Selection,
    run: RunConfig,
    out: Path,
    *,
    sizes: FeatureSizes,
    every: int,
    workers: int,
    on_log: Callable[[ExportedLog], None],
) -> list[ExportedLog]:
    """Write every `every`-th frame of the logs into a folder of their own; return what was written,
    in the order of the logs.

    Raises:
        ConfigError: The folder must not be written.
        OutputError: A file cannot be written.
    """
    with claimed_folder(out, CONTENTS) as folder:
        emptied(folder)
        write_json(folder / MANIFEST, _manifest((), run, sizes, every))  # the folder is ours
        names = safe_names(source.label for source in selection.sources)
        job = partial(_export_log, run=run, folder=folder, sizes=sizes, every=every)
        items = [(source, names[source.label]) for source in selection.sources]
        logs: dict[int, ExportedLog] = {}
        for i, outcome in _each(job, items, workers):
            if isinstance(outcome, WorkerLost):
                label = items[i][0].label
                outcome = ExportedLog(label, {}, f"{label}: not exported: {outcome.reason}")
            if outcome.stopped:
                raise OutputError(outcome.stopped)
            logs[i] = outcome
            on_log(outcome)
        written = [logs[i] for i in sorted(logs)]
        write_json(folder / MANIFEST, _manifest(written, run, sizes, every))
    return written


Item = tuple[LogSource, str]


def _each(
    job: Callable[[Item], ExportedLog], items: Sequence[Item], workers: int
) -> Iterator[tuple[int, ExportedLog | WorkerLost]]:
    if workers == 0:
        yield from enumerate(map(job, items))
    else:
        yield from run_all(job, items, max(1, min(workers, len(items))))


def _manifest(
    logs: Sequence[ExportedLog], run: RunConfig, sizes: FeatureSizes, every: int
) -> dict[str, Any]:
    columns = {
        "ego": form.EGO_COLUMNS,
        "ego_size": form.SIZE_COLUMNS,
        "agents": form.AGENT_COLUMNS,
        "objects": form.OBJECT_COLUMNS,
        "lanes": form.LANE_COLUMNS,
        "route": form.ROUTE_COLUMNS,
        "future": FUTURE_COLUMNS,
        "plan": FUTURE_COLUMNS,
        "agents_future": AGENT_FUTURE_COLUMNS,
    }
    return {
        "version": form.VERSION,
        "sizes": asdict(sizes),
        "columns": {name: list(names) for name, names in columns.items()},
        "step_s": FUTURE_STEP_S,
        "sample_period_s": every * run.loop.plan_period_s,
        "perception": run.loop.perception,
        "logs": [log.row for log in logs if not log.error],
        "failures": [log.error for log in logs if log.error],
    }


def _export_log(
    item: Item, run: RunConfig, folder: Path, sizes: FeatureSizes, every: int
) -> ExportedLog:
    """Write the samples of one log; errors are part of the result."""
    source, name = item
    try:
        with source.fetched() as near:
            scenario = near.read()
            plans = plans_in(scenario, near.path)
        samples = samples_of(scenario, run.drive_loop, sizes, every, plans)
        files, count = _write_samples(folder, name, samples)
    except OutputError as error:
        return ExportedLog(source.label, {}, stopped=error.what)
    except ReplanError as error:
        return ExportedLog(source.label, {}, str(error))
    except Exception as error:
        return ExportedLog(source.label, {}, f"{source.label}: {described(error)}")
    row = {
        "log": scenario.name,
        "source": source.label,
        "files": files,
        "samples": count,
        "family": scenario.family,
        "dataset": scenario.dataset,
        "licence": scenario.licence,
        "recorded": scenario.is_recorded,
        "driven_by": scenario.metadata.get("trace_planner", ""),
    }
    return ExportedLog(source.label, row)


def _write_samples(folder: Path, name: str, samples: Iterator[Arrays]) -> tuple[list[str], int]:
    """Write the samples of a log; return the names of its files, and the number of samples."""
    files, count = list[str](), 0
    while rows := list(islice(samples, SAMPLES_PER_FILE)):
        stacked = {key: np.stack([row[key] for row in rows]) for key in rows[0]}
        files.append(f"{name}.{len(files) + 1}.npz" if files else f"{name}.npz")
        write_file(folder / files[-1], partial(_write_npz, arrays=stacked))
        count += len(rows)
    return files, count


def _write_npz(path: Path, arrays: Arrays) -> None:
    with path.open("wb") as stream:  # by its path, NumPy would add an ending
        np.savez_compressed(stream, allow_pickle=False, **arrays)


def plans_in(scenario: Scenario, path: Path | None) -> tuple[OnboardPlan, ...]:
    """Return the plans of a trace, else those of the log's own planner, in the scenario's time."""
    if path is None or "trace_mode" not in scenario.metadata:
        return scenario.onboard
    trace, driven = read_trace(path)
    later = (driven.start_ns - scenario.start_ns) / 1e9
    plans = []
    for frame in trace.frames:
        trajectory = frame.plan.trajectory
        moved = replace(trajectory, t=trajectory.t + later)
        plans.append(OnboardPlan(frame.t + later, moved))
    return tuple(plans)


def samples_of(
    scenario: Scenario,
    loop: LoopConfig,
    sizes: FeatureSizes,
    every: int = 1,
    plans: Sequence[OnboardPlan] = (),
) -> Iterator[Arrays]:
    """Yield the arrays of every `every`-th frame of the logged drive: `t`, those of `Features`, and
    the targets of the module docstring.
    """
    # Features need no predictions: the cheapest
    perception = Perception(scenario, replace(loop, prediction="constant_velocity"))
    ego, vehicle = scenario.ego, scenario.vehicle
    times = frame_times(ego, loop.plan_period_ns)
    start = logged_ego(ego, vehicle, times[0])
    goal = goal_of(scenario)[0]
    context = planner_context(scenario, start, goal, loop.plan_period_ns / 1e9)
    known = np.array([plan.known for plan in plans])
    for k, t in enumerate(times):
        frame = perception.frame(World(logged_ego(ego, vehicle, t), scenario.tracks), None)
        if k % every:
            continue  # it is in the past of the next sample
        features = features_of(frame, context, sizes)
        newest = int(np.searchsorted(known, t + SAME_TIME_S)) - 1
        plan = plans[newest].trajectory if newest >= 0 else None
        yield {
            "t": np.array(t),
            **features.arrays(),
            **_ego_future("future", ego, frame.ego),
            **_ego_future("plan", plan, frame.ego),
            **_agents_future(scenario.tracks, frame, features),
        }


def _ego_future(name: str, trajectory: Trajectory | None, now: EgoState) -> Arrays:
    """Return the states of a trajectory after now (`FUTURE_COLUMNS`), and which it has."""
    rows = np.zeros((FUTURE_STEPS, len(FUTURE_COLUMNS)), np.float32)
    if trajectory is None:
        return {name: rows, f"{name}_known": np.zeros(FUTURE_STEPS, np.bool_)}
    t = now.t + FUTURE_S
    known = (t >= trajectory.t[0] - SAME_TIME_S) & (t <= trajectory.t[-1] + SAME_TIME_S)
    x, y, yaw, v = (
        np.interp(t[known], trajectory.t, column)
        for column in (trajectory.x, trajectory.y, trajectory.yaw, trajectory.v)
    )
    turn = yaw - now.yaw
    rows[known] = np.column_stack([*now.offset_of(x, y), np.cos(turn), np.sin(turn), v])
    return {name: rows, f"{name}_known": known}


def _agents_future(tracks: Tracks, frame: Frame, features: Features) -> Arrays:
    """Return the poses of the agents of a sample after now, and which of them the log has."""
    index = {name: i for i, name in enumerate(tracks.ids)}
    t = frame.t + FUTURE_S
    poses = np.zeros((len(features.agents_row), FUTURE_STEPS, 3), np.float32)
    known = np.zeros(poses.shape[:2], np.bool_)
    for n in np.flatnonzero(features.agents_mask):
        i = index.get(frame.agents.ids[features.agents_row[n]])
        if i is not None:  # else it is a false alarm of perception
            poses[n], known[n] = _track_future(tracks, i, t, frame.ego)
    poses[~known] = 0.0
    return {"agents_future": poses, "agents_future_known": known}


def _track_future(
    tracks: Tracks, index: int, t: FloatArray, now: EgoState
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return poses `(T, 3)` of a track in the ego's frame, and which times it covers `(T,)`."""
    span = tracks.samples(index)
    times = tracks.t[span]
    x, y, yaw = (
        np.interp(t, times, column[span]) for column in (tracks.x, tracks.y, np.unwrap(tracks.yaw))
    )
    covered = (t >= times[0] - SAME_TIME_S) & (t <= times[-1] + SAME_TIME_S)
    known = np.full(len(t), True) if tracks.static[index] else covered
    return np.column_stack([*now.offset_of(x, y), yaw - now.yaw]), known
