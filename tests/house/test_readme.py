"""What README, CHANGELOG and constraints say is so: its commands run, its files run, its links lead somewhere."""

from __future__ import annotations

import re
import runpy
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pandas as pd
import pytest
from typer.testing import CliRunner

from replay.batch import OUTCOMES
from replay.cli import app
from replay.config import load_run
from replay.planner_config import planner_keywords

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)


def blocks(language: str) -> list[str]:
    return [text for name, text in BLOCKS if name == language]


def commands(program: str) -> list[list[str]]:
    """The words of every command of a program in the README, in order."""
    lines = [line for block in blocks("sh") for line in block.splitlines()]
    words = [shlex.split(line, comments=True) for line in lines]
    return [line[1:] for line in words if line and line[0] == program]


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files that the README shows."""
    folder = tmp_path_factory.mktemp("desk")
    for block in blocks("python"):
        name = block.partition("\n")[0].removeprefix("# ")
        assert name.endswith(".py")
        (folder / name).write_text(block, encoding="utf-8")
    return folder


@pytest.mark.slow
def test_every_command_runs_in_order(desk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As written; only quicker: without recordings but one, in this process, and without a viewer.

    The bare `replan evaluate` is left to `.ci/run`, which runs it with the installed wheel.
    """
    monkeypatch.chdir(desk)
    monkeypatch.syspath_prepend(str(desk))
    shown: list[list[str]] = []
    done = subprocess.CompletedProcess([], 0)
    monkeypatch.setattr("replay.view.subprocess.run", lambda command, **_: shown.append(command) or done)
    monkeypatch.setenv("DISPLAY", ":0")
    assert len(commands("replan")) >= 8
    for words in commands("replan"):
        if words == ["evaluate"]:
            continue
        extra = ["--workers", "0"] if words[0] == "evaluate" else []
        extra += ["--no-recording"] if extra and "results/free_road" not in words else []
        result = CliRunner().invoke(app, [*words, *extra])
        assert result.exit_code in ((0, 1) if extra else (0,)), f"replan {shlex.join(words)}: {result.output}"
        assert result.exit_code == 0 or "slow_down:SlowDown" in words, result.output
    assert shown
    assert all(Path(file).exists() for file in shown[0][-1:])
    slow = pd.read_csv(desk / "results" / "slow_down" / "metrics.csv").set_index(["planner", "metric"])["value"]
    assert slow["slow_down:SlowDown", "speed.mean"] < slow["dp_qp", "speed.mean"]
    assert "speed_kmh.mean" in set(pd.read_csv(desk / "results" / "speed" / "metrics.csv")["metric"])
    assert sorted(path.name for path in (desk / "results" / "compared").glob("*cut_in*/closed*")) == [
        "closed.dp_qp.mcap", "closed.logged.mcap",
    ]  # fmt: skip


def test_the_python_example_runs(desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture) -> None:
    monkeypatch.chdir(desk)
    CliRunner().invoke(app, ["synth", "everyday/nudge", "-o", "my_logs"])
    runpy.run_path("notebook.py", run_name="__main__")
    said = capsys.readouterr().out
    assert "constant_speed" in said
    assert "everyday/nudge" in said


def test_the_configuration_example_is_one(tmp_path: Path) -> None:
    (text,) = blocks("toml")
    (tmp_path / "run.toml").write_text(text, encoding="utf-8")
    run = load_run(tmp_path / "run.toml")
    assert run.vehicle == {"mass": 1500.0}
    assert planner_keywords("dp_qp", run.planner["dp_qp"])["config"].stitch_m == 0.4


def test_the_set_up_commands_are_known() -> None:
    script = ROOT / "dev"
    asked = {line.split()[1] for block in blocks("sh") for line in block.splitlines() if line.startswith("./dev ")}
    asked |= set(re.findall(r"`\./dev (\w+)`", README))
    assert {"evaluate", "test", "bench"} <= asked
    usage = subprocess.run(["sh", script], capture_output=True, text=True, check=False)
    assert usage.returncode == 2
    assert all(f"./dev {word}" in usage.stdout for word in asked)
    targets = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert asked <= set(re.findall(r"[\w]+", targets.partition("\n\t@./dev")[0].splitlines()[-1]))


def test_the_exit_codes_are_those_of_the_program() -> None:
    told = {int(code) for code in re.findall(r"^\| (\d+) \|", README, re.MULTILINE)}
    assert told == {*OUTCOMES, 130}


def test_the_links_lead_somewhere() -> None:
    links = [link for link in re.findall(r"\]\(([^)]+)\)", README) if "://" not in link]
    assert len(links) > 5
    assert all((ROOT / link).exists() for link in links)


def test_the_house_map_names_all_packages() -> None:
    packages = {path.parent.name for path in ROOT.glob("*/__init__.py")}
    assert packages == {"logs", "metrics", "planners", "replan", "replay"}
    assert all(f"[{name}/]({name})" in README for name in packages)


def test_constraints_are_versions_only_and_cover_what_is_required() -> None:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [line for line in lines if not line.startswith("#")]
    assert all(re.fullmatch(r"[a-z0-9-]+==[A-Za-z0-9.+]+", line) for line in pins)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    required = [*project["dependencies"], *project["optional-dependencies"]["dev"]]
    names = {re.split(r"[\[<>=!~; ]", line)[0].lower().replace("_", "-") for line in required}
    assert names <= {line.partition("==")[0] for line in pins}


def test_the_changelog_names_the_version() -> None:
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert "## [Unreleased]" in changes or f"## [{project['version']}]" in changes


@pytest.mark.skipif(sys.platform == "win32", reason="file modes")
@pytest.mark.parametrize("name", ["dev", ".ci/run"])
def test_scripts_are_executable(name: str) -> None:
    assert (ROOT / name).stat().st_mode & 0o111
