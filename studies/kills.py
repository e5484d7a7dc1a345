"""Kills every command that writes, at random times, and runs it again: the bytes are those of an
undisturbed run.

    python -m studies.kills OUT --kills 300 --seconds 1800 --seed 0

A round kills a command one to three times (a signal to its process group), resumes it or runs it
again to its end, and compares all files but those that hold a clock, and looks for locks,
unfinished files and processes. After an interruption (`--signal INT` or TERM) it has to end with
130, and none may be left at once; one that ends with its own exit code is counted apart: the signal
came too late, or was ignored. The command with the least time spent has the next round. Of each
command: rounds, kills that met it alive, entries left in TMPDIR (no program can remove them as it
is killed), and what fell.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

MARK = "REPLAN_KILLS"
PRELUDE = (
    "from replan.interruption import end_at_once; end_at_once();import replan.paper.reproduce as "
    "r; from functools import partial; from replan.cli import main;"
    # The paper with two pedestrians
    "r.PaperConfig = partial(r.PaperConfig, cells=r.CELLS[:2]); main()"
)
SOLVED = (
    "from replan.logs.catalogue import scenario as s; from replan.logs.mcap import write_scenario; "
    "from dataclasses import replace;from replan.logs.vehicle import vehicle_parameters as v; "
    "facts = {'benchmark': 'ZAM_Made-1_1_T-1', 'time_step_s': '0.1','planning_problem': '100', "
    "'ego_pose': 'box centre'};write_scenario('cr.mcap', replace(s('everyday/cut_in'), "
    "metadata=facts).in_vehicle(v('bmw_320i')))"
)
DRIVE = "-p constant_speed --no-recording"
SETUP = f"""
synth paper everyday -o all
convert all/paper all/everyday --to 2 -o many
convert all/paper/crossing_pedestrian.mcap all/everyday/cut_in.mcap --to 3 -o logs
evaluate logs {DRIVE} -o run
evaluate logs/cut_in.mcap -p parked --mode closed --no-recording -o failed
evaluate logs {DRIVE} --shard 1/2 -o shard-1
evaluate logs {DRIVE} --shard 2/2 -o shard-2
evaluate cr.mcap {DRIVE} --mode closed --vehicle kinematic_bicycle --car bmw_320i -o solved
mine all/everyday -o mined
"""
COMMANDS = """
evaluate logs -p constant_speed -p idm --workers 2 --no-recording -o out --resume
merge shard-1 shard-2 -o out
mine all/everyday --workers 2 -o out --resume
cut mined --where true --before 0.5 --after 0.5 -o out --resume
vary logs/cut_in.mcap -p constant_speed --workers 0 --vary ego_speed=0.9:1.1:3 -o out --resume
falsify logs/crossing_pedestrian.mcap -p idm --workers 0 --axis ego_speed=0.9:1.1 --budget 16 -o out --resume
tune many -p idm --space space.toml --trials 2 --held-out 0.7 --workers 0 -o out --resume
diagnose failed --workers 0 -o out --resume
report run -o out
query mined 'SELECT * FROM range(300000)' -o out.csv
suite mined -o out.toml
coverage mined --against mined -o out
score run --as nuplan-cls -o out.csv
baseline run -o out.parquet
repair logs/cut_in.mcap -o out.mcap --table out.csv
convert all/everyday -o out
salvage cut_off.mcap out.mcap
synth paper -o out
synth raw --as ros2 -o out
export commonroad-solution solved -o out
plot run -o out
frame run --at 1 --dump out.msgpack
view logs/cut_in.mcap --save out.rrd
calibrate -o out
paper --roads 0 --workers 2 -o out
"""  # noqa: E501
CLOCKS = ("timings.parquet", "summary.json", ".rrd", "report.html", "report.md", ".msgpack")
Done = tuple[int, dict[str, bytes], str]
"""Exit code, files, errors."""


def begun(place: Path, words: str, code: str = PRELUDE) -> subprocess.Popen[str]:
    """A command in a session of its own, with a mark in its environment by which its processes are
    found.
    """
    env, to = {**os.environ, MARK: str(place), "TMPDIR": str(place / "tmp")}, subprocess.PIPE
    command = [sys.executable, "-c", code, *shlex.split(words)]
    return subprocess.Popen(
        command, cwd=place, env=env, text=True, start_new_session=True, stdout=to, stderr=to
    )


def fresh(words: str) -> str:
    """A command that begins anew."""
    return words.removesuffix(" --resume")


def finished(place: Path, words: str, code: str = PRELUDE) -> Done:
    """What comes of a command.

    One of which nothing was begun cannot be resumed, and is started anew.
    """
    run = begun(place, words, code)
    errors = run.communicate(timeout=600)[1]
    if run.returncode == 2 and "no study to resume" in errors:
        return finished(place, fresh(words))
    files = [
        file for out in place.glob("*out*") for file in (out, *out.rglob("*")) if file.is_file()
    ]
    held = {
        str(file.relative_to(place)): b"" if file.name.endswith(CLOCKS) else file.read_bytes()
        for file in files
    }
    return run.returncode, held, errors


def alive(place: Path) -> list[str]:
    """The processes that come of a command, wherever they belong now, after 10 s."""
    until, mark = time.monotonic() + 10.0, f"{MARK}={place}".encode()
    while True:
        found = []
        for environ in Path("/proc").glob("[0-9]*/environ"):
            try:
                if mark in environ.read_bytes().split(b"\0"):
                    found.append((environ.parent / "cmdline").read_text().replace("\0", " ")[-200:])
            except OSError:  # it has ended
                continue
        if not found or time.monotonic() > until:
            return found
        time.sleep(0.1)


def cleared(place: Path) -> int:
    """Remove all output; the number of entries in TMPDIR."""
    for out in (*place.glob("*out*"), *place.glob(".*")):
        shutil.rmtree(out) if out.is_dir() else out.unlink()
    left = len(list((place / "tmp").iterdir()))
    shutil.rmtree(place / "tmp")
    (place / "tmp").mkdir()
    return left


def left(place: Path) -> list[str]:
    """Locks and unfinished files."""
    return [
        f"left: {path.relative_to(place)}" for path in place.rglob("*") if path.name.startswith(".")
    ]


def one_round(
    place: Path,
    words: str,
    rng: random.Random,
    number: signal.Signals,
    whole: Done,
    whole_s: float,
    seen: Counter[str],
) -> None:
    """Kill a command one to three times, run it to its end, and compare; counts `seen`."""
    for _ in range(rng.randint(1, 3)):
        run = begun(place, words if (place / "out").exists() else fresh(words))
        try:
            run.communicate(timeout=rng.uniform(0.3, whole_s))
        except subprocess.TimeoutExpired:
            os.killpg(run.pid, number)
            said = run.communicate()[1]
            seen["kills"] += 1
            if number != signal.SIGKILL and run.returncode != 130:
                late = run.returncode == whole[0]
                seen[
                    "ended by itself"
                    if late
                    else f"interrupted: exit code {run.returncode}: {said[-300:]}"
                ] += 1
            seen.update(left(place) if number != signal.SIGKILL else ())
        seen.update(f"orphan: {one}" for one in alive(place))
    code, files, errors = finished(place, words)
    names = [
        name
        for name in sorted(files.keys() | whole[1].keys())
        if files.get(name) != whole[1].get(name)
    ]
    if code != whole[0] or names:
        seen[f"exit code {code} for {whole[0]}, other bytes: {names[:4]} {errors[-300:]}"] += 1
    seen.update(left(place))
    seen["in TMPDIR"] += cleared(place)
    seen["rounds"] += 1


def make_inputs(place: Path) -> None:
    """Make what the commands read; AssertionError if a command fails."""
    (place / "tmp").mkdir(parents=True)
    (place / "space.toml").write_text(
        "[planner.idm]\ntime_gap_s = { low = 1.0, high = 2.0 }\n", encoding="utf-8"
    )
    assert finished(place, "", SOLVED)[0] == 0
    for words in SETUP.strip().splitlines():
        code, _, errors = finished(place, words)
        assert code in (0, 1, 4), (words, errors)
    (place / "cut_off.mcap").write_bytes((place / "logs" / "cut_in.mcap").read_bytes()[:-100])


def main() -> None:
    """Make the inputs, then kill until the count or the time is reached."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("out", type=Path)
    parser.add_argument("--kills", type=int, default=300)
    parser.add_argument("--seconds", type=float, default=1800.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--signal", choices=["KILL", "INT", "TERM"], default="KILL")
    parser.add_argument(
        "--only", nargs="*", default=["."], help="Patterns, of which a command has one."
    )
    asked = parser.parse_args()
    # A shell ignores them for what it starts in the background
    for one in (signal.SIGINT, signal.SIGTERM):
        signal.signal(one, signal.default_int_handler)
    place, rng = asked.out.resolve(), random.Random(asked.seed)
    if not (place / "cut_off.mcap").exists():
        make_inputs(place)
    cleared(place)
    commands = [
        words
        for words in COMMANDS.strip().splitlines()
        if any(re.search(one, words) for one in asked.only)
    ]
    until = time.monotonic() + asked.seconds
    spent, whole, seen = (
        dict.fromkeys(commands, 0.0),
        dict[str, tuple[Done, float]](),
        dict[str, Counter[str]](),
    )
    while sum(count["kills"] for count in seen.values()) < asked.kills and time.monotonic() < until:
        words, begin = min(commands, key=spent.__getitem__), time.monotonic()
        if words not in whole:
            first = finished(place, fresh(words))  # it compiles kernels
            cleared(place)
            again = time.monotonic()
            whole[words], seen[words] = (
                (finished(place, fresh(words)), time.monotonic() - again),
                Counter(),
            )
            assert whole[words][0][0] in (0, 1, 4) and first[:2] == whole[words][0][:2], (
                words,
                first[2],
            )
            cleared(place)
        else:
            one_round(
                place, words, rng, signal.Signals[f"SIG{asked.signal}"], *whole[words], seen[words]
            )
        spent[words] += time.monotonic() - begin
        sys.stdout.write(f"{words.split(' -')[0]} ({spent[words]:.0f} s): {dict(seen[words])}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
