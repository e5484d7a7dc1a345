"""The files for CI systems: what their jobs run is run here, in their order, with two small logs
and a fake runner.
"""

import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml
from short_logs import short

from replan.logs.mcap import write_scenario
from replan.results.tables import OUTCOMES

ROOT = Path(__file__).parents[2]
GITHUB, GITLAB, OWN = (
    yaml.safe_load((ROOT / file).read_text(encoding="utf-8"))
    for file in ("ci/github/action.yml", "ci/gitlab/replan.yml", ".github/workflows/ci.yml")
)
OPTIONS = "--mode closed --planner constant_speed --no-recording --workers 0"
PYTHON = f"""#!/bin/sh
# Of a runner: what makes environments and installs is written down, everything else is the Python of the tests.
case "$*" in
    "-m venv "*) mkdir -p "$3/bin" && cp "$0" "$3/bin/python" && cp "$0" "$3/bin/python3" ;;
    "-m pip "*) for word in "$@"; do echo "$word"; done >> "$INSTALLED" ;;
    *) exec {shlex.quote(sys.executable)} "$@" ;;
esac
"""  # noqa: E501


@pytest.fixture
def runner(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with two logs and gates that one of them fails, and a Python that installs
    nothing.
    """
    (tmp_path / "my logs").mkdir()
    write_scenario(tmp_path / "my logs" / "a.mcap", short("test/a", v=10.0))
    write_scenario(tmp_path / "my logs" / "b.mcap", short("test/b", v=8.0))
    (tmp_path / "gates.toml").write_text(
        '[[gate]]\nmetric = "speed.mean"\nmin = 9.0\n', encoding="utf-8"
    )
    (tmp_path / "bin").mkdir()
    for name in ("python", "python3"):
        (tmp_path / "bin" / name).write_text(PYTHON, encoding="utf-8")
        (tmp_path / "bin" / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("INSTALLED", str(tmp_path / "installed"))
    return tmp_path


def bash(script: str, where: Path, env: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
    """As GitHub runs a step with `shell: bash`."""
    command = ["bash", "--noprofile", "--norc", "-e", "-o", "pipefail", "-c", script]
    return subprocess.run(
        command, cwd=where, env={**os.environ, **env}, capture_output=True, text=True, check=False
    )


class Workflow:
    """Runs the steps of the action as GitHub does: expressions, conditions, outputs,
    environment.
    """

    def __init__(self, folder: Path, cached: str = "", **inputs: str) -> None:
        given = {name.replace("_", "-"): value for name, value in inputs.items()}
        assert given.keys() <= GITHUB["inputs"].keys()
        self.inputs = {
            name: str(what["default"]) for name, what in GITHUB["inputs"].items()
        } | given
        self.outputs = {"python": {"python-version": "3.11.9"}, "cache": {"cache-hit": cached}}
        self.folder, self.used, self.said = folder, [], ""
        self.failed = any(not self._run(step) for step in GITHUB["runs"]["steps"])

    def _run(self, step: Mapping[str, Any]) -> bool:
        if not eval(self._python(step.get("if", "True"))):
            return True
        if "uses" in step:
            self.used.append(
                (step["uses"], {key: self._filled(value) for key, value in step["with"].items()})
            )
            return True
        assert step["shell"] == "bash"
        written = self.folder / "outputs"
        written.write_text("", encoding="utf-8")
        env = {key: self._filled(value) for key, value in step.get("env", {}).items()}
        # Within what is cached; the tests have their kernels elsewhere
        if "NUMBA_CACHE_DIR" in env:
            assert Path(env.pop("NUMBA_CACHE_DIR")).is_relative_to(self.outputs["key"]["env"])
        result = bash(self._filled(step["run"]), self.folder, {**self._environment(written), **env})
        self.said += result.stdout + result.stderr
        lines = written.read_text(encoding="utf-8").splitlines()
        self.outputs[step["id"]] = dict(line.split("=", 1) for line in lines)
        return result.returncode == 0

    def _environment(self, written: Path) -> dict[str, str]:
        places = {
            "GITHUB_OUTPUT": written,
            "GITHUB_STEP_SUMMARY": self.folder / "summary.md",
            "GITHUB_ACTION_PATH": ROOT / "ci" / "github",
            "RUNNER_TOOL_CACHE": self.folder / "tools",
        }
        return {name: str(path) for name, path in places.items()} | {
            "RUNNER_OS": "Linux",
            "RUNNER_ARCH": "X64",
        }

    def _value(self, name: str) -> str:
        kind, key, *rest = name.split(".")
        if kind == "inputs":
            return self.inputs[key]
        assert kind == "steps", name
        assert rest[0] == "outputs", name
        return self.outputs.get(key, {}).get(rest[1], "")

    def _filled(self, text: object) -> str:
        return re.sub(r"\$\{\{ ([\w.-]+) \}\}", lambda found: self._value(found[1]), str(text))

    def _python(self, condition: str) -> str:
        words = re.sub(
            r"(inputs|steps)\.[\w.-]+", lambda found: repr(self._value(found[0])), condition
        )
        return words.replace("always()", "True").replace("&&", "and")


@pytest.mark.slow
def test_the_github_action_runs_keeps_and_judges(runner: Path) -> None:
    run = Workflow(
        runner, logs="my logs/a.mcap\nmy logs/b*.mcap\n", gates="gates.toml", args=OPTIONS
    )
    assert run.outputs["run"] == {"exit-code": "1", "outcome": "fail"}, run.said
    assert run.failed
    summary = json.loads((runner / "replan-results" / "summary.json").read_text(encoding="utf-8"))
    assert [log["log"] for log in summary["logs"]] == ["test/a", "test/b"]
    assert "speed.mean" in (runner / "summary.md").read_text(encoding="utf-8")
    for file in ("report.md", "junit.xml"):
        assert (runner / "replan-results" / file).is_file()
    installed = (runner / "installed").read_text(encoding="utf-8").splitlines()
    assert installed[-1] == str(ROOT)
    assert str(ROOT / "constraints.txt") in installed
    used = dict(run.used)
    env = str(runner / "tools" / "replan")
    assert [name.partition("@")[0] for name, _ in run.used] == [
        "actions/setup-python",
        "actions/cache/restore",
        "actions/cache/save",
        "actions/upload-artifact",
    ]
    assert used["actions/cache/save@v4"] == used["actions/cache/restore@v4"] | {"path": env}
    assert re.fullmatch(
        r"replan-Linux-X64-3\.11\.9-[0-9a-f]{16}", used["actions/cache/save@v4"]["key"]
    )
    assert used["actions/upload-artifact@v4"]["path"] == "replan-results"


def gitlab_jobs() -> Iterator[tuple[str, dict[str, Any]]]:
    """Each job as often as it is run, with what it inherits, and its variables."""
    for name, job in GITLAB.items():
        if name == "variables" or name.startswith("."):
            continue
        base = GITLAB[job["extends"]]
        for index in range(1, min(job.get("parallel", 1), 2) + 1):
            node = {"CI_NODE_INDEX": str(index), "CI_NODE_TOTAL": "2"} if "parallel" in job else {}
            yield (
                name,
                {**base, **job, "variables": {**GITLAB["variables"], **base["variables"], **node}},
            )


@pytest.mark.slow
def test_the_gitlab_jobs_drive_shards_and_the_merge_judges_and_so_does_githubs(
    runner: Path,
) -> None:
    (runner / "my logs").rename(runner / "my_logs")
    given = {
        "REPLAN_LOGS": "my_logs",
        "REPLAN_ARGS": f"--gates gates.toml {OPTIONS}",
        "CI_PROJECT_DIR": str(runner),
    }
    codes = []
    for name, job in gitlab_jobs():
        variables = {**job["variables"], **given}
        assert variables.pop("NUMBA_CACHE_DIR") == "$CI_PROJECT_DIR/.replan/kernels"
        result = bash("\n".join([*job["before_script"], *job["script"]]), runner, variables)
        codes.append((name, result.returncode))
        for report in job["artifacts"].get("reports", {}).values():
            assert "<failure" in (runner / report).read_text(encoding="utf-8"), result.stderr
        assert all(list(runner.glob(path)) for path in job["artifacts"]["paths"]), result.stderr
    assert codes == [("replan", 0), ("replan", 0), ("replan-merge", 1)], (
        result.stdout + result.stderr
    )
    run = Workflow(runner, merge="replan-shards/*", out="merged", baseline="replan-results")
    assert run.outputs["run"] == {"exit-code": "1", "outcome": "fail"}, run.said
    for file in ("metrics.parquet", "verdicts.parquet", "summary.json"):
        assert (runner / "merged" / file).read_bytes() == (
            runner / "replan-results" / file
        ).read_bytes()

    # A rule of the comparison
    assert "flip" in (runner / "merged" / "junit.xml").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_github_action_drives_a_shard_and_keeps_the_exit_code(runner: Path) -> None:
    run = Workflow(
        runner, logs="my logs", gates="gates.toml", args=f"{OPTIONS} --quiet", shard="2/2"
    )
    assert run.outputs["run"] == {"exit-code": "0", "outcome": "not judged"}, run.said
    assert not run.failed
    assert (runner / "replan-results" / "shard.json").is_file()
    script = next(step["run"] for step in GITHUB["runs"]["steps"] if step.get("id") == "run")
    said = {
        int(code): word.strip('"')
        for code, word in re.findall(r'^ *(\d)\) outcome=(\w+|"[^"]*")', script, re.M)
    }
    assert said == OUTCOMES


def test_the_own_workflow_runs_what_there_is() -> None:
    steps = [step for job in OWN["jobs"].values() for step in job["steps"]]
    assert {"run": ".ci/run"} in steps and {"run": ".ci/nightly"} in steps
    used = next(step for step in steps if step.get("uses") == "./ci/github")
    assert used["with"].keys() <= GITHUB["inputs"].keys()
    matrix = OWN["jobs"]["elsewhere"]["strategy"]["matrix"]
    assert set(matrix["python-version"]) == {"3.11", "3.12", "3.13", "3.14"}
