"""`import replan` gives replan's packages, whatever lies beside a user's script; what clashes names both files."""

import subprocess
import sys
import time
from pathlib import Path

import pytest

import replan
from replan.own import PACKAGES
from replan.page import SECTIONS, markdown

ROOT = Path(__file__).parents[2]
EDITABLE = f"""
import sys
from importlib.machinery import PathFinder
class Editable:  # as an editable install finds packages: after the Python path
    @staticmethod
    def find_spec(name, path=None, target=None):
        return PathFinder.find_spec(name, [{str(ROOT)!r}]) if name in {(*PACKAGES, "replan")!r} else None
sys.meta_path.insert(sys.meta_path.index(PathFinder) + 1, Editable)
"""
INSTALLED = f"import sys\nsys.path.append({str(ROOT)!r})\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A user's folder, with names of ours in it."""
    (tmp_path / "metrics.py").write_text("MINE = 7\n", encoding="utf-8")
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "drive.csv").touch()
    return tmp_path


def run(folder: Path, script: str, *, begin: str = EDITABLE) -> subprocess.CompletedProcess[str]:
    (folder / "script.py").write_text(begin + script, encoding="utf-8")
    words = [sys.executable, "script.py"]
    return subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False, env={"PATH": ""})


@pytest.mark.parametrize(
    "begin", [EDITABLE, pytest.param(INSTALLED, marks=pytest.mark.slow)], ids=["editable", "installed"]
)
@pytest.mark.parametrize(
    "first",
    [
        "import replan\nfrom logs import Plan",
        pytest.param("from replay.results.version import replan_version", marks=pytest.mark.slow),
    ],
)
def test_ours_are_found_beside_a_users_files_of_the_same_names(folder: Path, begin: str, first: str) -> None:
    done = run(
        folder, f"{first}\nimport logs.errors, metrics.metric\nprint(logs.__file__, metrics.__file__)", begin=begin
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [str(ROOT / name / "__init__.py") for name in ("logs", "metrics")]


@pytest.mark.parametrize(
    "script",
    [
        "import replan\nfrom metrics import MINE",
        pytest.param("import metrics\nimport replan", marks=pytest.mark.slow),
        pytest.param("import replan\nreplan.read_log\nimport metrics\nmetrics.MINE", marks=pytest.mark.slow),
    ],
    ids=["theirs after ours", "ours after theirs", "as an attribute"],
)
def test_where_a_clash_remains_one_message_names_both_files_and_the_way_out(folder: Path, script: str) -> None:
    last = run(folder, script).stderr.strip().splitlines()[-1]
    assert last.startswith("ImportError: ") and "rename yours" in last
    assert str(ROOT / "metrics" / "__init__.py") in last and str(folder / "metrics.py") in last


def test_every_public_name_is_there_and_on_the_page() -> None:
    on_the_page = [name for names in SECTIONS.values() for name in names.split()]
    assert sorted(on_the_page) == sorted(replan.__all__)
    assert all(getattr(replan, name).__doc__ for name in replan.__all__)
    assert set(replan.__all__) <= set(dir(replan))
    with pytest.raises(AttributeError, match="no attribute 'evaluat'"):
        replan.evaluat  # noqa: B018


def test_the_page_is_what_the_code_makes_it() -> None:
    assert (ROOT / "docs" / "api.md").read_text(encoding="utf-8") == markdown()


def test_type_checkers_see_the_same_names() -> None:
    """What is under TYPE_CHECKING is what is imported when asked for."""
    import ast

    tree = ast.parse((ROOT / "replan" / "__init__.py").read_text(encoding="utf-8"))
    block = next(node for node in tree.body if isinstance(node, ast.If))
    seen = {
        alias.asname or alias.name: (node.module, alias.name)
        for node in block.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert seen == replan._FROM
    assert (ROOT / "replan" / "py.typed").is_file()


def test_it_is_imported_within_a_third_of_a_second() -> None:
    code = (
        "import sys, time; t = time.process_time(); import replan;"
        "print(time.process_time() - t, 'numpy' in sys.modules)"
    )
    begin = time.monotonic()
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    took, numpy = done.stdout.split()
    assert float(took) < 0.3 and numpy == "False" and time.monotonic() - begin < 60.0


def test_what_no_command_needs_at_once_is_not_imported_with_the_tables_of_names() -> None:
    """scipy.signal and scipy.stats take longer to import than all our packages; rerun likewise."""
    slow = "scipy.signal", "scipy.stats", "rerun", "duckdb", "optuna", "ray"
    tables = "metrics, planners, replay.api, replay.control, replay.vehicle"
    code = f"import sys, {tables}; print([name for name in {slow} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
