"""Compiling less: the same results, and no machine code for what only kernels call."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any, cast

import numba
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numba.core.compiler import Flags

from replan.core.kernel import inner_kernel, kernel
from replan.core.kernel_compiler import KernelLibrary

pytestmark = pytest.mark.skipif("NUMBA_DISABLE_JIT" in os.environ, reason="nothing is compiled")


@inner_kernel
def _steps(values: Any, most: int) -> Any:
    """An array of its own, sorted, and an error with text from compiled code."""
    if len(values) > most:
        raise ValueError("more than the most")
    out = np.empty(len(values))
    for i in range(len(values)):
        out[i] = values[i] ** 2 - np.hypot(values[i], 3.0)
    return np.sort(out)


@kernel
def _total(values: Any, most: int) -> Any:
    out = _steps(values, most)
    return out.sum(), out[::-1].copy(), (len(out), np.searchsorted(out, 0.5))


@settings(max_examples=30)
@given(st.lists(st.floats(-1e3, 1e3), max_size=12))
def test_a_kernel_does_what_its_source_does(drawn: list[float]) -> None:
    """Law; the array comes from an inner kernel, with numba's own functions in it."""
    values, compiled = np.array(drawn), cast("Any", _total)
    steps = cast("Any", _steps).py_func(values, 12)
    total, turned, (n, at) = compiled(values, 12)
    assert total == pytest.approx(float(steps.sum())) and (turned == steps[::-1]).all()
    assert (n, at) == (len(steps), np.searchsorted(steps, 0.5))
    if drawn:
        with pytest.raises(ValueError, match="more than the most"):
            compiled(values, 0)


def test_only_what_python_calls_has_machine_code() -> None:
    inner = cast("Any", numba.njit)(no_cpython_wrapper=True)(lambda x: 2.0 * x)
    outer = numba.njit(lambda x: inner(x) + 1.0)
    assert outer(1.0) == 3.0
    of_outer, of_inner = (next(iter(each.overloads.values())).library for each in (outer, inner))
    assert isinstance(of_outer, KernelLibrary) and of_outer._finalized and not of_inner._finalized


@pytest.mark.filterwarnings("ignore:First-class function")
def test_functions_that_a_user_compiles_work_as_ever() -> None:
    """A function as an argument needs the wrapper for C.

    A closure, a generator and a callback are compiled apart.
    """

    @numba.njit("f8(f8)")
    def twice(x: float) -> float:
        return 2.0 * x

    @numba.njit
    def apply(function: Any, n: int) -> Any:
        out = np.zeros(n)
        for i in range(n):
            out[i] = function(float(i))
        return out

    @numba.njit
    def counted(n: int) -> Any:
        for i in range(n):
            yield 3 * i

    @numba.cfunc("f8(f8)")
    def called(x: float) -> float:
        return x + 1.0

    listed = numba.njit(lambda functions, x: functions[0](x) + functions[1](x))
    assert apply(twice, 3).tolist() == [0.0, 2.0, 4.0]
    assert list(counted(3)) == [0, 3, 6] and called.ctypes(1.0) == 2.0
    assert listed((twice, twice), 2.0) == 8.0


INNER = """
import numpy as np
from replan.core.kernel import inner_kernel

@inner_kernel
def inner(x: float) -> float:
    if x < 0.0:
        raise ValueError("below zero")
    return np.full(3, x).sum()
"""
OUTER = """
from inner import inner
from replan.core.kernel import kernel
from replan.core.kernel import compiled_count

@kernel
def {name}(x: float) -> float:
    return inner(x) + {more}

print({name}(2.0), compiled_count())
try:
    {name}(-1.0)
except ValueError as error:
    print(error)
"""


@pytest.mark.slow
def test_an_inner_kernel_on_disk_serves_the_kernels_of_other_processes(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    environment |= {"NUMBA_CACHE_DIR": str(tmp_path / "kept")}
    (tmp_path / "inner.py").write_text(INNER, encoding="utf-8")
    said = []
    for name, more in (("one", 1.0), ("two", 2.0), ("two", 2.0)):
        (tmp_path / f"{name}.py").write_text(OUTER.format(name=name, more=more), encoding="utf-8")
        run = [sys.executable, "-B", str(tmp_path / f"{name}.py")]
        said.append(
            subprocess.run(
                run, env=environment, capture_output=True, text=True, check=True
            ).stdout.split()
        )
    assert said == [
        ["7.0", "2", "below", "zero"],
        ["8.0", "1", "below", "zero"],
        ["8.0", "0", "below", "zero"],
    ]


def test_options_are_compared_with_their_defaults() -> None:
    plain, explicit, other = Flags(), Flags(), Flags()
    explicit.nrt, other.nrt = Flags.options["nrt"].default, not Flags.options["nrt"].default
    assert plain == explicit and explicit == plain and hash(plain) == hash(explicit)
    assert plain != other and other != explicit
    assert other == other.copy()
