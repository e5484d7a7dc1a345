"""The cache of the kernels' machine code on disk.

Machine code is kept in `NUMBA_CACHE_DIR`, else in `__pycache__` beside the sources, else in the user's cache folder. A
wheel may ship it in `__pycache__` (`./dev wheel`). It is valid for one version of Python and numba, one processor
(`logs.kernel.PORTABLE`), and one hash (`stamp`) of everything that it depends on: the kernel's code, the kernels that
it calls, and module constants; docstrings and line numbers are not among them. Numba compares only the kernel's own
file, although it compiles called kernels and module constants into the code; when those change, numba would run stale
machine code.
"""

from __future__ import annotations

import re
import sys
import tempfile
from collections.abc import Iterator
from enum import Enum
from functools import cache
from glob import escape
from hashlib import sha256
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, cast

import numba
import numpy as np
from numba.core import caching
from numba.core.caching import IndexDataCacheFile
from numba.core.dispatcher import Dispatcher

from logs.kernel_compiler import LINKED
from replan.own import PACKAGES

_WORD = re.compile(r"[A-Za-z_]\w*")
_LINE = re.compile(r"-\d+(?=\.py\d+)")
"""The line number in numba's names of files ("shapes.corners-142.py311")."""


@cache
def stamp(kernel: Any) -> str:
    """Return the SHA-256, in hexadecimal, of all inputs of the machine code of a kernel (a numba dispatcher)."""
    digest = sha256(f"{LINKED} {sorted(kernel.targetoptions.items())!r}".encode())
    for part in _parts_of_kernel(kernel.py_func, {kernel}):
        digest.update(f"{part}\n".encode())
    return digest.hexdigest()


def _parts_of_kernel(function: FunctionType, seen: set[Any]) -> Iterator[str]:
    """Yield a function's code and the values of its globals; kernels in `seen` are skipped, new ones added."""
    # numba finds machine code by this name
    yield f"{function.__module__}.{function.__qualname__} {_as_text(function.__defaults__)}"
    yield from (_as_text(each) for each in _hinted_classes(function.__annotations__, function.__globals__))
    for code in _codes(function.__code__):
        said = function.__doc__
        constants = [_as_text(None if said and each == said else each) for each in code.co_consts]
        yield f"{code.co_code.hex()} {code.co_names} {code.co_varnames} {constants}"
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
        self._base = _LINE.sub("", numbas._index_name.removesuffix(".nbi"))
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


class _ShippedLocator(caching.InTreeCacheLocator):
    """Finds kernels of a wheel beside the source, read-only; used if no folder is writable."""

    def ensure_cache_path(self) -> None:
        if next(Path(self.get_cache_path()).glob("*.nbi"), None) is None:  # type: ignore[no-untyped-call]
            raise FileNotFoundError


@cache
def _check_folder(folder: str) -> None:
    """Create the folder for machine code; OSError if it is not usable.

    It must be writable. A `NUMBA_CACHE_DIR` that holds kernels need only be readable (a read-only container image).
    """
    chosen = cast("Any", numba.config).CACHE_DIR
    if chosen and Path(folder).is_relative_to(chosen) and next(Path(folder).glob("*.nbi"), None) is not None:
        return
    Path(folder).mkdir(parents=True, exist_ok=True)
    tempfile.TemporaryFile(dir=folder).close()


cast("Any", caching)._CacheLocator.ensure_cache_path = lambda self: _check_folder(self.get_cache_path())
"""Numba's check, but once per folder instead of once per kernel."""
cast("Any", caching).CacheImpl._locator_classes.append(_ShippedLocator)
