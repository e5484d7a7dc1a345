"""The page of a drive in the HTML report: a log and a planner, with the pictures of its worst
moment.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup

from replan.core.errors import LogError, ReplanError, described
from replan.draw.charts import subject
from replan.draw.charts.bird_view import place_of_moment
from replan.draw.charts.chart import Chart
from replan.draw.charts.curves import panel_chart
from replan.draw.charts.layout import BROKEN, placed
from replan.draw.charts.subject import Subject
from replan.draw.drawn_results import DriveResult, Results
from replan.draw.panels import Curve, Panel
from replan.draw.report.attempts import Attempts
from replan.draw.report.drive_table import DriveRow
from replan.explain.drive_events import TimedEvent, events
from replan.explain.input_faults import describe_input, use_of
from replan.metrics.judge.gates import Outcome


@dataclass(frozen=True, eq=False)
class DrivePage:
    """The contents of the page of a drive."""

    anchor: str
    row: DriveRow
    why: str = (
        ""  # The reason for the moment of the pictures; without pictures, the reason for that
    )
    drives: Sequence[DriveResult] = ()  # Both loops, the closed one first
    shown: DriveResult | None = None  # That of the pictures
    # Rows of `DriveResult.verdicts` of both loops, failed ones first
    verdicts: Sequence[Any] = ()
    subject: Subject | None = None  # None: there are no pictures
    # The action of the plan at the moment, and its reasons, in sentences
    because: Sequence[str] = ()
    # The charts by their place; `scene`: the index of the scene at the moment in "pictures"
    charts: Mapping[str, Sequence[Markup]] = field(default_factory=dict)
    scene: int = 0
    events: Sequence[TimedEvent] = ()  # The changes, with their times
    broken: Sequence[str] = ()  # Charts that could not be drawn, a sentence each

    @property
    def missing(self) -> dict[str, list[str]]:
        """Each reason, and the metrics that are not available in a loop because of it."""
        reasons: dict[str, list[str]] = {}
        for drive in self.drives:
            lost = drive.metrics[~drive.metrics["available"].astype(bool)]
            for reason, metric in lost[["reason", "metric"]].itertuples(index=False):
                reasons.setdefault(reason, []).append(metric)
        return {reason: list(dict.fromkeys(metrics)) for reason, metrics in reasons.items()}


def drive_page(
    results: Results, row: DriveRow, anchor: str, *, reads_input: bool = False
) -> DrivePage:
    """The page of a log and a planner; the pictures are of the loop in which a gate failed, the
    closed one first.

    `reads_input`: with what the plans used (`replan.explain.input_use`), which takes as long as
    perception does.
    """
    modes = [mode for mode in ("closed", "open") if mode in row.runs]
    drives = [results.drive(row.log, row.planner, mode) for mode in modes]
    failed = (drive for drive in drives if (drive.verdicts["outcome"] == Outcome.FAIL.value).any())
    verdicts = [line for drive in drives for line in drive.verdicts.itertuples(index=False)]
    order = [outcome.value for outcome in Outcome]
    page = DrivePage(
        anchor,
        row,
        drives=drives,
        shown=next(failed, drives[0]),
        verdicts=sorted(verdicts, key=lambda line: order.index(line.outcome)),
    )
    assert page.shown is not None
    try:
        return _with_pictures(page, subject(page.shown), reads_input=reads_input)
    except ReplanError as error:
        why = error.what if isinstance(error, LogError) else str(error)
    except Exception as error:
        why = described(error)
    return replace(page, why=f"no pictures: {why}")


def _with_pictures(page: DrivePage, seen: Subject, *, reads_input: bool) -> DrivePage:
    attempt, short = Attempts(), seen.scenario.short_names
    changes = attempt(
        "The list of events", lambda: events(seen.trace, seen.plans), list[TimedEvent]()
    )
    because = attempt("The account of the plan", lambda: seen.because, tuple[str, ...]())
    charts = placed(seen, seen.drive.result.run.charts)
    if reads_input:
        use = attempt("What the plans used", lambda: use_of(seen.drive), None)
        because = (*(map(short, describe_input(use)) if use else ()), *because)
        panel = input_panel(use.table()) if use else None
        charts["curves"] += [panel_chart(panel, seen.span, now=seen.moment.t)] if panel else []
    lost = [chart.says for group in charts.values() for chart in group if chart.name == BROKEN]
    return replace(
        page,
        why=seen.moment.why,
        subject=seen,
        because=because,
        charts={place: [chart_markup(chart) for chart in group] for place, group in charts.items()},
        scene=place_of_moment(seen),
        events=[replace(event, words=short(event.words)) for event in changes],
        broken=(*lost, *attempt.broken),
    )


def input_panel(table: pd.DataFrame) -> Panel | None:
    """How far the outlines that each plan used are off what perception showed: the most, and what
    is allowed for that agent. None if there are no outlines.

    `table`: with the columns of input_use.parquet.
    """
    off = table[np.isfinite(table["off_m"].astype(np.float64))]
    if off.empty:
        return None
    most = off.sort_values("off_m", kind="stable").drop_duplicates("t_s", keep="last")
    t, values, allowed = most.sort_values("t_s")[["t_s", "off_m", "allowed_m"]].to_numpy(float).T
    curves = Curve("off", "most", t, values), Curve("allowed", "allowed", t, allowed, asked=True)
    title = "Outlines off what perception showed [m]"
    return Panel("input", title, curves, 1.0, floor=0.0)


def chart_markup(chart: Chart) -> Markup:
    """A chart in a page."""
    return Markup(chart.inline())  # svg.py escapes every word
