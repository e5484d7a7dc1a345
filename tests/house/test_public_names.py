"""The public names: `import replan` has them, types and the page agree, and importing them is
quick.
"""

import subprocess
import sys
import time
from pathlib import Path

import pytest

import replan
from replan.page import SECTIONS, markdown

ROOT = Path(__file__).parents[2]


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


def test_import_takes_at_most_a_third_of_a_second() -> None:
    code = (
        "import sys, time; t = time.process_time(); import replan;"
        "print(time.process_time() - t, 'numpy' in sys.modules)"
    )
    begin = time.monotonic()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    took, numpy = done.stdout.split()
    assert float(took) < 0.3 and numpy == "False" and time.monotonic() - begin < 60.0


def test_tables_of_names_import_no_heavy_packages() -> None:
    """scipy.signal and scipy.stats take longer to import than all our packages; rerun likewise."""
    slow = "scipy.signal", "scipy.stats", "rerun", "duckdb", "optuna", "ray"
    tables = (
        "replan.metrics, replan.planners, replan.api, replan.replay.control, replan.replay.vehicle"
    )
    code = f"import sys, {tables}; print([name for name in {slow} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
