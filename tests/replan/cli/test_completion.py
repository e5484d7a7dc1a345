"""Completion in a shell, and a command line that starts at once."""

import os
import subprocess
import sys

from replan.cli.listing import KINDS, entries
from replan.cli.options import complete_setting, names


def python(*words: str, **env: str) -> subprocess.CompletedProcess[str]:
    places = {**os.environ, **env}
    return subprocess.run(
        [sys.executable, *words], env=places, capture_output=True, text=True, check=False
    )


def test_the_command_line_is_there_at_once() -> None:
    heavy = "numba numpy scipy pandas pyarrow rerun"
    code = (
        f"import sys, replan.cli, replan; print(*sorted(set('{heavy}'.split()) & set(sys.modules)))"
    )
    result = python("-c", code)
    assert (result.stdout.strip(), result.stderr) == ("", "")


def test_completion_knows_the_tables_without_importing_them() -> None:
    options = {
        "planner": "planners",
        "controller": "controllers",
        "vehicle": "vehicles",
        "traffic": "traffic",
        "prediction": "predictions",
        "perception": "perceptions",
        "suite": "suites",
        "car": "cars",
    }
    for option, kind in options.items():
        assert sorted(names(option)) == sorted(entry.name for entry in entries(kind)), option
    assert list(names("kind")) == list(KINDS)


def test_a_shell_is_given_names() -> None:
    words = {
        "_REPLAN_COMPLETE": "complete_bash",
        "COMP_WORDS": "replan evaluate --controller p",
        "COMP_CWORD": "3",
    }
    result = python("-m", "replan", **words)
    assert result.stdout.split() == ["pure_pursuit", "pid"]
    assert "loop.plan_period_s=" in complete_setting("loop.pl")
    assert complete_setting("controller.p") == ["controller.pure_pursuit.", "controller.pid."]
    # Else the shell above this process counts
    named = {"_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    assert "replan" in python("-m", "replan", "--show-completion", "bash", **named).stdout
