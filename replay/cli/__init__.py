"""The command line: words in, exit code out; no logic here.

Commands by what they are about:

evaluate.py    what drives: evaluate, vary, paper, calibrate
shards.py      the shards of a run put together: merge
report.py      the reports of results
logs.py        what reads and writes logs: synth, convert, repair, inspect, salvage, export
warmup.py      kernels compiled beforehand: warmup
results.py     what looks at results: view
compare.py     run against run: compare, baseline
plot.py        pictures of a drive: plot
explain.py     a drive in words: explain
frame.py       one frame planned again: frame
about.py       what replan knows: list, metrics
names.py       names for shell completion
ending.py      what is said and written at the end of a run
app.py         what they share
"""

from replay.cli import evaluate, shards, report, logs, results, compare, plot, explain, frame, about, warmup  # isort: skip  # the order of the help
from replay.cli.app import app, bug

__all__ = [
    "about",
    "app",
    "compare",
    "evaluate",
    "explain",
    "frame",
    "logs",
    "main",
    "plot",
    "report",
    "results",
    "shards",
    "warmup",
]

COLLECTED_EVERY = 10_000
"""New objects after which garbage is looked for: with Python's 700, that took a twelfth of a first verdict."""


def main() -> None:
    """Run the command line; ends the process with its exit code, that of a bug in replan is `INTERNAL`."""
    import gc

    from replay.draw.report.console import lasting_streams

    gc.set_threshold(COLLECTED_EVERY)
    lasting_streams()
    try:
        app(prog_name="replan")
    except Exception as error:
        bug(error)
