"""Kernels without a place for their machine code: they are compiled anew, which is said once."""

import importlib
import itertools
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any, cast

import pytest

from replan.core.kernel_compiler import KernelIndex
from replan.logs.states import wrap

NO_PLACE = """
import numba.core.caching as c
class Without(list):
    append = lambda *_: None
c.CacheImpl._locator_classes = Without()
"""
NO_ROOM = """
import errno, numba.core.caching as c
def full(*arguments):
    raise OSError(errno.ENOSPC, "No space left on device")
c.IndexDataCacheFile._save_data = full
c.IndexDataCacheFile.load = lambda *arguments: None
"""
USE = "from replan.logs.shapes import corners\nprint(corners(1.0, 2.0, 0.5, 4.0, 2.0))\n"


@pytest.mark.slow
@pytest.mark.parametrize("without", [NO_PLACE, pytest.param(NO_ROOM, marks=pytest.mark.slow)])
def test_without_a_cache_kernels_are_compiled_anew_and_it_is_said_once(
    without: str, tmp_path: Path
) -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    environment.pop("NUMBA_DISABLE_JIT", None)
    options = {
        "cwd": tmp_path,
        "env": environment,
        "capture_output": True,
        "text": True,
        "check": True,
    }
    said = [
        subprocess.run([sys.executable, "-c", before + USE], **options) for before in (without, "")
    ]
    assert said[0].stdout == said[1].stdout != ""
    assert (
        said[0].stderr.count("compiled kernels cannot be kept") == 1
        and "NUMBA_CACHE_DIR" in said[0].stderr
    )
    assert said[1].stderr == ""


OUTER = """
from constants import RATE
from inner import times
from replan.core.kernel import kernel
from replan.core.kernel import compiled_count

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
    {says}
    return {factor} * x
"""


@pytest.mark.slow
def test_code_on_disk_is_stale_where_a_called_kernel_or_a_constant_has_changed_but_no_docstring_or_line(  # noqa: E501
    tmp_path: Path,
) -> None:
    """The file of the outer kernel stays as it is; numba alone would go on with the old code."""
    (tmp_path / "outer.py").write_text(OUTER, encoding="utf-8")
    path = os.pathsep.join([str(tmp_path), *sys.path])
    environment = {**os.environ, "PYTHONPATH": path, "NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    environment.pop("NUMBA_DISABLE_JIT", None)
    said = []
    changes = (
        (3, 1, "", ""),
        (3, 1, "", ""),
        (3, 1, "", '"""Says."""'),
        (3, 1, "\n# moved\n", ""),
        (5, 1, "", ""),
        (5, 7, "", ""),
    )
    for factor, rate, lines, says in changes:
        inner = INNER.format(factor=factor, lines=lines, says=says)
        (tmp_path / "inner.py").write_text(inner, encoding="utf-8")
        (tmp_path / "constants.py").write_text(f"RATE = {rate}.0", encoding="utf-8")
        run = [sys.executable, "-B", str(tmp_path / "outer.py")]
        said.append(
            subprocess.run(
                run, env=environment, capture_output=True, text=True, check=True
            ).stdout.split()
        )
    assert said == [["7.0", "2"], *3 * [["7.0", "0"]], ["11.0", "2"], ["17.0", "1"]]


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
def test_code_on_disk_is_stale_where_a_name_a_field_or_a_member_has_changed(tmp_path: Path) -> None:
    """The bytecode of these is the same: it has the places of names and constants only."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    environment |= {"NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    environment.pop("NUMBA_DISABLE_JIT", None)
    this = {
        "name": "Pair",
        "first": "x",
        "second": "y",
        "step": 0,
        "function": "square",
        "field": "y",
    }
    said = []
    changes = (
        {"function": "sqrt"},
        {"field": "x"},
        {"first": "y", "second": "x"},
        {"step": 10},
        {"name": "Two"},
    )
    for change in ({}, *changes):
        this |= change
        (tmp_path / "named.py").write_text(NAMED.format(**this), encoding="utf-8")
        run = [sys.executable, "-B", str(tmp_path / "named.py")]
        said.append(
            float(
                subprocess.run(
                    run, env=environment, capture_output=True, text=True, check=True
                ).stdout
            )
        )
    assert said == [16.0, 2.0, 1.0, 2.0, 12.0, 12.0]


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
def test_code_on_disk_is_stale_where_a_kernel_or_a_named_tuple_has_moved_to_another_module(
    tmp_path: Path,
) -> None:
    """Reading it would import the module that is gone."""
    path = os.pathsep.join([str(tmp_path), *sys.path])
    environment = {**os.environ, "PYTHONPATH": path, "NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    environment.pop("NUMBA_DISABLE_JIT", None)
    said = []
    for module in ("before", "after"):
        (tmp_path / f"{module}.py").write_text(MOVED, encoding="utf-8")
        (tmp_path / "user.py").write_text(USER.format(module=module), encoding="utf-8")
        run = [sys.executable, "-B", str(tmp_path / "user.py")]
        said.append(
            float(
                subprocess.run(
                    run, env=environment, capture_output=True, text=True, check=True
                ).stdout
            )
        )
        (tmp_path / f"{module}.py").unlink()
    assert said == [6.0, 6.0]


BROUGHT = """
import os, tempfile
if os.environ.get("READ_ONLY"):  # stands for file systems that are read-only: root may write anywhere else
    def refused(*_, **__):
        raise OSError("read-only file system")
    os.makedirs = os.mkdir = os.replace = tempfile.TemporaryFile = refused
from replan.core.kernel import kernel
from replan.core.kernel import compiled_count

@kernel
def times(x: float) -> float:
    return {factor} * x

print(times(2.0), compiled_count())
"""  # noqa: E501


@pytest.mark.slow
def test_code_beside_the_sources_is_found_where_they_are_copied_and_only_what_it_is_for(
    tmp_path: Path,
) -> None:
    """As a wheel brings it: at another place, read-only, another folder chosen.

    Not for another processor or code.
    """
    built, used, other = tmp_path / "built", tmp_path / "used", tmp_path / "other"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    for name in ("NUMBA_DISABLE_JIT", "NUMBA_CACHE_DIR", "NUMBA_CPU_NAME"):
        environment.pop(name, None)

    def said(factor: int, **more: str) -> list[str]:
        (used / "times.py").write_text(BROUGHT.format(factor=factor), encoding="utf-8")
        run = [sys.executable, "-B", str(used / "times.py")]
        done = subprocess.run(
            run, env={**environment, **more}, capture_output=True, text=True, check=True
        )
        return [*done.stdout.split(), done.stderr.partition(":")[0]]

    used.mkdir()
    assert said(3) == ["6.0", "1", ""]
    used.rename(built)
    shutil.copytree(built, used)
    assert said(3) == ["6.0", "0", ""]
    assert said(3, READ_ONLY="1") == ["6.0", "0", ""]
    assert said(3, NUMBA_CACHE_DIR=str(other)) == ["6.0", "0", ""]
    assert not list(other.rglob("*.nb?"))
    assert said(3, NUMBA_CPU_NAME="generic", NUMBA_CACHE_DIR=str(other)) == ["6.0", "1", ""]
    assert said(5, READ_ONLY="1") == ["10.0", "1", "note"]
    assert said(5, NUMBA_CACHE_DIR=str(other)) == ["10.0", "1", ""]


@pytest.mark.skipif("NUMBA_DISABLE_JIT" in os.environ, reason="nothing is compiled")
def test_two_processes_that_compile_at_once_never_find_the_code_of_each_other(
    tmp_path: Path,
) -> None:
    """Law over the orders in which two processes look, keep the index, and keep the code of their
    own arguments.
    """
    compiled = cast("Any", wrap)
    for order in itertools.permutations(
        ("look a", "data a", "index a", "look b", "data b", "index b")
    ):
        if any(
            order.index(f"look {x}") > min(order.index(f"data {x}"), order.index(f"index {x}"))
            for x in "ab"
        ):
            continue
        if any(order.index(f"data {x}") > order.index(f"index {x}") for x in "ab"):
            continue
        steps: dict[str, list[Any]] = {"a": [], "b": []}
        folder = tmp_path / "".join(step[0] + step[-1] for step in order)
        folder.mkdir()
        for step in order:
            what, who = step.split()
            index = KernelIndex(compiled)
            index._cache_path, index._index_path = str(folder), str(folder / "kernel.nbi")
            if what == "look":
                steps[who] = [index._load_index()]
            index._load_index = lambda kept=steps[who][0]: dict(kept)  # what it saw when it looked
            index._save_data = index._save_data if what == "data" else lambda *_: None
            index._clear = index._clear if what == "data" else lambda: None
            index._save_index = index._save_index if what == "index" else lambda *_: None
            if what != "look":
                index.save(who, f"code of {who}")
        last = KernelIndex(compiled)
        last._cache_path, last._index_path = str(folder), str(folder / "kernel.nbi")
        for who in "ab":
            assert last.load(who) in (None, f"code of {who}"), order
        in_turn = order.index("look b") == 3 or order.index("look a") == 3
        assert not in_turn or all(last.load(who) for who in "ab"), order


class FromMovedModule:
    """Unpickled, as machine code is: it imports a module that is not there any more."""

    def __reduce__(self) -> tuple[Any, tuple[str]]:
        return importlib.import_module, ("replan.replay.vehicle.no_such_module",)


@pytest.mark.skipif("NUMBA_DISABLE_JIT" in os.environ, reason="nothing is compiled")
def test_code_with_a_kernel_of_a_module_that_was_moved_is_not_found(tmp_path: Path) -> None:
    index = KernelIndex(cast("Any", wrap), str(tmp_path))
    index.save("kind", FromMovedModule())
    assert index.load("kind") is None
    index.save("kind", "code compiled anew")
    assert index.load("kind") == "code compiled anew"
