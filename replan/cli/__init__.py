"""The command line: it parses options, calls the other packages, and sets the exit code.

Commands by subject:

evaluate.py    drive: evaluate, vary, paper, calibrate
search.py      search: falsify, tune, diagnose
report.py      the end of a run, reports, shards put together, run against run: merge, report,
               compare, baseline
score.py       the scores of nuPlan and NAVSIM: score
logs.py        read and write logs: synth, convert, repair, inspect, salvage, export
one_drive.py   look at one drive: view, plot, explain, frame
mine.py        what happened in logs: mine, query, cut, suite, coverage
about.py       what replan knows: list, metrics; kernels compiled beforehand: warmup
options.py     options of several commands, shell completion, old spellings
app.py         what the commands share
"""

from replan.cli import about, evaluate, logs, mine, one_drive, report, score, search
from replan.cli.app import app, bug, group_commands, say_correctable
from replan.interruption import end_at_once

__all__ = [
    "about",
    "app",
    "evaluate",
    "logs",
    "main",
    "mine",
    "one_drive",
    "report",
    "score",
    "search",
]

PANELS = {
    "Drive and judge": ("evaluate", "vary", "paper", "calibrate"),
    "Look, explain, compare": (
        "view",
        "plot",
        "explain",
        "frame",
        "report",
        "compare",
        "baseline",
        "score",
    ),
    "Find failures and improve": ("diagnose", "falsify", "tune"),
    "Find moments in logs": ("mine", "query", "cut", "coverage", "suite"),
    "Logs": ("inspect", "synth", "convert", "repair", "salvage", "export"),
    "Names, kernels, shards": ("list", "metrics", "warmup", "merge"),
}
"""The groups of `replan --help` with their commands, in order."""
group_commands(PANELS)

COLLECTED_EVERY = 10_000
"""New objects between two garbage collections: with Python's 700, they took 1/12 of the time to a
first verdict.
"""


def main() -> None:
    """Run the command line.

    Ends the process with its exit code, which is `INTERNAL` for a bug in replan.
    """
    end_at_once()
    import gc
    import sys

    from replan.draw.report.console import lasting_streams

    gc.set_threshold(COLLECTED_EVERY)
    lasting_streams()
    try:
        try:
            app(prog_name="replan")
        finally:
            sys.stdout.flush()
    except Exception as error:
        code = say_correctable(error)  # outside of a command: in its help, or as its words are read
        if code is None:
            bug(error)
        sys.exit(code)
