"""Which logs of a suite does a planner fail because of what it is fed?

python -m studies.separating -o OUT [--suite separating] [--only NAME ...] [--workers N]

`dp_qp` drives the suite as it is, and behind each fault of `studies.planted_inputs`.

    OUT/baseline/, OUT/NAME/    the runs
    OUT/separating.csv          a row per fault: how many logs fail with it and pass without it,
                                and their names
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from replan.draw.drawn_results import Results
from replan.metrics.judge.gates import Outcome
from replan.metrics.judge.verdicts import worst
from studies.planted_inputs import FAULTS, driven


def outcomes(run: Results) -> pd.Series[Any]:
    """The worst outcome of the gates, by log."""
    gates = run.verdicts["outcome"].map(Outcome)
    return gates.groupby(run.verdicts["log"], sort=False).agg(worst)


def row(name: str, faulty: Results, baseline: Results) -> dict[str, Any]:
    """The logs that fail with a fault, and pass without it."""
    failing = (outcomes(faulty) == Outcome.FAIL) & (outcomes(baseline) == Outcome.PASS)
    return {"fault": name, "logs": int(failing.sum()), "names": "; ".join(failing.index[failing])}


def main(words: Sequence[str] | None = None) -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--suite", default="separating")
    parser.add_argument("--only", nargs="+", choices=list(FAULTS), default=list(FAULTS))
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args(words)
    baseline = driven("baseline", options.out, options.workers, options.suite)
    rows = []
    for name in options.only:
        faulty = driven(name, options.out, options.workers, options.suite)
        rows.append(row(name, faulty, baseline))
        sys.stdout.write(f"{rows[-1]}\n")
        sys.stdout.flush()
        pd.DataFrame(rows).to_csv(options.out / "separating.csv", index=False)


if __name__ == "__main__":
    main()
