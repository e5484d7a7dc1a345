"""Trajectories to be scored: those of a table, and the plans of a run's open loop.

A table (CSV or Parquet) has a row for each pose: `log` (its name or file), `t_s` (begin of the window, s from the
log's begin), `x`, `y`, `yaw` (rear axle, m, rad), the eight poses of a window every 0.5 s, in order or with `after_s`.
`drive` (else `planner`) separates several agents; `token` is copied to the scores. `stage_one` names, by its token, the
window of which a window is a follow-up scene (`two_stages`); empty: none.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import cos, hypot, sin
from pathlib import Path
from typing import cast

import numpy as np
import pandas as pd
import pyarrow as pa

from logs.arrays import FloatArray
from logs.errors import ConfigError, unknown_name
from logs.files import check_regular
from logs.scenario import Scenario
from logs.states import EgoState
from logs.trace import Trace
from replay.results.tables import safe_name
from replay.score.navsim import HORIZON_S, POSE_S, POSES

NEEDED = ("log", "t_s", "x", "y", "yaw")
AGENT = ("drive", "planner")
FARTHEST_M = 1000.0  # No pose of a plan is this far from where its window begins, m


@dataclass(frozen=True, eq=False)
class Asked:
    """A plan to be scored."""

    log: str  # The log's name; `drive` the agent's, `token` the window's
    drive: str
    token: str
    t: float  # Begin of the window, s
    poses: FloatArray  # x, y, yaw in the log's world `(8, 3)`
    stage_one: str = ""  # The token of the window of which this is a follow-up scene; "": it is none


def read_table(path: Path) -> pd.DataFrame:
    """Read the table of a file.

    ConfigError if the file cannot be read, lacks a column, or has a value that is no number.
    """
    check_regular(path)
    if path.suffix not in (".csv", ".parquet"):
        raise ConfigError(f"{path}: write trajectories as .csv or .parquet; pickles are not read: they execute code")
    try:
        table = pd.read_csv(path) if path.suffix == ".csv" else pd.read_parquet(path)
    except (OSError, ValueError, pa.ArrowException) as error:
        raise ConfigError(f"{path}: cannot be read: {str(error).splitlines()[0]}") from None
    table = table.rename(columns={name: "t_s" for name in ("t", "time_s", "time") if "t_s" not in table.columns})
    if missing := [name for name in NEEDED if name not in table.columns]:
        hint = "; a token names no time of a log here: add log and t_s" if "token" in table.columns else ""
        raise ConfigError(f"{path}: no column {', '.join(missing)}; it needs {', '.join(NEEDED)}{hint}")
    if table.empty:
        raise ConfigError(f"{path}: holds no rows; it needs {POSES} for each window")
    for name in ("t_s", "x", "y", "yaw", *(("after_s",) if "after_s" in table.columns else ())):
        numbers = pd.to_numeric(table[name], errors="coerce")
        if not np.isfinite(numbers).all():
            row = int(np.flatnonzero(~np.isfinite(numbers))[0])
            raise ConfigError(f"{path}: {name} of row {row + 1} is no finite number: {table[name].iloc[row]}")
        table[name] = numbers.astype(float)
    for name in ("log", *(name for name in AGENT if name in table.columns)):
        if (empty := np.flatnonzero(table[name].isna())).size:
            raise ConfigError(f"{path}: {name} of row {empty[0] + 1} is empty")
    return table


def of_table(path: Path, logs: Mapping[str, Scenario], *, relative: bool) -> list[Asked]:
    """Return the plans of a file, for logs by name.

    `relative`: whether poses are relative to the ego at the begin of their window. ConfigError as `read_table`, or if a
    window has not eight poses, or one that is `FARTHEST_M` away, or a log is unknown.
    """
    table = read_table(path)
    known = {name: log for log in logs for name in (log, safe_name(log), Path(log).stem)}
    agent = next((name for name in AGENT if name in table.columns), None)
    found = []
    for key, rows in table.groupby([table["log"].astype(str), "t_s"], sort=False):
        log, t = cast("tuple[str, float]", key)
        if log not in known:
            raise unknown_name("log", log, sorted(logs))
        for drive, some in rows.groupby(agent, sort=False) if agent else [("", rows)]:
            window = some.sort_values("after_s", kind="stable") if "after_s" in some.columns else some
            where = f"{path}: {log} at {t:g} s{f', {drive!s}' if drive else ''}"
            if len(window) != POSES:
                raise ConfigError(f"{where}: {len(window)} poses; a window has {POSES}, every {POSE_S:g} s")
            expected = POSE_S * np.arange(1, POSES + 1)
            if "after_s" in window.columns and not np.allclose(window["after_s"], expected, atol=1e-3):
                raise ConfigError(f"{where}: after_s must be {expected[0]:g}, {expected[1]:g}, ... {expected[-1]:g} s")
            poses = window[["x", "y", "yaw"]].to_numpy(np.float64)
            name = known[log]
            begin = ego_at(logs[name], t)
            placed = _in_world(poses, begin) if relative else poses
            away = max(hypot(x - begin.x, y - begin.y) for x, y in placed[:, :2])
            if away > FARTHEST_M:
                frame = "the poses are in another frame" if relative else "poses relative to the ego need --relative"
                raise ConfigError(f"{where}: a pose is {away:.3g} m from where the window begins: {frame}")
            words = (window[column].iloc[0] if column in window.columns else None for column in ("token", "stage_one"))
            token, stage_one = ("" if pd.isna(word) else str(word) for word in words)
            found.append(Asked(name, str(drive), token, t, placed, stage_one))
    return found


def ego_at(scenario: Scenario, t: float) -> EgoState:
    """Return the ego of a log at `t`, s; before its first and after its last state, that state."""
    return scenario.ego.resampled(np.clip([t], scenario.ego.t[0], scenario.ego.t[-1])).state(0)


def _in_world(poses: FloatArray, ego: EgoState) -> FloatArray:
    """Return poses that are relative to the ego in its log's world."""
    x, y, yaw = poses.T
    c, s = cos(ego.yaw), sin(ego.yaw)
    return np.column_stack([ego.x + x * c - y * s, ego.y + x * s + y * c, ego.yaw + yaw])


def of_trace(trace: Trace, scenario: Scenario) -> Iterator[Asked]:
    """Yield the plans of an open loop every 0.5 s that have a whole window and reach its end."""
    ahead, first = POSE_S * np.arange(1, POSES + 1), trace.ego.t[0]
    for frame in trace.frames:
        half = (frame.t - first) / POSE_S
        plan = frame.plan.trajectory
        if abs(half - round(half)) > 1e-3 or frame.t + HORIZON_S > scenario.ego.t[-1] + 1e-6:
            continue
        if plan.t[-1] < frame.t + HORIZON_S - 1e-3:
            continue
        there = plan.resampled(np.clip(frame.t + ahead, plan.t[0], plan.t[-1]))
        yield Asked(scenario.name, trace.planner, "", float(frame.t), np.column_stack([there.x, there.y, there.yaw]))


def names_of(asked: Sequence[Asked]) -> list[str]:
    """Return the logs of plans, each once, in order."""
    return list(dict.fromkeys(one.log for one in asked))
