"""What planners make of recorded drives: goal, verdict, hard braking, comfort, gaps; one Markdown
row per drive.

    replan evaluate LOGS ... -p dp_qp -p idm -o RUN
    python -m studies.raw_drives RUN [--planner dp_qp]

Reads the tables of a run, closed loop. Hard are seconds with more than 3.5 m/s2 of braking; "false"
counts hard braking for road users who then did not come into the way (metric `false_braking`).
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import pandas as pd

from replan.paper.reproduce import markdown

HARD_MPS2 = 3.5
COLUMNS = {
    "goal": "goal.final",
    "hardest": "lon_accel.min",
    "jerk beyond 4.13, s": "lon_jerk_state.time_out_of_bounds",
    "TTC": "ttc.min",
    "gap to people": "gap_vulnerable.min",
    "false": "false_braking.count",
    "missed": "missed_braking.max",
}


def outcome(verdicts: pd.DataFrame) -> str:
    """What the gates of one drive say together."""
    found = set(verdicts["outcome"])
    return next((name for name in ("fail", "inconclusive") if name in found), "pass")


def hard_seconds(run: Path) -> dict[tuple[str, str], float]:
    """Seconds of hard braking by log and planner."""
    out = {}
    for path in sorted(run.glob("*/frames.parquet")):
        log = json.loads((path.parent / "log.json").read_text(encoding="utf-8"))["log"]
        frames = pd.read_parquet(
            path, filters=[("metric", "==", "lon_accel"), ("mode", "==", "closed")]
        )
        for planner, rows in frames.groupby("planner"):
            t = rows["t_s"].to_numpy()
            out[log, str(planner)] = float(
                np.diff(t, append=t[-1])[rows["value"] < -HARD_MPS2].sum()
            )
    return out


def table(run: Path) -> pd.DataFrame:
    """A row per log and planner."""
    metrics = pd.read_parquet(run / "metrics.parquet").query("mode == 'closed'")
    verdicts = pd.read_parquet(run / "verdicts.parquet").query("mode == 'closed'")
    values = metrics.pivot_table(
        index=["log", "planner"], columns="metric", values="value", aggfunc="first"
    )
    out = values.reindex(columns=list(COLUMNS.values()))
    out.columns = pd.Index(COLUMNS)
    judged = {key: outcome(rows) for key, rows in verdicts.groupby(["log", "planner"])}
    out.insert(0, "verdict", [judged.get(key, "-") for key in out.index])
    hard = hard_seconds(run)
    out.insert(3, "hard, s", [hard.get(key, np.nan) for key in out.index])
    return out


def main() -> None:
    """Print the rows, and a sum per planner."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.raw_drives", description="Recorded drives in a run."
    )
    parser.add_argument("run", type=Path)
    parser.add_argument("--planner", help="rows of this one only; sums are of all")
    chosen = parser.parse_args()
    rows = table(chosen.run)
    shown = (
        rows
        if chosen.planner is None
        else rows.xs(chosen.planner, level="planner", drop_level=False)
    )
    print(markdown(shown.reset_index()))
    sums = rows.groupby("planner").agg(
        drives=("verdict", "size"),
        goals=("goal", "sum"),
        passes=("verdict", lambda one: int((one == "pass").sum())),
        hardest=("hardest", "min"),
        median_hardest=("hardest", "median"),
        beyond_45=("hardest", lambda one: int((one < -4.5).sum())),
        hard_s=("hard, s", "sum"),
        false=("false", lambda one: one.sum(min_count=1)),
    )
    print()
    print(markdown(sums.reset_index()))


if __name__ == "__main__":
    main()
