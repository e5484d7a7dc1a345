"""The decorators of compiled kernels, and the cache of their machine code.

A kernel is a pure module-level function of scalars and arrays. `kernel` compiles it with numba: cached on disk, IEEE
arithmetic (no fastmath), division by zero gives inf or nan as in NumPy. `NUMBA_DISABLE_JIT=1` runs the same source as
plain Python.

Machine code is kept in `NUMBA_CACHE_DIR`, else in `__pycache__` beside the sources, else in the user's cache folder. A
wheel may ship it in `__pycache__` (`./dev wheel`). It is valid for one start line of the kernel, one version of
Python and numba, one processor (`PORTABLE`), and one hash (`stamp`) of everything that it depends on: the kernel's
code, the kernels that it calls, and module constants. Numba compares only the kernel's own file, although it compiles
called kernels and module constants into the code; when those change, numba would run stale machine code.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import re
import sys
import tempfile
from collections.abc import Callable, Iterator
from enum import Enum
from functools import cache
from glob import escape
from hashlib import sha256
from itertools import islice
from math import ceil
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, ParamSpec, TypeVar, cast

import numba
import numpy as np
from numba import njit
from numba.core import caching, codegen, event
from numba.core.caching import IndexDataCacheFile
from numba.core.dispatcher import Dispatcher
from numpy.typing import NDArray

from replan.own import PACKAGES

_WORD = re.compile(r"[A-Za-z_]\w*")


@cache
def stamp(kernel: Any) -> str:
    """Return the SHA-256, in hexadecimal, of all inputs of the machine code of a kernel (a numba dispatcher)."""
    digest = sha256(repr(sorted(kernel.targetoptions.items())).encode())
    for part in _parts_of_kernel(kernel.py_func, {kernel}):
        digest.update(f"{part}\n".encode())
    return digest.hexdigest()


def _parts_of_kernel(function: FunctionType, seen: set[Any]) -> Iterator[str]:
    """Yield a function's code and the values of its globals; kernels in `seen` are skipped, new ones added."""
    # numba finds machine code by this name
    yield f"{function.__module__}.{function.__qualname__} {_as_text(function.__defaults__)}"
    yield from (_as_text(each) for each in _hinted_classes(function.__annotations__, function.__globals__))
    for code in _codes(function.__code__):
        yield f"{code.co_code.hex()} {code.co_names} {code.co_varnames} {[_as_text(c) for c in code.co_consts]}"
        held = [function.__globals__[name] for name in code.co_names if name in function.__globals__]
        ours = [each for each in held if isinstance(each, ModuleType) and each.__name__.partition(".")[0] in PACKAGES]
        attributes = (vars(each)[name] for each in ours for name in code.co_names if name in vars(each))
        for value in (*held, *attributes):
            if not isinstance(value, Dispatcher):
                yield _as_text(value)
            elif value not in seen:
                seen.add(value)
                yield from _parts_of_kernel(value.py_func, seen)


def _codes(code: CodeType) -> Iterator[CodeType]:
    """Yield a code object and the code objects in it (comprehensions)."""
    yield code
    for each in code.co_consts:
        if isinstance(each, CodeType):
            yield from _codes(each)


def _hinted_classes(hints: dict[str, Any], names: dict[str, Any]) -> Iterator[type]:
    """Yield the classes in annotations: a kernel's machine code depends on the layout of their fields."""
    for hint in hints.values():
        text = getattr(hint, "__forward_arg__", hint)
        found = [names.get(word) for word in _WORD.findall(text)] if isinstance(text, str) else [text]
        yield from (each for each in found if isinstance(each, type))


def _as_text(value: Any) -> str:
    """Return a text that changes with the value and is the same in every process."""
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {value.tobytes().hex()}"
    if isinstance(value, frozenset):
        return f"frozenset {sorted(map(_as_text, value))}"
    if isinstance(value, tuple):
        return f"{getattr(value, '_fields', '')}({', '.join(map(_as_text, value))})"
    if isinstance(value, Enum):  # before int: IntEnum members are both
        return f"{type(value).__qualname__}.{value.name} {value.value!r}"
    if isinstance(value, type):
        held, columns = "", getattr(value, "_fields", None)
        if issubclass(value, Enum):
            held = str([_as_text(member) for member in value])
        elif columns is not None:  # a named tuple
            within = _hinted_classes(getattr(value, "__annotations__", {}), vars(sys.modules[value.__module__]))
            defaults = tuple(value._field_defaults.values())  # type: ignore[attr-defined]
            held = f"{columns} {_as_text(defaults)} {[*map(_as_text, within)]}"
        return f"{value.__module__}.{value.__qualname__} {held}"
    if value is None or isinstance(value, bool | int | float | complex | str | bytes):
        return repr(value)
    return f"{type(value).__qualname__} {getattr(value, '__name__', '')}"


class KernelIndex(IndexDataCacheFile):
    """Numba's index of a kernel's machine code on disk, valid while `stamp` is unchanged.

    A file of machine code is named by a hash of its stamp and argument types. Numba numbers the files instead, so that
    two processes that compile a kernel for different arguments at once may overwrite each other's file.

    If the folder lacks the code, it is searched beside the source, where a wheel may have installed it.
    """

    def __init__(self, kernel: Any, folder: str | None = None) -> None:
        self._kernel = kernel
        numbas = kernel._cache._cache_file
        self._base = numbas._index_name.removesuffix(".nbi")
        super().__init__(folder or numbas._cache_path, self._base, "")  # type: ignore[no-untyped-call]
        beside = str(Path(kernel.py_func.__code__.co_filename).parent / "__pycache__")
        self._beside = None if beside == self._cache_path else KernelIndex(kernel, beside)

    def load(self, key: Any) -> Any:
        """The stored machine code for one argument signature, or None."""
        try:
            found = super().load(key)  # type: ignore[no-untyped-call]
        except ModuleNotFoundError:  # it contains a kernel whose module has moved
            found = None
        return self._beside.load(key) if found is None and self._beside else found

    def holds(self, processor: Any) -> bool:
        """Return whether machine code for a processor (numba's `magic_tuple`) is stored."""
        kept = self._load_index()
        return any(key[1] == processor for key in kept) or (self._beside is not None and self._beside.holds(processor))

    def _load_index(self) -> Any:
        try:
            return super()._load_index()  # type: ignore[no-untyped-call]
        except (ImportError, AttributeError):  # an older replan wrote it: a class that it names has moved
            return {}

    def save(self, key: Any, data: Any) -> None:
        """Store the machine code for one argument signature, and delete code with another `stamp`."""
        kept = self._load_index()
        if not kept:
            self._clear()
        kept[key] = f"{self._base}.{sha256(f'{self._source_stamp} {key!r}'.encode()).hexdigest()[:16]}.nbc"
        self._save_data(kept[key], data)  # type: ignore[no-untyped-call]
        self._save_index(kept)  # type: ignore[no-untyped-call]

    def _clear(self) -> None:
        for stale in Path(self._cache_path).glob(f"{escape(self._base)}.*.nbc"):
            stale.unlink(missing_ok=True)

    @property
    def _source_stamp(self) -> str:
        return stamp(self._kernel)  # computed on first use, when everything that the kernel calls is defined

    @_source_stamp.setter
    def _source_stamp(self, _: object) -> None:
        """Ignored: numba sets its own stamp here."""


FloatArray = NDArray[np.floating[Any]]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Points = np.ndarray[tuple[int, int], np.dtype[np.floating[Any]]]
"""Points `(n, 2)`: x and y in each row."""

TIE = 1e-6
"""Decisions treat lengths (m), times (s), angles, ratios and costs that differ by less as equal.

It is far above rounding and far below any measurement. Round figures are common in maps and scenarios, so thresholds
must not lie exactly on them: each comparison is shifted by this, in the direction that its code shows.
"""

PORTABLE = "x86-64-v3"
"""The target processor of kernels if the machine supports it and the user chose none (`NUMBA_CPU_NAME`).

Intel since Haswell (2013) and AMD since Excavator (2015) support it. Machine code for it can be shipped and gives the
same results on all of them.
"""
PORTABLE_HAS = frozenset({"+avx2", "+bmi", "+bmi2", "+f16c", "+fma", "+lzcnt", "+movbe", "+xsave"})
"""Its features beyond x86-64-v2, by LLVM's names (x86-64 psABI 1.0, table 3.1)."""

P = ParamSpec("P")
R = TypeVar("R")

_STORED: list[Any] = []
"""Numba's dispatchers of all imported kernels that have a cache on disk."""


_CONFIG = cast("Any", numba.config)
if (
    _CONFIG.CPU_NAME is None
    and _CONFIG.CPU_FEATURES is None
    and PORTABLE_HAS.issubset(codegen.get_host_cpu_features().split(","))  # type: ignore[no-untyped-call]
):
    _CONFIG.CPU_NAME, _CONFIG.CPU_FEATURES = PORTABLE, ""


class _ShippedLocator(caching.InTreeCacheLocator):
    """Finds kernels of a wheel beside the source, read-only; used if no folder is writable."""

    def ensure_cache_path(self) -> None:
        if next(Path(self.get_cache_path()).glob("*.nbi"), None) is None:  # type: ignore[no-untyped-call]
            raise FileNotFoundError


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile `function` on its first call, for the types of the arguments."""
    return _compile_kernel(function)


def inner_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """A kernel that only kernels call: compiled without the code that unpacks Python objects.

    For a small kernel with named tuples as arguments, that code takes most of the compilation.
    """
    return _compile_kernel(function, no_cpython_wrapper=True, no_cfunc_wrapper=True)


def _compile_kernel(function: Callable[P, R], **unlisted: Any) -> Callable[P, R]:
    """Compile, and cache the machine code on disk if possible; `unlisted`: options that numba's type stubs lack."""
    options: Any = {"error_model": "numpy", **unlisted}
    try:
        compiled = njit(cache=True, **options)(function)
    except RuntimeError:  # no folder is writable
        warn_not_kept()
        return cast("Callable[P, R]", njit(**options)(function))
    store = getattr(compiled, "_cache", None)  # missing with NUMBA_DISABLE_JIT
    if store is not None:
        store._cache_file, save = KernelIndex(compiled), store.save_overload

        def save_if_possible(*arguments: Any) -> None:
            try:
                save(*arguments)
            except OSError:  # a full disk must not end the drive: the next process compiles again
                warn_not_kept()

        store.save_overload = save_if_possible
        _STORED.append(compiled)
    return cast("Callable[P, R]", compiled)


@cache
def warn_not_kept() -> None:
    """Warn once, and not in workers, that each process compiles the kernels again."""
    if multiprocessing.parent_process() is None:
        sys.stderr.write(
            "note: compiled kernels cannot be kept (no folder for them can be written, or the disk is full): each"
            " process compiles them anew, which takes about a minute; set NUMBA_CACHE_DIR to a folder with room\n"
        )


class _NoCollection(event.Listener):
    """Disables garbage collection while a kernel is compiled: it took 8 to 18 % of the time."""

    def __init__(self) -> None:
        self.depth, self.enabled = 0, False

    def on_start(self, _: Any) -> None:
        if self.depth == 0:
            self.enabled = gc.isenabled()
            gc.disable()
        self.depth += 1

    def on_end(self, _: Any) -> None:
        self.depth -= 1
        if self.depth == 0 and self.enabled:
            gc.enable()


cast("Any", event).register("numba:compile", _NoCollection())


@cache
def _check_folder(folder: str) -> None:
    """Create the folder for machine code; OSError if it is not usable.

    It must be writable. A `NUMBA_CACHE_DIR` that holds kernels need only be readable (a read-only container image).
    """
    chosen = _CONFIG.CACHE_DIR
    if chosen and Path(folder).is_relative_to(chosen) and next(Path(folder).glob("*.nbi"), None) is not None:
        return
    Path(folder).mkdir(parents=True, exist_ok=True)
    tempfile.TemporaryFile(dir=folder).close()


cast("Any", caching)._CacheLocator.ensure_cache_path = lambda self: _check_folder(self.get_cache_path())
"""Numba's check, but once per folder instead of once per kernel."""
cast("Any", caching).CacheImpl._locator_classes.append(_ShippedLocator)


COLD = 0.1
"""Share of the imported kernels below which the cache counts as cold; the smallest runs need more."""


def _is_stored(kernel: Any) -> bool:
    """Return whether machine code of a kernel for this processor is on disk."""
    return bool(kernel._cache._cache_file.holds(kernel.targetctx.codegen().magic_tuple()))


def is_cache_cold() -> bool:
    """Return whether the disk holds so little machine code that a run begins with compiling."""
    enough = ceil(COLD * len(_STORED))
    return sum(1 for _ in islice(filter(_is_stored, _STORED), enough)) < enough


class KernelWatch:
    """Counts the imported kernels that are on disk, as this and other processes compile them.

    Attributes:
        known: The number of imported kernels; a run needs a part of them.
    """

    def __init__(self) -> None:
        self.known, self._missing = 0, list[Any]()
        self.look()

    @property
    def stored(self) -> int:
        """The number of those whose machine code was on disk at the last look."""
        return self.known - len(self._missing)

    def look(self) -> int:
        """Count again, and return how many of the kernels that were missing have been compiled since the last look."""
        before, self.known = self.known, len(_STORED)
        left = [each for each in self._missing if not _is_stored(each)]
        compiled = len(self._missing) - len(left)
        self._missing = left + [each for each in _STORED[before : self.known] if not _is_stored(each)]
        return compiled


def compiled_count() -> int:
    """Return the number of compilations in this process: one per kernel and argument types."""
    return sum(sum(compiled.stats.cache_misses.values()) for compiled in _STORED)


def cache_folder() -> Path | None:
    """Return the folder with the machine code of all imported kernels; None if it is not stored."""
    return Path(os.path.commonpath([compiled.stats.cache_path for compiled in _STORED])) if _STORED else None


@inner_kernel
def interpolated(x: float, xp: FloatArray, fp: FloatArray) -> float:
    """Return `np.interp` of one number, to the bit: `fp` `(n,)` over increasing `xp`, constant outside."""
    last = len(xp) - 1
    if x >= xp[last]:
        return fp[last]
    if x < xp[0]:
        return fp[0]
    k = np.searchsorted(xp, x, side="right") - 1
    return (fp[k + 1] - fp[k]) / (xp[k + 1] - xp[k]) * (x - xp[k]) + fp[k]


def frozen(values: object, dtype: Any = np.float64) -> NDArray[Any]:
    """Return a contiguous array of `values` over an immutable buffer (bytes): a copy unless it is such an array.

    `flags.writeable` of such an array cannot be set again, so that a planner cannot change its inputs.
    """
    array: NDArray[Any] = np.ascontiguousarray(values, dtype=dtype)
    owner: object = array
    while isinstance(owner, np.ndarray):
        owner = owner.base
    if not isinstance(owner, bytes):
        array = np.frombuffer(array.tobytes(), array.dtype).reshape(array.shape)
    return array
