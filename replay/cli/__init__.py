"""The command line: words in, exit code out; no logic here.

Commands by subject:

evaluate.py    drive: evaluate, vary, paper, calibrate
diagnose.py    why drives fail: diagnose
search.py      search: falsify, tune
shards.py      put the shards of a run together: merge
report.py      write the reports of results: report
logs.py        read and write logs: synth, convert, repair, inspect, salvage, export
warmup.py      compile kernels beforehand: warmup
results.py     look at results: view
compare.py     run against run: compare, baseline
plot.py        pictures of a drive: plot
explain.py     a drive in words: explain
mine.py        what happened in logs: mine, query, cut, suite, coverage
frame.py       plan one frame again: frame
about.py       what replan knows: list, metrics
chosen.py      the drive that plot, explain, frame and view show
renamed.py     options of the last version that have another name now
names.py       names and keys for shell completion
ending.py      the end of a run: reports, exit code
app.py         what the commands share
"""

from replay.cli import evaluate, diagnose, search, shards, report, logs, results, compare  # isort: skip  # the order of the help
from replay.cli import plot, explain, frame, mine, about, warmup  # isort: skip
from replay.cli.app import app, bug
from replay.interruption import end_at_once

__all__ = [
    "about",
    "app",
    "compare",
    "diagnose",
    "evaluate",
    "explain",
    "frame",
    "logs",
    "main",
    "mine",
    "plot",
    "report",
    "results",
    "search",
    "shards",
    "warmup",
]

COLLECTED_EVERY = 10_000
"""New objects between two garbage collections: with Python's 700, they took a twelfth of a first verdict."""


def main() -> None:
    """Run the command line; ends the process with its exit code, which is `INTERNAL` for a bug in replan."""
    end_at_once()
    import gc

    from replay.draw.report.console import lasting_streams

    gc.set_threshold(COLLECTED_EVERY)
    lasting_streams()
    try:
        app(prog_name="replan")
    except Exception as error:
        bug(error)
