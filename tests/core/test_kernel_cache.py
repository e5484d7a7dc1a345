"""Machine code on disk is valid for what it was compiled from, and compiled anew otherwise."""

import importlib
import itertools
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import pytest

from replan.core.kernel_cache import KernelIndex
from replan.logs.states import wrap

compiles = pytest.mark.skipif("NUMBA_DISABLE_JIT" in os.environ, reason="kernels are not compiled")


def run_python(
    arguments: Sequence[str], folder: Path, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Run a new process of Python, which can import from the folder and compiles kernels."""
    inherited = {
        name: value
        for name, value in os.environ.items()
        if name not in ("NUMBA_DISABLE_JIT", "NUMBA_CACHE_DIR", "NUMBA_CPU_NAME")
    }
    path = os.pathsep.join([str(folder), *sys.path])
    return subprocess.run(
        [sys.executable, "-B", *arguments],
        env={**inherited, "PYTHONPATH": path, **environment},
        cwd=folder,
        capture_output=True,
        text=True,
        check=True,
    )


NO_FOLDER = """
import numba.core.caching as caching
class NoLocators(list):
    append = lambda *_: None
caching.CacheImpl._locator_classes = NoLocators()
"""
FULL_DISK = """
import errno, numba.core.caching as caching
def raise_full(*arguments):
    raise OSError(errno.ENOSPC, "No space left on device")
caching.IndexDataCacheFile._save_data = raise_full
caching.IndexDataCacheFile.load = lambda *arguments: None
"""
CALL = "from replan.logs.shapes import corners\nprint(corners(1.0, 2.0, 0.5, 4.0, 2.0))\n"


@pytest.mark.slow
@pytest.mark.parametrize("fault", [NO_FOLDER, FULL_DISK])
def test_kernels_that_cannot_be_kept_give_the_same_results_and_one_note(
    fault: str, tmp_path: Path
) -> None:
    faulty, sound = (run_python(["-c", before + CALL], tmp_path) for before in (fault, ""))
    assert faulty.stdout == sound.stdout != ""
    assert faulty.stderr.count("NUMBA_CACHE_DIR") == 1 and sound.stderr == ""


OUTER = """
from constants import RATE
from inner import times
from replan.core.kernel import compiled_count, kernel

@kernel
def outer(x: float) -> float:
    return times(x) + RATE

print(outer(2.0), compiled_count())
"""
INNER = """
from replan.core.kernel import inner_kernel
{lines}
@inner_kernel
def times(x: float) -> float:
    {docstring}
    return {factor} * x
"""


@pytest.mark.slow
def test_changed_callees_and_constants_are_compiled_anew_but_not_changed_docstrings_and_lines(
    tmp_path: Path,
) -> None:
    """The file of the outer kernel stays as it is; numba alone would go on with the old code."""
    (tmp_path / "outer.py").write_text(OUTER, encoding="utf-8")
    cases = (
        (3, 1, "", "", "7.0 2"),
        (3, 1, "", "", "7.0 0"),
        (3, 1, "", '"""Multiply."""', "7.0 0"),
        (3, 1, "\n# moved\n", "", "7.0 0"),
        (5, 1, "", "", "11.0 2"),
        (5, 7, "", "", "17.0 1"),
    )
    for factor, rate, lines, docstring, expected in cases:
        inner = INNER.format(factor=factor, lines=lines, docstring=docstring)
        (tmp_path / "inner.py").write_text(inner, encoding="utf-8")
        (tmp_path / "constants.py").write_text(f"RATE = {rate}.0", encoding="utf-8")
        ended = run_python(["outer.py"], tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "cache"))
        assert ended.stdout.strip() == expected


NAMED = """
from enum import Enum
from typing import NamedTuple

import numpy as np

from replan.core.kernel import kernel

class {name}(NamedTuple):
    {first}: float
    {second}: float

class Step(Enum):
    LONG = {step}

@kernel
def f(pair: {name}) -> float:
    return np.{function}(pair.{field}) + Step.LONG.value

print(f({name}(1.0, 4.0)))
"""


@pytest.mark.slow
def test_a_changed_name_field_or_member_is_compiled_anew(tmp_path: Path) -> None:
    """The bytecode of these is the same: it has the places of names and constants only."""
    source: dict[str, Any] = {"name": "Pair", "first": "x", "second": "y"}
    source |= {"step": 0, "function": "square", "field": "y"}
    changes: tuple[tuple[dict[str, Any], float], ...] = (
        ({}, 16.0),
        ({"function": "sqrt"}, 2.0),
        ({"field": "x"}, 1.0),
        ({"first": "y", "second": "x"}, 2.0),
        ({"step": 10}, 12.0),
        ({"name": "Two"}, 12.0),
    )
    for change, expected in changes:
        source |= change
        (tmp_path / "named.py").write_text(NAMED.format(**source), encoding="utf-8")
        ended = run_python(["named.py"], tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "cache"))
        assert float(ended.stdout) == expected


MOVED = """
from typing import NamedTuple

from replan.core.kernel import inner_kernel

class Pair(NamedTuple):
    x: float
    y: float

@inner_kernel
def product(pair: Pair) -> float:
    return pair.x * pair.y
"""
USER = """
from {module} import Pair, product
from replan.core.kernel import kernel

@kernel
def f(pair: Pair) -> float:
    return product(pair)

print(f(Pair(2.0, 3.0)))
"""


@pytest.mark.slow
def test_a_kernel_that_uses_a_moved_module_is_compiled_anew(tmp_path: Path) -> None:
    """Reading the stored code would import the module that is gone."""
    for module in ("before", "after"):
        (tmp_path / f"{module}.py").write_text(MOVED, encoding="utf-8")
        (tmp_path / "user.py").write_text(USER.format(module=module), encoding="utf-8")
        ended = run_python(["user.py"], tmp_path, NUMBA_CACHE_DIR=str(tmp_path / "cache"))
        assert float(ended.stdout) == 6.0
        (tmp_path / f"{module}.py").unlink()


class FromMovedModule:
    """Unpickled, as machine code is: it imports a module that is not there any more."""

    def __reduce__(self) -> tuple[Any, tuple[str]]:
        return importlib.import_module, ("replan.replay.vehicle.no_such_module",)


@compiles
def test_stored_code_that_names_a_missing_module_counts_as_missing(tmp_path: Path) -> None:
    index = KernelIndex(cast("Any", wrap), str(tmp_path))
    index.save("kind", FromMovedModule())
    assert index.load("kind") is None
    index.save("kind", "code compiled anew")
    assert index.load("kind") == "code compiled anew"


SHIPPED = """
import os, tempfile
if os.environ.get("READ_ONLY"):  # stands for a read-only file system: root may write anywhere else
    def refuse(*_, **__):
        raise OSError("read-only file system")
    os.makedirs = os.mkdir = os.replace = tempfile.TemporaryFile = refuse
from replan.core.kernel import compiled_count, kernel

@kernel
def times(x: float) -> float:
    return {factor} * x

print(times(2.0), compiled_count())
"""


@pytest.mark.slow
def test_code_beside_copied_sources_is_used_for_its_source_and_processor_only(
    tmp_path: Path,
) -> None:
    """As a wheel ships it: at another path, read-only, with another folder for new code."""
    built, used, other = tmp_path / "built", tmp_path / "used", tmp_path / "other"

    def run_times(factor: int, **environment: str) -> tuple[str, bool]:
        (used / "times.py").write_text(SHIPPED.format(factor=factor), encoding="utf-8")
        ended = run_python(["times.py"], used, **environment)
        return ended.stdout.strip(), bool(ended.stderr)

    used.mkdir()
    assert run_times(3) == ("6.0 1", False)
    used.rename(built)
    shutil.copytree(built, used)
    assert run_times(3) == ("6.0 0", False)
    assert run_times(3, READ_ONLY="1") == ("6.0 0", False)
    assert run_times(3, NUMBA_CACHE_DIR=str(other)) == ("6.0 0", False)
    assert not list(other.rglob("*.nb?"))
    generic = {"NUMBA_CPU_NAME": "generic", "NUMBA_CACHE_DIR": str(other)}
    assert run_times(3, **generic) == ("6.0 1", False)
    assert run_times(5, READ_ONLY="1") == ("10.0 1", True)
    assert run_times(5, NUMBA_CACHE_DIR=str(other)) == ("10.0 1", False)


STEPS = ("read", "data", "index")
"""A process reads the index, writes its code, and writes the index with it."""


@compiles
def test_two_processes_that_compile_at_once_load_their_own_code_or_none(tmp_path: Path) -> None:
    """Law over all orders of the steps of two processes with arguments of their own."""
    steps = [(process, step) for process in "ab" for step in STEPS]
    for order in itertools.permutations(steps):
        if any([step for name, step in order if name == process] != [*STEPS] for process in "ab"):
            continue
        folder = tmp_path / "".join(process + step[0] for process, step in order)
        folder.mkdir()

        def open_index(folder: Path = folder) -> Any:
            index = KernelIndex(cast("Any", wrap))
            index._cache_path, index._index_path = str(folder), str(folder / "kernel.nbi")
            return index

        contents: dict[str, Any] = {}
        for process, step in order:
            index = open_index()
            if step == "read":
                contents[process] = index._load_index()
                continue
            index._load_index = lambda content=contents[process]: dict(content)
            if step == "data":
                index._save_index = lambda *_: None
            else:
                index._save_data, index._clear = lambda *_: None, lambda: None
            index.save(process, f"code of {process}")
        for process in "ab":
            assert open_index().load(process) in (None, f"code of {process}"), order
        one_after_the_other = order[2][0] == order[0][0] == order[1][0]
        assert not one_after_the_other or all(map(open_index().load, "ab")), order
