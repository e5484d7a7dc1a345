"""Edits files that commands read, one change each, and counts how the commands end: never with exit
code 70.

    python -m studies.edited_files OUT --edits 1000 --seed 0

The edits (tests/support/edited.py): bytes, cut and removed files, other values and types, deep
nesting, huge numbers and NaN, missing and doubled columns, messages of logs. Each edit is read by
one command, in this process. Prints the counts by file and exit code, and each edit after which a
command ends in another way than with a documented code, with an error that is no line, or not
within 60 s.
"""

from __future__ import annotations

import argparse
import os
import random
import shlex
import shutil
import signal
import sys
import traceback
from collections import Counter
from pathlib import Path

from typer.testing import CliRunner

from replan.cli import app

sys.path.append(str(Path(__file__).parents[1] / "tests" / "support"))
from edited import edit

DRIVE = "-p constant_speed --no-recording --workers 0"
RUNNER = CliRunner(env={"COLUMNS": "200", "TERM": "dumb"})
CODES = (0, 1, 2, 3, 4)
LONGEST_S = 60
SETUP = f"""
synth paper everyday -o all
convert all/paper all/everyday --to 2 -o many
convert all/paper/crossing_pedestrian.mcap all/everyday/cut_in.mcap --to 3 -o logs
convert all/everyday/cut_in.mcap --to 3 -o log.mcap
evaluate logs -p constant_speed --workers 0 -o run
evaluate logs/cut_in.mcap -p parked --mode closed --no-recording --workers 0 -o failed
evaluate logs {DRIVE} --shard 1/2 -o shard
evaluate logs {DRIVE} --shard 2/2 -o shard-2
baseline run -o baseline.parquet
mine all/everyday --workers 0 -o mined
suite mined -o suite.toml
diagnose failed --workers 0 -o diagnosed
vary logs/cut_in.mcap -p constant_speed --workers 0 --vary ego_speed=0.9:1.1:2 -o varied
falsify logs/cut_in.mcap -p idm --workers 0 --axis ego_speed=0.9:1.1 --budget 16 -o falsified
tune many -p idm --space space.toml --trials 1 --held-out 0.7 --workers 0 -o tuned
"""
FILES = {
    "space.toml": "[planner.idm]\ntime_gap_s = { low = 1.0, high = 2.0 }\n"
    "[loop]\nplan_period_s = { choices = [0.1, 0.2] }\n",
    "gates.toml": (
        '[[gate]]\nmetric = "gap.min"\nmin = 0.5\nover = "pass_share"\nmin_share = '
        '0.9\ntags = ["paper"]\n'
        '[[compare]]\nmetric = "ttc.min"\nmax_decrease = 0.1\n'
    ),
    "changes.toml": (
        '[[change]]\nname = "a"\nwords = "b"\ncause = "comfort bound"\nrank = '
        '"limits"\n'
        'default = ["loop.traffic"]\n'
        "set.planner.idm = { time_gap_s = 2.0 }\n"
    ),
    "poses.csv": "log,t_s,x,y,yaw\n"
    + "".join(f"everyday/cut_in,0.5,{5 * k}.0,0.0,0.0\n" for k in range(1, 9)),
}
COMMANDS = {
    "run": f"""
report IT -o OUT | compare IT run | cut IT --table verdicts --where true -o OUT | baseline IT -o OUT.parquet
query IT 'SELECT count(*) AS n FROM metrics, verdicts, groups, logs, drives, gates, failures' | explain IT
query IT 'SELECT max(value) AS v FROM frames' | diagnose IT -o OUT --workers 0 | plot IT --chart st -o OUT.svg
evaluate logs {DRIVE} -o IT --resume | frame IT --at 1 | score IT --as nuplan-cls | score IT --as navsim-v2
evaluate logs {DRIVE} --baseline IT -o OUT | export commonroad-solution IT -o OUT""",  # noqa: E501
    "mined": """
query IT 'SELECT count(*) AS n FROM events, logs, health' | cut IT --where true -o OUT | suite IT -o OUT.toml
coverage IT --against mined | mine all/everyday --workers 0 -o IT --resume | coverage mined --against IT -o OUT""",  # noqa: E501
    "shard": "merge IT shard-2 -o OUT | merge shard-2 IT -o OUT",
    "diagnosed": "diagnose failed --workers 0 -o IT --resume | report failed --diagnosis IT -o OUT",
    "varied": (
        "vary logs/cut_in.mcap -p constant_speed --workers 0 --vary ego_speed=0.9:1.1:2 -o "
        "IT --resume"
    ),
    "falsified": (
        "falsify logs/cut_in.mcap -p idm --workers 0 --axis ego_speed=0.9:1.1 --budget 16 "
        "-o IT --resume"
    ),
    "tuned": (
        "tune many -p idm --space space.toml --trials 1 --held-out 0.7 --workers 0 -o IT --resume"
    ),
    "baseline.parquet": f"""
compare IT run | report run --baseline IT -o OUT | evaluate logs {DRIVE} --baseline IT -o OUT""",
    "log.mcap": f"""
evaluate IT {DRIVE} -o OUT | inspect IT | mine IT --workers 0 -o OUT | convert IT -o OUT | salvage IT OUT.mcap
repair IT -o OUT.mcap | vary IT --list-agents | view IT --save OUT.rrd""",  # noqa: E501
    "run/run.toml": (
        f"evaluate log.mcap --config IT {DRIVE} -o OUT | mine log.mcap --config IT "
        "--workers 0 -o OUT"
    ),
    "suite.toml": f"evaluate --suite IT {DRIVE} -o OUT",
    "gates.toml": f"evaluate log.mcap {DRIVE} --gates IT -o OUT | compare run run --gates IT",
    "space.toml": """
tune many -p idm --space IT --trials 1 --held-out 0.7 --workers 0 -o OUT
diagnose failed --space IT --workers 0 -o OUT""",
    "changes.toml": "diagnose failed --changes IT --workers 0 -o OUT",
    "poses.csv": "score all/everyday/cut_in.mcap --trajectories IT --as navsim-v1",
}
"""Commands that read a file or a folder, separated by bars."""


def one(name: str, rng: random.Random, number: str) -> tuple[object, str]:
    """Edit a file of the inputs, or one in a folder of them, and read it.

    Exit code (or what else came), and a line.
    """
    it = Path(f"edited-{number}-{Path(name).name}")
    (shutil.copy if Path(name).is_file() else shutil.copytree)(name, it)
    change, out = edit(rng, it), f"out-{number}"
    words = rng.choice(
        [each for line in COMMANDS[name].strip().splitlines() for each in line.split(" | ")]
    )
    signal.alarm(LONGEST_S)
    try:
        result = RUNNER.invoke(
            app, [word.replace("IT", str(it)).replace("OUT", out) for word in shlex.split(words)]
        )
    finally:
        signal.alarm(0)
    errors = [line for line in result.stderr.splitlines() if line.startswith("error:")]
    end: object = result.exit_code
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        place = traceback.extract_tb(result.exception.__traceback__)[-1]
        end = f"{result.exception!r} ({Path(place.filename).name}:{place.lineno})"[:300]
    elif "Traceback" in result.output or (end == 2 and not errors):
        end = f"exit code {end}: {result.output[-200:]}"
    for path in Path().glob(f"*-{number}*"):
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    return end, f"{words}: {change}: {end}"


def late(number: int, frame: object) -> None:
    """End a command that takes too long."""
    raise TimeoutError(f"takes more than {LONGEST_S} s")


def main() -> None:
    """Make the inputs, edit and run, print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("--edits", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    signal.signal(signal.SIGALRM, late)
    begun = asked.out.exists()
    asked.out.mkdir(parents=True, exist_ok=True)
    os.chdir(asked.out)
    for name, text in {} if begun else FILES.items():
        Path(name).write_text(text, encoding="utf-8")
    for words in [] if begun else SETUP.strip().splitlines():
        result = RUNNER.invoke(app, shlex.split(words))
        assert result.exit_code in (0, 1, 4), (words, result.output)
    seen, fell, names = {name: Counter[object]() for name in COMMANDS}, 0, list(COMMANDS)
    for k in range(asked.edits):
        name = names[k % len(names)]
        end, said = one(name, random.Random(f"{asked.seed} {k}"), f"{asked.seed}-{k}")
        seen[name][end if end in CODES else "other"] += 1
        if end not in CODES:
            fell += 1
            sys.stdout.write(f"{k}: {said!r}\n")
            sys.stdout.flush()
    for name, count in seen.items():
        sys.stdout.write(
            f"{name:18} " + ", ".join(f"{end}: {count[end]}" for end in (*CODES, "other")) + "\n"
        )
    sys.stdout.write(f"{asked.edits} edits, {fell} fell\n")


if __name__ == "__main__":
    main()
