"""Does `replan diagnose` find a planted cause?

python -m studies.diagnosis -o OUT [--suite NAME] [--most N] [--only NAME ...] [--planner NAME]
[--workers N]

One fault (`PLANTS`) is planted in a run over a suite of the catalogue. Drives that pass without it
all gates that they fail with it, and fail no other one, fail for it; at most N of them, evenly
drawn from their sorted names, are diagnosed twice: with all changes, where a change back to the
defaults undoes the fault; and "hidden", without those changes, where only ideal parts (no latency
is one, too) and wider limits can show it. A diagnosis is right where it names the
planted cause, and wrong where it does not; it may name it among others, or say "not found".

    OUT/diagnosis.csv     a row per fault: failing drives, and how many have each of `ANSWERS`; the
                          same hidden
    OUT/sound/, OUT/NAME/run/, OUT/NAME/all/, OUT/NAME/hidden/    the runs and the diagnoses
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from replan.config import load_run
from replan.core.arrays import FloatArray
from replan.core.errors import ReplanError
from replan.draw.drawn_results import Results
from replan.experiments.changes import NOT_FOUND, load_changes
from replan.experiments.diagnose import diagnose, question
from replan.experiments.diagnosis import Diagnosis
from replan.logs.agents import AgentKind, Agents, among
from replan.logs.frame import Predictions
from replan.replay.prediction import LaneMap
from replan.replay.prediction.lane_following import everybody
from replan.results.tables import write_file
from replan.run import evaluate_logs


def frozen(agents: Agents, t: FloatArray, lanes: LaneMap) -> Predictions:
    """As `lane_following`, but pedestrians stay where they are."""
    found = everybody(agents, t, lanes)
    walks = among(AgentKind.PEDESTRIAN)[agents.codes][found.agent]
    x, y = (np.where(walks[:, None], column[:, :1], column) for column in (found.x, found.y))
    return replace(found, x=x, y=y)


@dataclass(frozen=True)
class Plant:
    """A fault: the cause that a diagnosis has to name, and the settings of the run with it."""

    cause: str
    table: Mapping[str, Any]


def _limits(decel: float) -> dict[str, float]:
    return {"accel_mps2": 1.8, "decel_mps2": decel, "jerk_mps3": 1.0}


PLANTS = {
    "frozen pedestrians": Plant("prediction", {"loop": {"prediction": "studies.diagnosis:frozen"}}),
    "late by 0.3 s": Plant("latency", {"loop": {"plan_delay_s": 0.3}}),
    "slow actuators": Plant(
        "control",
        {
            "loop": {
                "plant": {
                    "brake_lag": 0.8,
                    "brake_delay": 0.4,
                    "throttle_lag": 0.8,
                    "steer_lag": 0.4,
                }
            }
        },
    ),
    "weak braking": Plant(
        "comfort bound",
        {
            "planner": {
                "dp_qp": {"speed": {"qp": {"comfort": _limits(1.0), "emergency": _limits(1.5)}}},
                "idm": {"decel_mps2": 1.0, "hardest_mps2": 1.5, "jerk_mps3": 1.0},
            }
        },
    ),
    "noisy perception": Plant(
        "perception",
        {
            "loop": {
                "perception": "sensor",
                "sensor": {
                    "range_m": 25.0,
                    "position_noise_m": 0.6,
                    "velocity_noise_mps": 1.0,
                    "latency_s": 0.4,
                    "dropout": 0.3,
                },
            }
        },
    ),
}
"""By name."""
IDEAL = "no_latency"
"""A change to a default that is an ideal part as well."""
ANSWERS = ("right", "among", "not_found", "wrong")
COLUMNS = ("fault", "cause", "drives", *ANSWERS, *(f"hidden_{name}" for name in ANSWERS))


def broken(faulty: Results, sound: Results) -> list[str]:
    """Logs, sorted, whose drives fail gates in a run, all of which they pass in another one, and
    fail none there.
    """
    names = ["log", "gate"]
    passed, unsound = (
        sound.verdicts.loc[sound.verdicts["outcome"] == said, names] for said in ("pass", "fail")
    )
    failed = faulty.verdicts.loc[faulty.verdicts["outcome"] == "fail", names]
    both = failed.merge(passed, how="left", on=names, indicator="where")
    return sorted(
        set(failed["log"]) - set(both.loc[both["where"] != "both", "log"]) - set(unsound["log"])
    )


def counts(found: Diagnosis, cause: str) -> list[int]:
    """How many drives have each of `ANSWERS`."""
    said: Counter[str] = Counter()
    for one in found.drives:
        causes = one.cause.name.split(" or ")
        known = ("right" if len(causes) == 1 else "among") if cause in causes else "wrong"
        said["not_found" if one.cause.name == NOT_FOUND else known] += 1
    return [said[name] for name in ANSWERS]


def row(name: str, asked: argparse.Namespace, sound: Results) -> dict[str, Any]:
    """What came of a fault: `COLUMNS`."""
    plant, folder, planner, workers = (
        PLANTS[name],
        asked.out / name.replace(" ", "_"),
        asked.planner,
        asked.workers,
    )
    folder.mkdir(parents=True, exist_ok=True)
    planners = {
        key: table for key, table in plant.table.get("planner", {}).items() if key == planner
    }
    run = load_run(None, {**plant.table, "planner": planners, **_asked(planner)})
    faulty = evaluate_logs(run=run, out=folder / "run", workers=workers, suite=asked.suite)
    mine = broken(faulty, sound)
    mine = mine[:: -(-len(mine) // asked.most)] if mine else mine
    found: list[int] = []
    hidden = [
        change for change in load_changes() if change.rank != "default" or change.name == IDEAL
    ]
    for kind, changes in (("all", load_changes()), ("hidden", hidden)) if mine else ():
        result = diagnose(question(faulty, None, mine, changes), folder / kind, workers=workers)
        sys.stdout.write("\n".join([f"{name}, {kind}", *result.lines()]) + "\n")
        found += counts(result, plant.cause)
    return dict(
        zip(
            COLUMNS, (name, plant.cause, len(mine), *(found or [0] * 2 * len(ANSWERS))), strict=True
        )
    )


def _asked(planner: str) -> dict[str, Any]:
    return {"planners": [planner], "mode": "closed", "recording": False}


def main(words: Sequence[str] | None = None) -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--suite", default="full")
    parser.add_argument("--most", type=int, default=12)
    parser.add_argument("--only", nargs="+", choices=list(PLANTS), default=list(PLANTS))
    parser.add_argument("--planner", default="dp_qp")
    parser.add_argument("--workers", type=int, default=1)
    asked = parser.parse_args(words)
    rows = []
    try:
        run = load_run(None, _asked(asked.planner))
        sound = evaluate_logs(
            run=run, out=asked.out / "sound", workers=asked.workers, suite=asked.suite
        )
        for name in asked.only:
            rows.append(row(name, asked, sound))
            sys.stdout.write(f"{rows[-1]}\n\n")
            sys.stdout.flush()
    except ReplanError as error:
        sys.exit(f"error: {error}")
    table = pd.DataFrame(rows, columns=list(COLUMNS))
    write_file(
        asked.out / "diagnosis.csv",
        lambda partial: table.to_csv(partial, index=False, lineterminator="\n"),
    )


if __name__ == "__main__":
    main()
