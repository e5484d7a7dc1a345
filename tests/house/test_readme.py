"""What README, CHANGELOG and constraints say is so; `test_docs.py` runs what README and
documentation show.
"""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from sparse import LATER, SPARSE

from replan.cli.app import INTERNAL
from replan.config import load_run
from replan.metrics import METRICS
from replan.replay.parts import PARTS
from replan.replay.planner_process.planner_config import planner_part
from replan.results.tables import OUTCOMES
from replan.run.sources import builtin_suite

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)


def blocks(language: str) -> list[str]:
    return [text for name, text in BLOCKS if name == language]


def test_the_configuration_example_is_one(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "use.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"^```toml\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    (tmp_path / "run.toml").write_text(text, encoding="utf-8")
    run = load_run(tmp_path / "run.toml")
    assert run.vehicle == {"mass": 1500.0}
    assert planner_part("dp_qp", run.planner["dp_qp"]).keywords()["config"].stitch_m == 0.4


def test_the_set_up_commands_are_known() -> None:
    script = ROOT / "dev"
    asked = {
        line.split()[1]
        for block in blocks("sh")
        for line in block.splitlines()
        if line.startswith("./dev ")
    }
    asked |= set(re.findall(r"`\./dev (\w+)`", README))
    assert {"evaluate", "test", "bench", "docs"} <= asked
    usage = subprocess.run(["sh", script], capture_output=True, text=True, check=False)
    assert usage.returncode == 2
    assert all(f"./dev {word}" in usage.stdout for word in asked)
    targets = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert asked <= set(re.findall(r"[\w]+", targets.partition("\n\t@./dev")[0].splitlines()[-1]))


def test_the_exit_codes_are_those_of_the_program() -> None:
    said = (ROOT / "docs" / "use.md").read_text(encoding="utf-8")
    assert {int(code) for code in re.findall(r"^\| (\d+) \|", said, re.MULTILINE)} == {
        *OUTCOMES,
        INTERNAL,
        130,
    }


def test_the_options_that_choose_by_name_have_all_names() -> None:
    page = (ROOT / "docs" / "use.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| `--(\w+)` \|(.*)\|$", page, re.MULTILINE))
    for key, kind in PARTS.items():
        assert {*kind.builtin, *kind.besides} - {""} <= set(re.findall(r"`(\w+)`", rows[key])), key


def test_the_numbers_of_what_is_built_in() -> None:
    assert f"{len(METRICS)} built in" in README
    assert f"{len(builtin_suite().sources)} built-in logs" in README


def test_the_house_map_names_all_packages() -> None:
    packages = {path.parent.name for path in ROOT.glob("*/__init__.py")}
    assert packages == {"logs", "metrics", "planners", "replan", "replay", "studies"}
    assert all(f"[{name}/]({name})" in README for name in packages)


def test_constraints_are_versions_only_and_cover_what_is_required() -> None:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [line for line in lines if not line.startswith("#")]
    assert all(re.fullmatch(r"[a-z0-9-]+==[A-Za-z0-9.+]+", line) for line in pins)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    required = [*project["dependencies"], *extras["dev"], *extras["docs"]]
    names = {re.split(r"[\[<>=!~; ]", line)[0].lower().replace("_", "-") for line in required}
    assert names <= {line.partition("==")[0] for line in pins}


def test_the_changelog_names_the_version() -> None:
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert "## [Unreleased]" in changes or f"## [{project['version']}]" in changes


@pytest.mark.parametrize("name", SPARSE | LATER)
def test_sparse_tests_exist(name: str) -> None:
    file, _, function = name.partition("::")
    assert f"def {function}(" in (ROOT / "tests" / file).read_text(encoding="utf-8")


@pytest.mark.skipif(sys.platform == "win32", reason="file modes")
@pytest.mark.parametrize("name", ["dev", ".ci/run", ".ci/nightly"])
def test_scripts_are_executable(name: str) -> None:
    assert (ROOT / name).stat().st_mode & 0o111
