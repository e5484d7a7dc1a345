"""The events of mined logs to look at: events.html, a table with a picture of each, which sorts and
filters.

A picture shows the scene at the middle of the event, with the road users that took part in red, and
below it the speeds of the ego and of the main one around it. The pictures are files in events/,
drawn as a log is mined: at most `MOST_OF_A_KIND` of a log and kind.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import isfinite
from pathlib import Path
from shlex import join
from typing import Any

import numpy as np
import pandas as pd

from replan.core.errors import writing
from replan.draw.charts.bird_view import scene
from replan.draw.charts.chart import Chart, stacked
from replan.draw.charts.curves import Span, panel_chart
from replan.draw.charts.subject import Moment, SceneSubject
from replan.draw.panels import Curve, Panel
from replan.draw.report.rendering import rendered
from replan.logs.scenario import Scenario
from replan.logs.trace import EndReason, Mode, Trace
from replan.results.tables import safe_name, write_text

PAGE, PICTURES = "events.html", "events"
MOST_OF_A_KIND = 5
"""Largest number of events of one kind in one log that are drawn: the first."""
MOST_ROWS = 2000
"""Largest number of events on the page; events.parquet has all."""
AROUND_S = 3.0
"""The speeds are drawn, and the shown command drives, from this long before the event to as long
after it.
"""
LEAST_SPAN_MPS = 2.0
"""The axis of the speeds covers at least this."""
LEAST_SPAN_S = 0.1
"""The axis of the time covers at least this."""


def draw_events(
    folder: Path, scenario: Scenario, digest: str, rows: Iterable[Mapping[str, Any]]
) -> None:
    """Draw the events of a log: rows of events.parquet; `digest` of its bytes, "" if it has none.

    Raises:
        OutputError: A picture cannot be written.
    """
    trace = Trace(
        scenario=scenario.name,
        planner="logged",
        mode=Mode.OPEN,
        oracle=True,
        ego=scenario.ego,
        agents=scenario.tracks,
        frames=(),
        end=EndReason.END_OF_LOG,
    )
    for row in rows_with_picture(rows):
        path = folder / picture_of(row, digest)
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            write_text(path, event_picture(scenario, trace, row).alone("light"))


def rows_with_picture(rows: Iterable[Mapping[str, Any]]) -> Iterator[Mapping[str, Any]]:
    """The rows of one log that have a picture."""
    count: Counter[str] = Counter()
    for row in sorted(rows, key=lambda row: (str(row["kind"]), float(row["t_from_s"]))):
        count[row["kind"]] += 1
        if count[row["kind"]] <= MOST_OF_A_KIND:
            yield row


def picture_of(row: Mapping[str, Any], digest: str) -> str:
    """The file of an event's picture in the result folder."""
    parts = (row["kind"], f"{row['t_from_s']:.2f}", *row["agents"], row["planner"])
    name = safe_name("-".join(str(part) for part in parts if part))
    return f"{PICTURES}/{digest[:12] or safe_name(str(row['log']))}/{name}.svg"


def event_picture(scenario: Scenario, trace: Trace, row: Mapping[str, Any]) -> Chart:
    """The scene at the middle of an event, and the speeds around it."""
    kind, agents = str(row["kind"]), list(row["agents"])
    begin, end = float(row["t_from_s"]), float(row["t_to_s"])
    first, last = float(trace.ego.t[0]), float(trace.ego.t[-1])
    middle = min(max(0.5 * (begin + end), first), last)
    words = kind.replace("_", " ")
    subject = SceneSubject(Moment(middle, "as asked"), trace, scenario)
    above = scene(subject, middle, words, agents)
    caption = f"{kind} at {begin:.1f} s, of {', '.join(map(str, agents)) or 'the ego alone'}"
    curves = _speed_curves(scenario, trace, agents, begin - AROUND_S, end + AROUND_S)
    if not curves:
        return replace(above, name=kind, title=words, says=caption)
    panel = Panel("speed", "Speed [m/s]", curves, LEAST_SPAN_MPS, floor=0.0)
    span = max(begin - AROUND_S, first), max(min(end + AROUND_S, last), first + LEAST_SPAN_S)
    below = panel_chart(panel, span, [Span(begin, end, "", words)], shade="normal")
    return stacked([above, below], kind, words, caption)


def _speed_curves(
    scenario: Scenario, trace: Trace, agents: Sequence[str], begin: float, end: float
) -> tuple[Curve, ...]:
    """The speeds of the ego and of the first agent within a time, s; those that are known there."""
    ego, tracks = trace.ego, scenario.tracks
    inside = (ego.t >= begin) & (ego.t <= end)
    curves = [Curve("ego", "ego", ego.t[inside], np.abs(ego.v[inside]))]
    if agents and agents[0] in tracks.ids:
        samples = tracks.samples(tracks.ids.index(agents[0]))
        t = tracks.t[samples]
        speed = np.hypot(tracks.motion.vx[samples], tracks.motion.vy[samples])
        inside = (t >= begin) & (t <= end)
        curves.append(Curve("other", scenario.short_names(agents[0]), t[inside], speed[inside]))
    return tuple(curve for curve in curves if len(curve.known))


def write_events_page(folder: Path, events: pd.DataFrame, logs: pd.DataFrame) -> None:
    """Write events.html into a result folder with the pictures: a row per event, the first
    `MOST_ROWS`.

    Raises:
        OutputError: The page cannot be written.
    """
    log_rows = {row["log"]: row for row in logs.to_dict("records")}
    rows = []
    for row in list[Any](events.head(MOST_ROWS).to_dict("records")):
        log = log_rows[row["log"]]
        picture = picture_of(row, str(log["sha256"]))
        begin = max(row["t_from_s"] - AROUND_S, 0.0)
        end = min(row["t_to_s"] + AROUND_S, log["duration_s"])
        part = [str(log["source"]), "--from", f"{begin:.1f}", "--to", f"{end:.1f}"]
        commands = [
            join(["replan", word, *part])
            for word in ("evaluate", *(["view"] if log["sha256"] else []))
        ]
        unit = "" if row["unit"] == "1" else row["unit"]
        value = f"{row['value']:.3g} {unit}" if isfinite(row["value"]) else ""
        shown = picture if (folder / picture).is_file() else ""
        rows.append({**row, "picture": shown, "commands": commands, "shown": value})
    page = rendered(
        "events.html",
        rows=rows,
        more=max(len(events) - MOST_ROWS, 0),
        logs=len(logs),
        most=MOST_OF_A_KIND,
    )
    with writing(folder / PAGE):
        write_text(folder / PAGE, page)
