"""One top-level package: a user's `planners/`, `metrics.py`, `logs/` and `replay.py` are theirs,
from a clone and a wheel.
"""

import json
import os
import shutil
import subprocess
import sys
import tomllib
import venv
from pathlib import Path
from zipfile import ZipFile

import pytest
from command_line import replan
from short_logs import short

from replan.logs.mcap import write_scenario

ROOT = Path(__file__).parents[2]
TOOLS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]
SETUPTOOLS = TOOLS["setuptools"]
OURS = ("logs", "metrics", "planners", "replay")
MINE = """
import numpy as np
from metrics import WEIGHT
from utils.geometry import half

from planners.slower import limit
from replan import Frame, Plan, Trajectory
import replay

assert replay.NAME == "theirs"


class Mine:
    def __init__(self, context):
        self._share = limit(half(2.0) * WEIGHT)

    def plan(self, frame: Frame) -> Plan:
        ego, t = frame.ego, frame.t + 0.5 * np.arange(9)
        v = self._share * ego.v
        s = v * (t - frame.t)
        x, y = ego.x + s * np.cos(ego.yaw), ego.y + s * np.sin(ego.yaw)
        still = np.zeros(9)
        path = Trajectory(t, x, y, still + ego.yaw, still + v, still, still)
        return Plan(path)
"""
FILES = {
    "planners/__init__.py": "",
    "planners/slower.py": "def limit(v):\n    return max(v, 0.0)\n",
    "planners/mine.py": MINE,
    "metrics.py": "WEIGHT = 1.0\n",
    "replay.py": "NAME = 'theirs'\n",
    "utils/geometry.py": "def half(x):\n    return x / 2.0\n",
    "test_mine.py": (
        "from planners.mine import Mine\nimport replan\n\n\n"
        "def test_contract():\n    replan.check_planner('planners.mine:Mine')\n    assert "
        "callable(Mine)\n"
    ),
}
DRIVE = """
if __name__ == "__main__":
    result = replan.evaluate("logs/a.mcap", planners=["planners.mine:Mine"], out={out!r}, recording=False, workers={workers})
    assert result.failures.empty, result.failures
    print(sorted(set(result.drives["planner"])))
"""  # noqa: E501


@pytest.fixture(scope="module")
def repository(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A team's repository with a package, two modules, a namespace package and a data folder of our
    former names.
    """
    folder = tmp_path_factory.mktemp("team")
    for name, text in FILES.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "logs").mkdir()
    for name in "ab":
        write_scenario(folder / "logs" / f"{name}.mcap", short(f"team/{name}", v=8.0))
    return folder


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of this tree, built from a copy: a build writes into its tree, and other tests may
    build, too.
    """
    folder, tree = tmp_path_factory.mktemp("wheel"), tmp_path_factory.mktemp("tree")
    for name in files_of_tree():
        (tree / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / name, tree / name)
    pip = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--quiet",
        "--disable-pip-version-check",
        "--no-deps",
    ]
    subprocess.run([*pip, "--wheel-dir", str(folder), str(tree)], check=True, cwd=folder)
    (made,) = folder.glob("*.whl")
    return made


@pytest.fixture(scope="session")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The Python of an environment with the wheel, beside what replan depends on."""
    folder = tmp_path_factory.mktemp("installed")
    venv.create(folder, with_pip=False, symlinks=True)
    python = folder / "bin" / "python"
    site = Path(
        subprocess.run(
            [python, "-c", SITE], check=True, capture_output=True, text=True
        ).stdout.strip()
    )
    (site / "beside.pth").write_text("\n".join(dependencies()) + "\n", encoding="utf-8")
    pip_install(site, wheel)
    return python


SITE = "import sysconfig; print(sysconfig.get_path('purelib'))"


def files_of_tree() -> list[str]:
    """The files of this checkout that git does not ignore."""
    git = ["git", "ls-files", "-co", "--exclude-standard"]
    listed = subprocess.run(
        git, cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    return [name for name in listed if (ROOT / name).is_file()]


def dependencies() -> list[str]:
    """The folders with the packages of this environment.

    Their .pth files (of the editable install) are not read.
    """
    return [entry for entry in sys.path if entry.endswith(("site-packages", "dist-packages"))]


def pip_install(site: Path, *what: Path) -> None:
    pip = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
        "--no-deps",
        "--no-index",
    ]
    subprocess.run([*pip, "--target", str(site), *map(str, what)], check=True)


PYTHONS = ("clone", pytest.param("wheel", marks=pytest.mark.nightly))
"""By day, `.ci/run` drives a planner of a folder `planners/` with a wheel that has its kernels."""


@pytest.fixture(params=PYTHONS)
def python(request: pytest.FixtureRequest) -> Path:
    """The Python of an editable install of the clone, and that of an environment with the wheel."""
    return (
        Path(sys.executable) if request.param == "clone" else request.getfixturevalue("installed")
    )


def run(repository: Path, *words: object, code: int = 0) -> str:
    """What a command prints in the repository, where nothing but the installation leads to
    replan.
    """
    environment = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("PYTHON", "PYTEST"))
    }
    done = subprocess.run(
        [*map(str, words)],
        cwd=repository,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == code, f"{done.stdout}\n{done.stderr}"
    return done.stdout + done.stderr


def test_the_packages_are_the_folders() -> None:
    """No module is left out of the wheel, and none of another top-level name is in it."""
    folders = SETUPTOOLS["package-dir"]
    listed = set(SETUPTOOLS["packages"])
    there = set()
    for package, folder in folders.items():
        for file in (ROOT / folder).rglob("*.py"):
            inside = file.parent.relative_to(ROOT / folder)
            there.add(".".join([package, *inside.parts]))
    assert listed == there
    assert {name.partition(".")[0] for name in listed} == {"replan"}


@pytest.mark.slow
def test_the_wheel_has_one_top_level_package_and_all_files_of_the_tree(wheel: Path) -> None:
    names = ZipFile(wheel).namelist()
    (info,) = {name.partition("/")[0] for name in names if ".dist-info/" in name}
    assert {name.partition("/")[0] for name in names} == {"replan", info}
    for name in files_of_tree():
        inside = name if name.startswith("replan/") else f"replan/{name}"
        if name.partition("/")[0] in (*OURS, "replan"):
            assert inside in names, name


@pytest.mark.parametrize(
    "order", ["import planners.mine, replan", "import replan, planners.mine, metrics, replay"]
)
def test_a_script_imports_its_own_and_ours_in_any_order(
    python: Path, repository: Path, order: str
) -> None:
    script = (
        f"{order}\nimport metrics, replay, logs\nprint(metrics.__file__, replay.__file__, "
        "*logs.__path__)"
    )
    (repository / "script.py").write_text(script, encoding="utf-8")
    shown = run(repository, python, "script.py").split()
    assert shown == [str(repository / name) for name in ("metrics.py", "replay.py", "logs")]


def test_the_command_line_drives_the_planner_of_a_folder_planners(
    python: Path, repository: Path, tmp_path: Path
) -> None:
    words = (
        "evaluate",
        "logs",
        "-p",
        "planners.mine:Mine",
        "--no-recording",
        "--gates",
        "safety",
        "--quiet",
    )
    command = (python, "-P", "-c", "from replan.cli import main; main()", *words)
    run(repository, *command, "--out", tmp_path / "own", "--workers", 0)
    run(repository, *command, "--out", tmp_path / "two", "--workers", 2)
    run(
        repository,
        *command,
        "--out",
        tmp_path / "here",
        "--workers",
        0,
        "--set",
        "loop.apart.trust=true",
    )
    tables = {(tmp_path / name / "verdicts.parquet").read_bytes() for name in ("own", "two")}
    assert len(tables) == 1


@pytest.mark.slow
def test_a_script_a_module_and_pytest_use_it(
    python: Path, repository: Path, tmp_path: Path
) -> None:
    for name, first, workers in (
        ("before", "import planners.mine, replan", 0),
        ("after", "import replan", 2),
    ):
        script = first + DRIVE.format(out=str(tmp_path / name), workers=workers)
        (repository / f"{name}.py").write_text(script, encoding="utf-8")
        assert run(repository, python, f"{name}.py").strip().endswith("['planners.mine:Mine']")
    words = (
        "evaluate",
        "logs/a.mcap",
        "-p",
        "planners.mine:Mine",
        "--no-recording",
        "--quiet",
        "--workers",
        0,
    )
    run(
        repository,
        python,
        "-m",
        "replan",
        *words,
        "--gates",
        "safety",
        "--out",
        tmp_path / "module",
    )
    assert "1 passed" in run(
        repository, python, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_mine.py"
    )


@pytest.mark.parametrize("theirs", [None, "their_folder"])
def test_a_program_gets_the_python_path_of_the_user_and_none_of_ours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, theirs: str | None
) -> None:
    """Its Python may be another one, for which our packages are wrong."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    if theirs is not None:
        monkeypatch.setenv("PYTHONPATH", theirs)
    Path("a.py").write_text(
        "import os; print(os.environ.get('PYTHONPATH'), file=open('path.txt', 'w'))",
        encoding="utf-8",
    )
    write_scenario(tmp_path / "a.mcap", short("team/a"))
    words = ("evaluate", "a.mcap", "-p", f"exec:{sys.executable} a.py", "--workers", 0)
    assert replan(*words, "--mode", "open", "--out", "out").exit_code == 3
    assert Path("path.txt").read_text(encoding="utf-8").strip() == str(theirs)


def test_the_folders_of_a_clone_are_never_a_second_copy(repository: Path) -> None:
    """In the clone's root `import logs` is one line that names the package.

    In a user's folder it is theirs.
    """
    for name in OURS:
        shown = run(ROOT, sys.executable, "-c", f"import {name}", code=1).strip().splitlines()[-1]
        assert shown.startswith(
            f"ModuleNotFoundError: No module named '{name}': it is 'replan.{name}' now;"
        )
    assert "." not in TOOLS["pytest"]["ini_options"]["pythonpath"]
    same = (
        "import replan; from replan.logs.plan import Plan; assert Plan is replan.Plan; import "
        "logs; print(*logs.__path__)"
    )
    assert run(repository, sys.executable, "-c", same).split() == [str(repository / "logs")]


@pytest.mark.parametrize(
    "line", ["from logs.frame import Frame", "import planners.base", "from metrics import evaluate"]
)
def test_an_import_of_an_older_script_names_the_present_one(tmp_path: Path, line: str) -> None:
    module = line.split()[1]
    script = f"import replan\n{line}\n"
    shown = run(tmp_path, sys.executable, "-c", script, code=1).strip().splitlines()[-1]
    package = module.partition(".")[0]
    assert shown.startswith(
        f"ModuleNotFoundError: No module named '{package}': it is 'replan.{package}' now; import"
    )
    (tmp_path / "old.py").write_text(f"{line}\n", encoding="utf-8")
    write_scenario(tmp_path / "a.mcap", short("team/a"))
    words = ("evaluate", "a.mcap", "-p", "old:Mine", "--workers", 0, "--out", "out")
    error = run(tmp_path, sys.executable, "-P", "-m", "replan", *words, code=3)
    assert f"it is 'replan.{package}' now" in " ".join(error.split())


def test_a_built_in_part_that_a_file_names_as_before_is_found(tmp_path: Path) -> None:
    (tmp_path / "run.toml").write_text(
        'planners = ["planners.constant_speed:ConstantSpeed"]\n', encoding="utf-8"
    )
    write_scenario(tmp_path / "a.mcap", short("team/a"))
    words = (
        "evaluate",
        "a.mcap",
        "--config",
        "run.toml",
        "--workers",
        0,
        "--out",
        "out",
        "--no-recording",
    )
    run(tmp_path, sys.executable, "-P", "-m", "replan", *words, "--gates", "safety")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))
    assert not summary["failures"]


@pytest.mark.slow
def test_replan_and_a_distribution_with_common_package_names_leave_each_other_alone(
    wheel: Path, tmp_path: Path
) -> None:
    """Theirs and ours work in one environment, and uninstalling ours leaves theirs."""
    team = tmp_path / "team"
    for name in ("planners", "metrics"):
        (team / name).mkdir(parents=True)
        (team / name / "__init__.py").write_text(f"NAME = 'team {name}'\n", encoding="utf-8")
    project = (
        '[project]\nname = "team"\nversion = "1.0"\n[tool.setuptools]\npackages = '
        '["planners", "metrics"]\n'
    )
    (team / "pyproject.toml").write_text(project, encoding="utf-8")
    venv.create(tmp_path / "venv", with_pip=True, symlinks=True)
    python = tmp_path / "venv" / "bin" / "python"
    pip = (python, "-m", "pip", "--quiet", "--disable-pip-version-check")
    subprocess.run(
        [
            sys.executable,
            "-m",
            "pip",
            "wheel",
            "--quiet",
            "--no-deps",
            "--wheel-dir",
            str(tmp_path),
            str(team),
        ],
        check=True,
    )
    run(tmp_path, *pip, "install", "--no-index", "--no-deps", *tmp_path.glob("*.whl"), wheel)
    site = Path(run(tmp_path, python, "-c", SITE).strip())
    (site / "beside.pth").write_text("\n".join(dependencies()) + "\n", encoding="utf-8")
    both = (
        "import planners, metrics, replan.planners.idm, replan.metrics; print(planners.NAME, "
        "metrics.NAME)"
    )
    assert run(tmp_path, python, "-c", both).strip() == "team planners team metrics"
    run(tmp_path, *pip, "uninstall", "--yes", "replan")
    assert not (site / "replan").exists()
    assert (
        run(tmp_path, python, "-c", "import planners, metrics; print(metrics.NAME)").strip()
        == "team metrics"
    )
