"""The trajectories to be scored: those of a table, or the plans of a run's open loop.

A table (CSV or Parquet) has a row for each pose: `log` (its name or file), `t_s` (begin of the
window, s from the log's begin), `x`, `y`, `yaw` (rear axle, m, rad), the eight poses of a window
every 0.5 s, in order or with `after_s`. `drive` (else `planner`) separates several agents; `token`
is copied to the scores. `stage_one` names, by its token, the window of which a window is a
follow-up scene (`replan.score.two_stages`); empty: none.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import cos, hypot, sin
from pathlib import Path
from typing import cast

import numpy as np
import pandas as pd
import pyarrow as pa

from replan.core.arrays import FloatArray
from replan.core.errors import ConfigError, unknown_name
from replan.core.files import check_regular
from replan.logs.scenario import Scenario
from replan.logs.states import EgoState
from replan.logs.trace import Trace
from replan.results.tables import safe_name
from replan.score.navsim import HORIZON_S, POSE_S, POSES

NEEDED_COLUMNS = ("log", "t_s", "x", "y", "yaw")
TIME_COLUMNS = ("t_s", "t", "time_s", "time")
"""Names of the time; the first that a table has counts."""
AGENT_COLUMNS = ("drive", "planner")
"""Names of the agent; the first that a table has counts."""
FARTHEST_M = 1000.0
"""No pose of a plan is this far from where its window begins, m."""
SAME_TIME_S = 1e-3
"""Times that differ by less are one time, s."""
ROUNDING_S = 1e-6
"""What the rounding of a sum of times may add, s."""
OFF_PERIOD = 1e-3
"""A plan begins a window if it is off by at most this share of 0.5 s."""
KEYS_A_PERIOD = 100
"""The keys of plans tell begins apart that differ by a hundredth of 0.5 s."""


@dataclass(frozen=True, eq=False)
class SubmittedPlan:
    """A plan to be scored."""

    log: str  # The log's name
    drive: str  # The agent's name
    token: str  # The window's name
    t: float  # Begin of the window, s
    poses: FloatArray  # x, y, yaw in the log's world `(8, 3)`
    # The token of the window of which this is a follow-up scene; "": it is none
    stage_one: str = ""

    def key(self, periods: int = 0) -> tuple[str, str, int]:
        """Return the key of the plan of the same drive `periods` x 0.5 s later."""
        return (
            self.log,
            self.drive,
            round((self.t / POSE_S) * KEYS_A_PERIOD) + KEYS_A_PERIOD * periods,
        )


def read_table(path: Path) -> pd.DataFrame:
    """Read the table of a file.

    ConfigError if the file cannot be read, lacks a column, or has a value that is no number.
    """
    check_regular(path)
    if path.suffix not in (".csv", ".parquet"):
        raise ConfigError(
            f"{path}: write trajectories as .csv or .parquet; pickles are not read: they execute "
            "code"
        )
    try:
        table = pd.read_csv(path) if path.suffix == ".csv" else pd.read_parquet(path)
    except (OSError, ValueError, pa.ArrowException) as error:
        raise ConfigError(f"{path}: cannot be read: {str(error).splitlines()[0]}") from None
    time = next((name for name in TIME_COLUMNS if name in table.columns), "t_s")
    table = table.rename(columns={time: "t_s"})
    if missing := [name for name in NEEDED_COLUMNS if name not in table.columns]:
        hint = (
            "; a token names no time of a log here: add log and t_s"
            if "token" in table.columns
            else ""
        )
        raise ConfigError(
            f"{path}: no column {', '.join(missing)}; it needs {', '.join(NEEDED_COLUMNS)}{hint}"
        )
    if table.empty:
        raise ConfigError(f"{path}: holds no rows; it needs {POSES} for each window")
    for name in ("t_s", "x", "y", "yaw", *(("after_s",) if "after_s" in table.columns else ())):
        numbers = pd.to_numeric(table[name], errors="coerce")
        if not np.isfinite(numbers).all():
            row = int(np.flatnonzero(~np.isfinite(numbers))[0])
            raise ConfigError(
                f"{path}: {name} of row {row + 1} is no finite number: {table[name].iloc[row]}"
            )
        table[name] = numbers.astype(float)
    for name in ("log", *(name for name in AGENT_COLUMNS if name in table.columns)):
        if (empty := np.flatnonzero(table[name].isna())).size:
            raise ConfigError(f"{path}: {name} of row {empty[0] + 1} is empty")
    return table


def plans_of_table(
    path: Path, logs: Mapping[str, Scenario], *, relative: bool
) -> list[SubmittedPlan]:
    """Return the plans of a file, for logs by name.

    `relative`: whether poses are relative to the ego at the begin of their window. ConfigError as
    `read_table`, or if a window has not eight poses, or one that is `FARTHEST_M` away, or a log is
    unknown.
    """
    table = read_table(path)
    agent = next((name for name in AGENT_COLUMNS if name in table.columns), None)
    plans = []
    for key, rows in table.groupby([table["log"].astype(str), "t_s"], sort=False):
        name, t = cast("tuple[str, float]", key)
        log = _log_named(name, logs)
        for drive, poses in rows.groupby(agent, sort=False) if agent else [("", rows)]:
            where = f"{path}: {name} at {t:g} s{f', {drive!s}' if drive else ''}"
            begin = ego_at(logs[log], t)
            placed = _placed(poses, begin, where, relative=relative)
            token, stage_one = (_word(poses, column) for column in ("token", "stage_one"))
            plans.append(SubmittedPlan(log, str(drive), token, t, placed, stage_one))
    return plans


def _log_named(name: str, logs: Iterable[str]) -> str:
    """Return the log that a table names: by its name, else by its file name with or without
    folders.

    ConfigError if there is none, or if several have the file name.
    """
    if name in logs:
        return name
    matches = [log for log in logs if name in (safe_name(log), Path(log).stem)]
    if not matches:
        raise unknown_name("log", name, sorted(logs))
    if len(matches) > 1:
        raise ConfigError(f"log {name}: it may be {' or '.join(matches)}; write the whole name")
    return matches[0]


def _placed(rows: pd.DataFrame, begin: EgoState, where: str, *, relative: bool) -> FloatArray:
    """Return the poses of a window in the log's world; ConfigError as `plans_of_table`."""
    if len(rows) != POSES:
        raise ConfigError(f"{where}: {len(rows)} poses; a window has {POSES}, every {POSE_S:g} s")
    if "after_s" in rows.columns:
        rows = rows.sort_values("after_s", kind="stable")
        expected = POSE_S * np.arange(1, POSES + 1)
        if not np.allclose(rows["after_s"], expected, atol=SAME_TIME_S):
            first, second, *_, last = expected.tolist()
            raise ConfigError(f"{where}: after_s must be {first:g}, {second:g}, ... {last:g} s")
    poses: FloatArray = rows[["x", "y", "yaw"]].to_numpy(np.float64)
    placed = _in_world(poses, begin) if relative else poses
    away = max(hypot(x - begin.x, y - begin.y) for x, y in placed[:, :2])
    if away > FARTHEST_M:
        frame = "poses relative to the ego need --relative"
        if relative:
            frame = "the poses are in another frame"
        raise ConfigError(f"{where}: a pose is {away:.3g} m from where the window begins: {frame}")
    return placed


def _word(rows: pd.DataFrame, column: str) -> str:
    """Return the first value of a column; "" if there is none."""
    value = rows[column].iloc[0] if column in rows.columns else None
    return "" if pd.isna(value) else str(value)


def ego_at(scenario: Scenario, t: float) -> EgoState:
    """Return the ego of a log at `t`, s; before its first and after its last state, that state."""
    return scenario.ego.resampled(np.clip([t], scenario.ego.t[0], scenario.ego.t[-1])).state(0)


def _in_world(poses: FloatArray, ego: EgoState) -> FloatArray:
    """Return poses that are relative to the ego in its log's world."""
    x, y, yaw = poses.T
    c, s = cos(ego.yaw), sin(ego.yaw)
    return np.column_stack([ego.x + x * c - y * s, ego.y + x * s + y * c, ego.yaw + yaw])


def plans_of_trace(trace: Trace, scenario: Scenario) -> Iterator[SubmittedPlan]:
    """Yield the plans of an open loop every 0.5 s that have a whole window and reach its end."""
    ahead = POSE_S * np.arange(1, POSES + 1)
    for frame in trace.frames:
        plan = frame.plan.trajectory
        periods = (frame.t - trace.ego.t[0]) / POSE_S
        begins_a_window = abs(periods - round(periods)) <= OFF_PERIOD
        end = frame.t + HORIZON_S
        if not begins_a_window or end > scenario.ego.t[-1] + ROUNDING_S:
            continue
        if plan.t[-1] < end - SAME_TIME_S:
            continue
        states = plan.resampled(np.clip(frame.t + ahead, plan.t[0], plan.t[-1]))
        yield SubmittedPlan(
            scenario.name,
            trace.planner,
            "",
            float(frame.t),
            np.column_stack([states.x, states.y, states.yaw]),
        )
