"""Is a planted hole found, and is the mildest case that is found the mildest? The search beside a
grid.

python -m studies.falsify -o OUT [--only NAME ...] [--grid N] [--budget N] [--seed N] [--workers N]

A hole is planted in `idm` (`HOLES`): it sees nothing beyond 30 m; or it sees the others where they
were 0.5 s ago, and is held against `idm` without the hole, as the careful driver of UN R157 reacts
later than that. It is judged by collisions at fault and the time to collision (`GATES`): comfort
has limits of its own, which come earlier. The search (`replan falsify`) has two axes and a budget.
The grid has N x N points over the same two axes; they are driven in the order of their distance
until the first one counts: that is the mildest of the grid. The same search without the hole says
what the hole adds.

    OUT/falsify.csv     a row per hole: distance without and with the hole, drives, mildest of the
                        grid, and the ratio
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from replan.config import load_run
from replan.core.arrays import BoolArray
from replan.core.errors import ReplanError
from replan.experiments.falsify import FalsifyQuestion, SearchDrives, falsify
from replan.experiments.mildest import BATCH, Point, norm
from replan.experiments.search_subject import agents_of, box_of, search_axes, subject_of
from replan.logs.frame import Frame, PlannerContext, Predictions
from replan.logs.plan import Plan
from replan.logs.readers import LogSettings
from replan.metrics.judge import CAREFUL
from replan.planners.idm import Idm, IdmConfig
from replan.results.tables import write_file, write_text
from replan.run.output import held
from replan.run.resume import Study

GATES = """
[[gate]]
metric = "collision_at_fault.count"
mode = "closed"
max = 0

[[gate]]
metric = "ttc.time_below_950ms"
mode = "closed"
max = 0
optional = true
"""
SIGHT_M = 30.0
LATE_S = 0.5
COLUMNS = (
    "hole",
    "subject",
    "axes",
    "without",
    "distance",
    "drives",
    "grid",
    "grid_drives",
    "ratio",
    "case",
    "gates",
)


class Blind:
    """`idm` that sees no road user whose centre is farther than `sight_m` from the ego's rear
    axle.
    """

    def __init__(self, context: PlannerContext, config: IdmConfig | None = None) -> None:
        self._idm = Idm(context, config)

    def plan(self, frame: Frame) -> Plan:
        """The plan of `idm` in a frame without those who are far."""
        away = np.hypot(frame.agents.x - frame.ego.x, frame.agents.y - frame.ego.y)
        return self._idm.plan(seen(frame, away <= SIGHT_M))


class Late:
    """`idm` that sees the others and their predictions as they were `LATE_S` ago, and takes that
    for now.
    """

    def __init__(self, context: PlannerContext, config: IdmConfig | None = None) -> None:
        self._idm, self._frames = Idm(context, config), list[Frame]()

    def plan(self, frame: Frame) -> Plan:
        """The plan of `idm` with what was seen then; with the first frame's until then."""
        self._frames = [*(old for old in self._frames if old.t > frame.t - LATE_S - 1e-6), frame]
        old = self._frames[0]
        past = replace(old.predictions, t=old.predictions.t + (frame.t - old.t))
        return self._idm.plan(replace(frame, agents=old.agents, predictions=past))


def seen(frame: Frame, keep: BoolArray) -> Frame:
    """The frame with some of its agents, and their predictions."""
    rows, of = np.flatnonzero(keep), frame.predictions
    mine = np.isin(of.agent, rows)
    index = np.searchsorted(rows, of.agent[mine])
    left = Predictions(
        of.t, index, of.probability[mine], of.x[mine], of.y[mine], of.yaw[mine], of.method
    )
    return replace(frame, agents=frame.agents.some(rows), predictions=left)


@dataclass(frozen=True)
class Hole:
    """A planted hole: the planner that has it, over which two axes it is looked for, and who must
    not fail.
    """

    planner: str
    subject: str
    axes: tuple[str, str]
    against: str = CAREFUL


HOLES = {
    "blind beyond 30 m": Hole(
        "studies.falsify:Blind",
        "paper/crossing_pedestrian",
        ("ego_speed_mps=8:20", "pedestrian_speed_mps=0.5:1.7"),
    ),
    "late by 0.5 s": Hole(
        "studies.falsify:Late",
        "unece_r157/cut_in",
        ("gap_m=0:60", "relative_kmh=-50:-10"),
        "idm",
    ),
}
"""By name."""


def question(hole: Hole, gates: Path, *, planted: bool, budget: int, seed: int) -> FalsifyQuestion:
    """The falsification of a hole, or of the planner without it."""
    drives = (
        {"planners": [hole.planner], "loop": {"apart": {"trust": True}}}
        if planted
        else {"planners": ["idm"]}
    )
    table = {**drives, "gates": str(gates)}
    against = hole.against if planted else CAREFUL
    subject = subject_of(hole.subject, LogSettings())
    axes = search_axes(hole.axes, (), subject.family, with_agents=True)
    subject = subject.of(agents_of(subject, axes, ()))
    return FalsifyQuestion(subject, axes, load_run(None, table), against, budget=budget, seed=seed)


def grid(asked: FalsifyQuestion, count: int, out: Path, workers: int) -> tuple[float, int]:
    """The mildest distance of a grid of count x count points (inf: none counts), and how many were
    driven.
    """
    low, high = box_of(asked.axes)
    sides = [np.linspace(a, b, count) for a, b in zip(low, high, strict=True)]
    points: list[Point] = sorted(
        (tuple(float(u) for u in point) for point in product(*sides)), key=norm
    )
    with held(out):
        drives = SearchDrives(
            asked, out, Study(out, asked.head(), resume=False), workers, lambda line: None
        )
        for begin in range(0, len(points), BATCH):
            batch = points[begin : begin + BATCH]
            found = [
                norm(point)
                for point, one in zip(batch, drives(batch, "grid"), strict=True)
                if one.counts
            ]
            if found:
                return min(found), begin + len(batch)
    return inf, len(points)


def row(
    name: str, out: Path, *, count: int, budget: int, seed: int, workers: int
) -> dict[str, Any]:
    """What came of a hole: `COLUMNS`."""
    hole, folder = HOLES[name], out / name.replace(" ", "_")
    folder.mkdir(parents=True, exist_ok=True)
    gates = folder / "gates.toml"
    write_text(gates, GATES)
    asked = question(hole, gates, planted=True, budget=budget, seed=seed)
    sound = question(hole, gates, planted=False, budget=budget, seed=seed)
    found = falsify(asked, folder / "search", workers=workers)
    without = falsify(sound, folder / "without", workers=workers)
    mildest, driven = grid(asked, count, folder / "grid", workers)
    case = ", ".join(axis.shown(found.case[axis.name]) for axis in asked.axes) if found.case else ""
    away = found.mildest.distance
    values = (
        name,
        hole.subject,
        " ".join(hole.axes),
        without.mildest.distance,
        away,
        len(found.table),
        mildest,
        driven,
        away / mildest,
        case,
        found.case.get("gates", ""),
    )
    return dict(zip(COLUMNS, values, strict=True))


def main(words: Sequence[str] | None = None) -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--only", nargs="+", choices=list(HOLES), default=list(HOLES))
    parser.add_argument("--grid", type=int, default=21)
    parser.add_argument("--budget", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=1)
    asked = parser.parse_args(words)
    rows = []
    try:
        for name in asked.only:
            options = {
                "count": asked.grid,
                "budget": asked.budget,
                "seed": asked.seed,
                "workers": asked.workers,
            }
            rows.append(row(name, asked.out, **options))
            sys.stdout.write(
                "\n".join(f"{key}: {value}" for key, value in rows[-1].items()) + "\n\n"
            )
            sys.stdout.flush()
    except ReplanError as error:
        sys.exit(f"error: {error}")
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    write_file(
        asked.out / "falsify.csv",
        lambda partial: table.to_csv(partial, index=False, lineterminator="\n"),
    )


if __name__ == "__main__":
    main()
