"""A suite of the catalogue as a picture: per family and cell what became of it, beside the careful
driver of UN R157.

    python -m studies.catalogue -o OUT [--suite full] [-p dp_qp] [--workers 1] [--results DIR]

Drives the suite in the closed loop (or takes the results of such a run) and writes
OUT/catalogue.csv, a row per log (`COLUMNS`), OUT/catalogue.md, counted by family and with every
cell that is not passed, and OUT/catalogue.png.

What a cell is, the first that holds:

    not evaluated    the log or the planner failed
    contact          the ego meets someone by its fault, the careful driver does not, or meets them
                     not so fast
    unavoidable      it meets someone, and so does the careful driver
    run into         a replayed road user ran into it, which is not its fault
    fails a gate     no contact, but another of the packaged gates fails
    better           no contact, where the careful driver meets someone
    pass             no contact, no gate fails

The careful driver brakes on the ego's line and never steers. Where they meet no one anyway, other
things are asked.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Mapping, Sequence
from math import ceil, nan
from pathlib import Path
from typing import Any

import pandas as pd

from replan.config import RunConfig
from replan.core.errors import ConfigError, ReplanError
from replan.draw.charts.axes import Plane, rows_plane
from replan.draw.charts.chart import Chart
from replan.draw.charts.layout import GAP_PX, together
from replan.draw.charts.legend import legend
from replan.logs.catalogue import FAMILIES, SUITES, Family
from replan.metrics.judge import CAREFUL, IMPACT, REFERENCE, REPLAY_CONTACT
from replan.metrics.judge.gates import Outcome
from replan.results.tables import write_file, write_text
from replan.run import evaluate_logs
from replan.run.pool import freeze_gc

COLUMNS = (
    "log",
    "family",
    "parameters",
    "outcome",
    "careful",
    "careful_margin_m",
    "end",
    "detail",
    "t_end_s",
    "gap_m",
    "impact_mps",
    "careful_impact_mps",
    "failed_gates",
)
"""`careful`: "avoids", "meets", or "meets no one anyway" at constant speed."""
OUTCOMES: Mapping[str, str] = {
    "pass": "green",
    "better": "blue",
    "fails a gate": "olive",
    "run into": "orange",
    "unavoidable": "grey",
    "contact": "red",
    "not evaluated": "blank",
}
"""Colours, in the order of the legend and of the tables' columns."""
PASSED = ("pass", "better", "unavoidable", "run into")
AT_FAULT = "collision_at_fault.count"
SLOWER_MPS = 1.0
"""An impact that is so much harder than the careful driver's is the planner's (as in
`replan.metrics.judge`).
"""
ACROSS, PANEL_PX, TOP_PX = 6, (250.0, 190.0), 40.0
TICKS = 7
WIDE = 0.85
"""How much of its place a cell fills."""


def table_of(results: Path, planner: str) -> pd.DataFrame:
    """A row per log of a run in the closed loop, in its order; `COLUMNS`.

    Raises:
        ConfigError: The folder holds no such run.
    """
    try:
        summary = json.loads((results / "summary.json").read_text(encoding="utf-8"))
        measured = pd.read_parquet(
            results / "metrics.parquet", columns=["log", "planner", "mode", "metric", "value"]
        )
        verdicts = pd.read_parquet(results / "verdicts.parquet")
    except (OSError, ValueError) as error:
        raise ConfigError(f"{results}: no results of replan evaluate: {error}") from None
    own = measured[(measured["planner"] == planner) & (measured["mode"] == "closed")]
    careful = measured[(measured["planner"] == CAREFUL) & (measured["mode"] == REFERENCE)]
    failed = verdicts[
        (verdicts["planner"] == planner) & (verdicts["outcome"] == Outcome.FAIL.value)
    ]
    values, others = _values(own), _values(careful)
    gates = {str(log): "; ".join(rows) for log, rows in failed.groupby("log")["gate"]}
    drives = {
        drive["log"]: drive
        for log in summary["logs"]
        for drive in log["drives"]
        if drive["planner"] == planner
    }
    rows = [
        _row(log["log"], drives.get(log["log"], {}), values, others, gates)
        for log in summary["logs"]
    ]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _values(rows: pd.DataFrame) -> dict[tuple[str, str], float]:
    """By log and metric."""
    return dict(zip(zip(rows["log"], rows["metric"], strict=True), rows["value"], strict=True))


def _row(
    log: str,
    drive: Mapping[str, object],
    values: Mapping[tuple[str, str], float],
    others: Mapping[tuple[str, str], float],
    gates: Mapping[str, str],
) -> dict[str, object]:
    family, _, parameters = log.partition("@")
    applies, avoids = (
        values.get((log, f"reference_cc.{name}"), nan) for name in ("applies", "avoids")
    )
    careful = "meets no one anyway" if not applies > 0.0 else "avoids" if avoids > 0.0 else "meets"
    impacts = values.get((log, IMPACT), nan), others.get((log, IMPACT), nan)
    contact, ran = (
        values.get((log, AT_FAULT), 0.0) > 0.0,
        values.get((log, REPLAY_CONTACT), 0.0) > 0.0,
    )
    harder = impacts[0] > impacts[1] + SLOWER_MPS
    failed = gates.get(log, "")
    return {
        "log": log,
        "family": family,
        "parameters": parameters,
        "outcome": _outcome(
            careful, failed, driven=bool(drive), contact=contact, ran=ran, harder=harder
        ),
        "careful": careful,
        "careful_margin_m": values.get((log, "reference_cc.margin"), nan),
        "end": drive.get("end", ""),
        "detail": drive.get("detail", ""),
        "t_end_s": drive.get("t_end_s", nan),
        "gap_m": values.get((log, "gap.min"), nan),
        "impact_mps": impacts[0],
        "careful_impact_mps": impacts[1],
        "failed_gates": failed,
    }


def _outcome(
    careful: str, failed: str, *, driven: bool, contact: bool, ran: bool, harder: bool
) -> str:
    """The module docstring's list."""
    if not driven:
        return "not evaluated"
    if contact:
        return "unavoidable" if careful == "meets" and not harder else "contact"
    if ran:
        return "run into"
    if failed:
        return "fails a gate"
    return "better" if careful == "meets" else "pass"


def counted(table: pd.DataFrame) -> pd.DataFrame:
    """How many cells of each family came out how, all families of the table.

    The last row is their sum.
    """
    names = list(dict.fromkeys(table["family"]))
    counts = pd.crosstab(table["family"], table["outcome"]).reindex(
        index=names, columns=list(OUTCOMES), fill_value=0
    )
    counts.insert(0, "cells", counts.sum(axis=1))
    counts["careful meets"] = [
        int(((table["family"] == n) & (table["careful"] == "meets")).sum()) for n in names
    ]
    counts = counts.sort_index()
    counts.loc["all"] = counts.sum()
    return counts


def written(table: pd.DataFrame, suite: str, planner: str) -> str:
    """catalogue.md."""
    counts = counted(table)
    lines = [
        f"# `{planner}` on `{suite}`, closed loop",
        "",
        *_markdown(counts.reset_index(names="family")),
    ]
    left = table[~table["outcome"].isin(PASSED)]
    columns = [
        "log",
        "outcome",
        "careful",
        "end",
        "detail",
        "t_end_s",
        "gap_m",
        "impact_mps",
        "failed_gates",
    ]
    lines += [
        "",
        f"## {len(left)} cells not passed",
        "",
        *_markdown(left.sort_values(["outcome", "log"])[columns]),
    ]
    return "\n".join([*lines, ""])


def _markdown(table: pd.DataFrame) -> list[str]:
    def shown(value: object) -> str:
        return "" if value != value else f"{value:.3g}" if isinstance(value, float) else str(value)

    rows = [[shown(value) for value in row] for row in table.itertuples(index=False)]
    return [
        f"| {' | '.join(row)} |"
        for row in ([str(c) for c in table.columns], ["---"] * len(table.columns), *rows)
    ]


def picture(table: pd.DataFrame, title: str) -> Chart:
    """A panel per family that has a grid, one of all others.

    A ring is where the careful driver meets someone.
    """
    grids = [name for name in FAMILIES if FAMILIES[name].grid and (table["family"] == name).any()]
    charts = [_panel(FAMILIES[name], table[table["family"] == name]) for name in grids]
    single = table[~table["family"].isin(grids)]
    if len(single):  # the families of a single cell below each other
        plane, names = rows_plane(
            [str(log) for log in single["log"]], (0.0, 4.0), 300.0, 14.0, top=TOP_PX, most=220.0
        )
        rows = [row for _, row in single.iterrows()]
        inside = "".join(
            _mark(plane, 0.5, at, row, 0.7) for row, (at, _) in zip(rows, names, strict=True)
        )
        charts.append(
            plane.chart("single", "families of one cell", inside, x_ticks=(), y_ticks=names)
        )
    entries = [
        *(("area", kind, name) for name, kind in OUTCOMES.items()),
        ("area", "ring", "UN R157's driver meets someone"),
    ]
    wide = ACROSS * (PANEL_PX[0] + GAP_PX)
    head = Chart("legend", "", "", wide - GAP_PX, 20.0, legend(0.0, 14.0, entries))
    return together([head, *charts], title, "", wide)


def _axes(family: Family) -> tuple[str, str]:
    """The parameters of the axes: the ego's speed, and the one with the most other values; "" where
    there is none.
    """
    names = sorted(family.grid, key=lambda name: (name != "ego_kmh", -len(family.grid[name])))
    return names[0], names[1] if len(names) > 1 else ""


def _panel(family: Family, rows: pd.DataFrame) -> Chart:
    """The cells of a family by two of its parameters.

    Those that share a place fill it row by row.
    """
    along, up = _axes(family)
    x, y = (family.grid.get(name, ()) for name in (along, up))
    plane = Plane((-0.6, len(x) - 0.4), (-0.6, max(len(y), 1) - 0.4), *PANEL_PX, top=TOP_PX)
    cells = [_numbers(words) for words in rows["parameters"]]
    places = [
        tuple(family.grid[name].index(cell[name]) if name else 0 for name in (along, up))
        for cell in cells
    ]
    used, inside = dict[tuple[int, ...], int](), ""
    for place, (_, row) in zip(places, rows.iterrows(), strict=True):
        nth, side = used.get(place, 0), ceil(places.count(place) ** 0.5)
        used[place] = nth + 1
        at_x, at_y = (
            v + WIDE * ((k + 0.5) / side - 0.5)
            for v, k in zip(place, (nth % side, nth // side), strict=True)
        )
        inside += _mark(plane, at_x, at_y, row, WIDE / side)
    hidden = ", ".join(name for name in family.grid if name not in (along, up))
    head = f"{family.name} and {hidden}" if hidden else family.name
    titles = dict[str, Any](x_title=along, y_title=up, x_ticks=_ticks(x), y_ticks=_ticks(y))
    return plane.chart(family.name, head, inside, **titles)


def _ticks(values: Sequence[float]) -> list[tuple[float, str]]:
    each = max(1, ceil(len(values) / TICKS))
    return [(float(k), f"{values[k]:g}") for k in range(0, len(values), each)]


def _mark(plane: Plane, x: float, y: float, row: pd.Series, size: float) -> str:
    half = 0.45 * size
    box = (x - half, x + half), (y - half, y + half)
    drawn = plane.box(*box, OUTCOMES[str(row["outcome"])], f"{row['log']}: {row['outcome']}")
    return drawn + (plane.box(*box, "ring") if row["careful"] == "meets" else "")


def _numbers(words: str) -> dict[str, float]:
    return {
        key: float(value)
        for key, _, value in (word.partition("=") for word in words.split(",") if word)
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Write table and picture, print the counts; returns the exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.catalogue", description="A suite as a picture."
    )
    parser.add_argument(
        "-o", "--out", required=True, type=Path, help="folder for table and picture"
    )
    parser.add_argument(
        "--suite", default="full", help=f"{', '.join(SUITES)}, or a family or group. Default: full"
    )
    parser.add_argument("-p", "--planner", default="dp_qp")
    parser.add_argument(
        "--workers", type=int, default=os.cpu_count() or 1, help="processes; 0: in this one"
    )
    parser.add_argument(
        "--results", type=Path, help="take the results of this run instead of driving"
    )
    chosen = parser.parse_args(arguments)
    try:
        results = chosen.results or _driven(
            chosen.suite, chosen.planner, chosen.out / "results", chosen.workers
        )
        table = table_of(results, chosen.planner)
    except ReplanError as error:
        parser.error(str(error))
    chosen.out.mkdir(parents=True, exist_ok=True)
    write_file(
        chosen.out / "catalogue.csv",
        lambda partial: table.to_csv(partial, index=False, lineterminator="\n"),
    )
    write_text(chosen.out / "catalogue.md", written(table, chosen.suite, chosen.planner))
    picture(table, f"{chosen.planner} on the suite {chosen.suite}, closed loop").save(
        chosen.out / "catalogue.png"
    )
    print(counted(table).to_string())  # noqa: T201
    return 0


def _driven(suite: str, planner: str, out: Path, workers: int) -> Path:
    """The folder of a closed-loop run of the suite."""
    freeze_gc()
    run = RunConfig(planners=(planner,), mode="closed", recording=False, internals="none")
    evaluate_logs(
        run=run,
        out=out,
        workers=workers,
        suite=suite,
        on_log=lambda result: print(result.name, file=sys.stderr),  # noqa: T201
    )
    return out


if __name__ == "__main__":
    sys.exit(main())
