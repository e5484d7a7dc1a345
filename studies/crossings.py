"""Who goes first at a crossing: a planner beside the person who drove the log.

python -m studies.crossings LOGS ... -o OUT [-p dp_qp]

(1) Stations s and offsets l are along the path that the person drove. On the path is who walks or
    rides (or is small and moves, where a log has no labels) with |l| < `ASIDE_M`, up to `AHEAD_M`
    before the person's front bumper.
(2) The crossing is the station within `AROUND_M` of which most such samples lie, occupied from the
    first to the last.
(3) Who passes the crossing with the front bumper before it is free again, by more than `SLACK_S`,
    does not yield; who passes it later, or not at all in the log's time, does. A drive that ends
    before (by a contact) does neither.
(4) delay = when the planner's drive passes less when the person did;
        gap = least way from the front to them, m
(5) Open loop: of the plans made from `BEFORE_S` before it is occupied until it is free or the
    person passes, those that yield; a fallback counts by what it drives.

    OUT/crossings.csv, .md      a row per log that has a crossing; the others are named
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from math import inf
from pathlib import Path

import numpy as np
import pandas as pd

from replan.core.arrays import FloatArray
from replan.core.errors import ReplanError
from replan.logs.agents import AgentKind
from replan.logs.polylines import thinned
from replan.logs.readers import LogSettings
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.trace import EndReason, Trace
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.open_loop import run_open_loop
from replan.results.tables import write_file, write_text
from replan.run.sources import select

ASIDE_M = 1.6
"""Half of a car's width and of a person's stride."""
AHEAD_M = 40.0
AROUND_M = 3.0
"""About the half of a crosswalk's width."""
SLACK_S = 0.2
BEFORE_S = 3.0
SMALL_M, WALKED_M = 1.3, 1.5
"""An unlabelled object that is no larger than this and moves by more than that may be a person."""
SPACING_M = 0.3
AGAIN_S = 0.05
WALKS = (AgentKind.PEDESTRIAN, AgentKind.BICYCLE)


@dataclass(frozen=True)
class Crossing:
    """Where, when, and who: samples `(k,)` of those on the path.

    Attributes:
        place: Station, m.
        begin: Occupied from, s; `end` to.
        end: See there.
        t: Times of the samples, s; `s` their stations, m.
        s: See there.
    """

    place: float
    begin: float
    end: float
    t: FloatArray
    s: FloatArray


@dataclass(frozen=True)
class Row:
    """One log; times s, speeds m/s, ways m.

    inf: never in the log's time; `planner_yields` "yes", "no" or "ended".
    """

    log: str
    occupied_from: float
    occupied_to: float
    human_least_speed: float
    human_passes: float
    human_yields: bool
    human_gap: float
    planner_least_speed: float
    planner_passes: float
    planner_yields: str
    planner_gap: float
    delay: float
    end: str
    plans: int
    plans_that_yield: int


class DrivenPath:
    """The path of the log's driver as a polyline with stations."""

    def __init__(self, ego: Trajectory) -> None:
        self._points = thinned(np.column_stack([ego.x, ego.y]), SPACING_M)
        steps = np.diff(self._points, axis=0)
        self._length = np.hypot(*steps.T)
        self._along = steps / self._length[:, None]
        self._begin = np.r_[0.0, np.cumsum(self._length)[:-1]]

    def place(self, x: float, y: float) -> tuple[float, float]:
        """Station and offset (left positive) of a point at its nearest segment."""
        away = np.array([x, y]) - self._points[:-1]
        u = np.clip((away * self._along).sum(axis=1), 0.0, self._length)
        feet = self._points[:-1] + u[:, None] * self._along
        k = int(np.argmin(np.hypot(x - feet[:, 0], y - feet[:, 1])))
        side = self._along[k, 0] * away[k, 1] - self._along[k, 1] * away[k, 0]
        return float(self._begin[k] + u[k]), float(side)

    def stations(self, driven: Trajectory) -> tuple[FloatArray, FloatArray]:
        """Times every `AGAIN_S` and the stations of the rear axle then."""
        t = np.arange(driven.t[0], driven.t[-1] + 1e-9, AGAIN_S)
        moved = driven.resampled(np.minimum(t, driven.t[-1]))
        return t, np.array([self.place(x, y)[0] for x, y in zip(moved.x, moved.y, strict=True)])


def crossing_of(scenario: Scenario, path: DrivenPath) -> Crossing | None:
    """(1), (2); None where no one was on the path ahead of the person who drove."""
    t, stations = path.stations(scenario.ego)
    front = _front(scenario)
    found = [
        (time, s)
        for time, s in _on_path(scenario, path)
        if -0.5 < s - float(np.interp(time, t, stations)) - front < AHEAD_M
    ]
    if not found:
        return None
    times, s = np.array(found).T
    near = [(np.abs(s - place) < AROUND_M) for place in np.unique(np.round(s))]
    best = max(near, key=lambda mask: int(mask.sum()))
    return Crossing(
        float(np.median(s[best])),
        float(times[best].min()),
        float(times[best].max()),
        times[best],
        s[best],
    )


def _on_path(scenario: Scenario, path: DrivenPath) -> Iterator[tuple[float, float]]:
    """Time and station of each sample (1) within the ego's log."""
    tracks, last = scenario.tracks, float(scenario.ego.t[-1])
    for i, kind in enumerate(tracks.kinds):
        mine = tracks.samples(i)
        x, y = tracks.x[mine], tracks.y[mine]
        small = kind is AgentKind.OBJECT and max(tracks.length[i], tracks.width[i]) < SMALL_M
        if kind not in WALKS and not (small and np.hypot(np.ptp(x), np.ptp(y)) > WALKED_M):
            continue
        for time, here, there in zip(tracks.t[mine], x, y, strict=True):
            s, side = path.place(float(here), float(there))
            if abs(side) < ASIDE_M and 0.0 <= time <= last:
                yield float(time), s


def _front(scenario: Scenario) -> float:
    """Rear axle to front bumper, m."""
    return scenario.vehicle.length - scenario.vehicle.rear_overhang


def _passes(
    driven: Trajectory, path: DrivenPath, crossing: Crossing, front: float
) -> tuple[float, float]:
    """When a drive's front is at the crossing, s (inf: never), and its least gap (4), m."""
    t, s = path.stations(driven)
    past = np.flatnonzero(s + front > crossing.place)
    seen = crossing.t <= t[-1]
    gaps = crossing.s[seen] - np.interp(crossing.t[seen], t, s) - front
    ahead = gaps[gaps > -front]
    return float(t[past[0]]) if len(past) else inf, float(ahead.min()) if len(ahead) else inf


def _plans(
    trace: Trace, path: DrivenPath, crossing: Crossing, front: float, until: float
) -> tuple[int, int]:
    """How many plans (5) there are, and how many yield."""
    count = yielding = 0
    for planned in trace.frames:
        if not crossing.begin - BEFORE_S <= planned.t <= until:
            continue
        plan = planned.plan.trajectory
        s = np.array([path.place(x, y)[0] for x, y in zip(plan.x, plan.y, strict=True)]) + front
        into = np.flatnonzero(s > crossing.place)
        count += 1
        yielding += not len(into) or float(plan.t[into[0]]) > crossing.end - SLACK_S
    return count, yielding


def _said(passes: float, crossing: Crossing, driven: Trace) -> str:
    """Whether a closed drive yields (3)."""
    if passes == inf and driven.end not in (EndReason.END_OF_LOG, EndReason.GOAL):
        return "ended"
    return "yes" if passes > crossing.end - SLACK_S else "no"


def compared(scenario: Scenario, planner: str) -> Row | None:
    """The row of a log; None where it has no crossing."""
    path, front = DrivenPath(scenario.ego), _front(scenario)
    crossing = crossing_of(scenario, path)
    if crossing is None:
        return None
    passed, gap = _passes(scenario.ego, path, crossing, front)
    closed = run_closed_loop(scenario, planner, keep_internals=False).trace
    goes, its_gap = _passes(closed.ego, path, crossing, front)
    opened = run_open_loop(scenario, planner, keep_internals=False).trace
    count, yielding = _plans(opened, path, crossing, front, min(crossing.end, passed))
    return Row(
        scenario.name,
        crossing.begin,
        crossing.end,
        float(scenario.ego.v.min()),
        passed,
        passed > crossing.end - SLACK_S,
        gap,
        float(closed.ego.v.min()),
        goes,
        _said(goes, crossing, closed),
        its_gap,
        goes - passed if np.isfinite(goes) and np.isfinite(passed) else inf,
        closed.end.value,
        count,
        yielding,
    )


def main(argv: Sequence[str] | None = None) -> None:
    """Compare, write the tables, print them."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.crossings", description=__doc__.partition("\n\n")[0]
    )
    parser.add_argument("logs", nargs="+", type=Path, help="logs of any format, or folders of them")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for the tables")
    parser.add_argument("-p", "--planner", default="dp_qp")
    told = parser.parse_args(argv)
    rows, without = [], []
    try:
        for source in select(told.logs, LogSettings()).sources:
            row = compared(source.read(), told.planner)
            if row is None:
                without.append(source.label)
            else:
                rows.append(asdict(row))
    except ReplanError as error:
        sys.exit(f"error: {error}")
    table = pd.DataFrame(rows).round(2)
    told.out.mkdir(parents=True, exist_ok=True)
    write_file(told.out / "crossings.csv", lambda path: table.to_csv(path, index=False))
    lines = [
        "| " + " | ".join(map(str, table.columns)) + " |",
        "| " + " | ".join("---" for _ in table.columns) + " |",
    ]
    lines += ["| " + " | ".join(map(str, row)) + " |" for row in table.itertuples(index=False)]
    lines += ["", *(f"No one on the path ahead of the driver: {label}" for label in without)]
    write_text(told.out / "crossings.md", "\n".join(lines) + "\n")
    sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
