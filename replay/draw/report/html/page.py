"""Overview, comparison and the pages of drives as one HTML file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import cache, partial
from importlib import resources
from math import isfinite
from pathlib import Path
from typing import Any

import pandas as pd
from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup

from logs.errors import writing
from logs.names import counted
from metrics.compare import Comparison
from replay.draw.charts.canvas import Chart, printable
from replay.draw.charts.overall import distributions, moved, pass_shares
from replay.draw.charts.style import RULES, filled, roles
from replay.draw.report.attempts import Attempts
from replay.draw.report.html.drive import DrivePage, drive_page, failed_page
from replay.draw.report.model import DriveRow, Overview
from replay.results.load import Results
from replay.results.tables import safe_name, write_text

MOST_REGRESSIONS, MOST_IMPROVEMENTS, MOST_GROUPS, MOST_MOVED = 60, 20, 80, 6
"""Rows of the comparison's tables, and how many metrics are drawn."""
_ORDER = {"fail": 0, "inconclusive": 1}


def write_html(overview: Overview, results: Results, path: Path, *, drives: int = 100) -> tuple[str, ...]:
    """Write the report as one HTML file; the same run gives the same bytes.

    Args:
        overview: Of the results; with its comparison, if there is one.
        results: The run.
        path: Of the file; links to recordings are relative to it.
        drives: So many drives have a page, the worst first; the table has all of them.

    Returns:
        Charts that could not be drawn, a sentence each, with how many pages it concerns.

    Raises:
        OutputError: It cannot be written.
    """
    broken = Counter[str]()

    def pages() -> Iterator[DrivePage]:
        for row in paged:
            anchor, attempt = anchors[row.log, row.planner], Attempts()
            made = attempt("The page of a drive", partial(drive_page, results, row, anchor, path), None)
            page = failed_page(row, anchor, attempt.broken[0]) if made is None else made
            broken.update(page.broken)
            yield page

    paged = worst_first(overview.drives)[:drives]
    anchors, shares = _anchors(paged), [*overview.whole, *overview.grouped]
    attempt = Attempts()
    share = attempt("The chart of shares", lambda: _markup(pass_shares(shares, len(overview.planners))), Markup())
    drawn = attempt(
        "The charts of distributions", lambda: distributions(overview.columns, overview.drives), list[Chart]()
    )
    page = _environment().get_template("report.html").render(
        overview=overview,
        shares=share if shares else "",
        distributions=[_markup(chart) for chart in drawn],
        anchors=anchors,
        pages=pages(),
        paged=paged,
        comparison=None if overview.comparison is None else _compared(overview.comparison),
        style=Markup(_read("style.css") + roles("auto") + filled(RULES, "auto")),  # our own files
        script=Markup(_read("script.js")),
    )  # fmt: skip
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, page)
    each = (f"{said} ({times} of {counted(len(paged), 'drive')})" for said, times in broken.items())
    return (*attempt.broken, *each)


def worst_first(drives: Sequence[DriveRow]) -> list[DriveRow]:
    """Failed, then inconclusive, then passed; within these the one with most trouble first."""
    return sorted(drives, key=lambda row: (_ORDER.get(row.verdict, 2), -row.trouble))


def _anchors(rows: Sequence[DriveRow]) -> dict[tuple[str, str], str]:
    """An id for each page, made of the names; a number where two would be the same."""
    found: dict[tuple[str, str], str] = {}
    taken: set[str] = set()
    for row in rows:
        name = f"drive/{safe_name(row.log)}/{safe_name(row.planner)}"
        anchor = next(one for one in (name, *(f"{name}-{k}" for k in range(2, len(rows) + 2))) if one not in taken)
        taken.add(anchor)
        found[row.log, row.planner] = anchor
    return found


def _markup(chart: Chart) -> Markup:
    return Markup(chart.inline())  # canvas escapes every word


def _compared(comparison: Comparison) -> dict[str, Any]:
    """The comparison as lists of rows."""
    groups = comparison.groups
    asked = groups["metric"].isin(set(comparison.pairs.loc[comparison.pairs["asked"].astype(bool), "metric"]))
    shown = groups[groups["significant"].astype(bool) | asked & (groups["kind"] == "suite")]
    moving = shown[shown["delta"].abs() > 0.0]
    order = moving.assign(rank=~moving["significant"].astype(bool)).sort_values("rank", kind="stable")
    worse = comparison.regressions(MOST_REGRESSIONS, each=3)
    return {
        "of": comparison,
        "flips": _dicts(_failing_first(comparison.flips)),
        "regressions": _dicts(worse),
        "improvements": _dicts(comparison.improvements(MOST_IMPROVEMENTS)),
        "groups": _dicts(order.head(MOST_GROUPS)),
        "more_groups": max(len(order) - MOST_GROUPS, 0),
        "partings": _dicts(comparison.partings),
        "charts": [_markup(chart) for chart in _moved(comparison)],
    }


def _failing_first(flips: pd.DataFrame) -> pd.DataFrame:
    rank = 2 - 2 * (flips["after"] == "fail") - (flips["before"] == "fail")
    return flips.loc[rank.sort_values(kind="stable").index]


def _moved(comparison: Comparison) -> list[Chart]:
    """The metrics that moved most, those that a gate asks of first; one chart per metric, planner and loop."""
    pairs = comparison.pairs
    both = pairs[pairs["baseline"].notna() & pairs["candidate"].notna() & (pairs["delta"] != 0.0)]
    both = both[both["worse"].notna()]
    keys = list(dict.fromkeys(zip(both["metric"], both["planner"], both["mode"], strict=True)))[:MOST_MOVED]
    return [
        moved(both[(both["metric"] == m) & (both["planner"] == p) & (both["mode"] == mode)], f"{m}, {p}, {mode} loop")
        for m, p, mode in keys
    ]


def _dicts(table: pd.DataFrame) -> list[Mapping[str, Any]]:
    return table.to_dict("records")  # type: ignore[return-value]


def _read(name: str) -> str:
    return resources.files("replay.draw.report.html").joinpath("templates", name).read_text(encoding="utf-8")


@cache
def _environment() -> Environment:
    found = Environment(
        loader=FunctionLoader(_read), autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined
    )
    found.filters |= {"number": _number, "seconds": _seconds, "unit": _unit, "line": printable, "sorts": _sorts}
    return found


def _number(value: object) -> str:
    """Four digits; "-" for what is not there."""
    if not isinstance(value, (int, float)) or not isfinite(value):
        return "-"
    return f"{0.0 if abs(value) < 1e-12 else value:.4g}"


def _seconds(value: float) -> str:
    return f"{value:.2f} s" if isfinite(value) else ""


def _unit(unit: str) -> str:
    return "" if unit in ("", "1", "count") else f" {unit}"


def _sorts(value: float) -> str:
    """What a cell is sorted by; empty: last."""
    return f"{value:.9g}" if isfinite(value) else ""
