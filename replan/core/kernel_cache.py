"""The cache of machine code on disk: where it is kept, and when it is valid.

Machine code is kept in `NUMBA_CACHE_DIR`, else in `__pycache__` beside the sources, else in the
user's cache folder. A wheel may ship it in `__pycache__` (`./dev wheel`). It is valid for one
version of Python and numba, one processor (`replan.core.kernel.PORTABLE`), and one hash (`stamp`)
of everything that it depends on: the kernel's code, the kernels that it calls, and module
constants; docstrings and line numbers are not among them. Numba compares only the kernel's own
file, although it compiles called kernels and module constants into the code; when those change,
numba would run stale machine code.
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


@cache
def stamp(kernel: Any) -> str:
    """Return the SHA-256, in hexadecimal, of all inputs of the machine code of a kernel (a numba
    dispatcher).
    """
    digest = sha256(f"{sorted(kernel.targetoptions.items())!r}".encode())
    for text in _inputs(kernel.py_func, {kernel}):
        digest.update(f"{text}\n".encode())
    return digest.hexdigest()


def _inputs(function: FunctionType, visited: set[Any]) -> Iterator[str]:
    """Yield a function's code and the values of its globals, as texts.

    Kernels in `visited` are skipped, new ones added.
    """
    # numba finds machine code by this name
    yield f"{function.__module__}.{function.__qualname__} {_as_text(function.__defaults__)}"
    yield from map(_as_text, _hinted_classes(function.__annotations__, function.__globals__))
    for code in _nested_codes(function.__code__):
        constants = [
            _as_text(None if constant == function.__doc__ else constant)
            for constant in code.co_consts
        ]
        yield f"{code.co_code.hex()} {code.co_names} {code.co_varnames} {constants}"
        for value in _globals_in(code, function.__globals__):
            if not isinstance(value, Dispatcher):
                yield _as_text(value)
            elif value not in visited:
                visited.add(value)
                yield from _inputs(value.py_func, visited)


def _nested_codes(code: CodeType) -> Iterator[CodeType]:
    """Yield a code object and the code objects in it (comprehensions)."""
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _nested_codes(constant)


def _globals_in(code: CodeType, names: dict[str, Any]) -> Iterator[Any]:
    """Yield the values of the globals that code uses, and those of the attributes that it may use
    of modules of replan.
    """
    values = [names[name] for name in code.co_names if name in names]
    yield from values
    for module in values:
        if isinstance(module, ModuleType) and module.__name__.partition(".")[0] == "replan":
            members = vars(module)
            yield from (members[name] for name in code.co_names if name in members)


_WORD = re.compile(r"[A-Za-z_]\w*")


def _hinted_classes(hints: dict[str, Any], names: dict[str, Any]) -> Iterator[type]:
    """Yield the classes in annotations: a kernel's machine code depends on the layout of their
    fields.
    """
    for hint in hints.values():
        text = getattr(hint, "__forward_arg__", hint)
        values = (
            [names.get(word) for word in _WORD.findall(text)] if isinstance(text, str) else [text]
        )
        yield from (value for value in values if isinstance(value, type))


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
        return f"{value.__module__}.{value.__qualname__} {_layout(value)}"
    if value is None or isinstance(value, bool | int | float | complex | str | bytes):
        return repr(value)
    return f"{type(value).__qualname__} {getattr(value, '__name__', '')}"


def _layout(kind: type) -> str:
    """Return the members of an enumeration or the fields of a named tuple; "" for other classes."""
    if issubclass(kind, Enum):
        return str([_as_text(member) for member in kind])
    fields = getattr(kind, "_fields", None)
    if fields is None:
        return ""
    hints, names = getattr(kind, "__annotations__", {}), vars(sys.modules[kind.__module__])
    defaults = tuple(kind._field_defaults.values())  # type: ignore[attr-defined]
    return f"{fields} {_as_text(defaults)} {[*map(_as_text, _hinted_classes(hints, names))]}"


_LINE = re.compile(r"-\d+(?=\.py\d+)")
"""The line number in numba's names of files ("shapes.corners-142.py311")."""


class KernelIndex(IndexDataCacheFile):
    """Numba's index of a kernel's machine code on disk, valid while `stamp` is unchanged.

    A file of machine code is named by a hash of its stamp and argument types. Numba numbers the
    files instead, so that two processes that compile a kernel for different arguments at once may
    overwrite each other's file.

    If the folder lacks the code, it is searched beside the source, where a wheel may have installed
    it.
    """

    def __init__(self, kernel: Any, folder: str | None = None) -> None:
        self._kernel = kernel
        numba_index = kernel._cache._cache_file
        self._base = _LINE.sub("", numba_index._index_name.removesuffix(".nbi"))
        super().__init__(folder or numba_index._cache_path, self._base, "")  # type: ignore[no-untyped-call]
        beside = str(Path(kernel.py_func.__code__.co_filename).parent / "__pycache__")
        self._beside = None if beside == self._cache_path else KernelIndex(kernel, beside)

    def load(self, key: Any) -> Any:
        """The stored machine code for one argument signature, or None."""
        try:
            code = super().load(key)  # type: ignore[no-untyped-call]
        except ModuleNotFoundError:  # it contains a kernel whose module has moved
            code = None
        return self._beside.load(key) if code is None and self._beside else code

    def holds(self, processor: Any) -> bool:
        """Return whether machine code for a processor (numba's `magic_tuple`) is stored."""
        return any(key[1] == processor for key in self._load_index()) or (
            self._beside is not None and self._beside.holds(processor)
        )

    def _load_index(self) -> Any:
        try:
            return super()._load_index()  # type: ignore[no-untyped-call]
        # An older replan wrote it: a class that it names has moved
        except (ImportError, AttributeError):
            return {}

    def save(self, key: Any, data: Any) -> None:
        """Store the machine code for one argument signature, and delete code with another
        `stamp`.
        """
        files = self._load_index()
        if not files:
            self._clear()
        digest = sha256(f"{self._source_stamp} {key!r}".encode()).hexdigest()[:16]
        files[key] = f"{self._base}.{digest}.nbc"
        self._save_data(files[key], data)  # type: ignore[no-untyped-call]
        self._save_index(files)  # type: ignore[no-untyped-call]

    def _clear(self) -> None:
        for stale in Path(self._cache_path).glob(f"{escape(self._base)}.*.nbc"):
            stale.unlink(missing_ok=True)

    @property
    def _source_stamp(self) -> str:
        # Computed on first use, when everything that the kernel calls is defined
        return stamp(self._kernel)

    @_source_stamp.setter
    def _source_stamp(self, _: object) -> None:
        """Ignored: numba sets its own stamp here."""


class _ShippedLocator(caching.InTreeCacheLocator):
    """Finds kernels of a wheel beside the source, read-only; used if no folder is writable."""

    def ensure_cache_path(self) -> None:
        if not _has_kernels(self.get_cache_path()):  # type: ignore[no-untyped-call]
            raise FileNotFoundError


def _has_kernels(folder: str) -> bool:
    return next(Path(folder).glob("*.nbi"), None) is not None


@cache
def _check_folder(folder: str) -> None:
    """Create the folder for machine code; OSError if it is not usable.

    It must be writable. A `NUMBA_CACHE_DIR` that holds kernels need only be readable (a read-only
    container image).
    """
    chosen = cast("Any", numba.config).CACHE_DIR
    if chosen and Path(folder).is_relative_to(chosen) and _has_kernels(folder):
        return
    Path(folder).mkdir(parents=True, exist_ok=True)
    tempfile.TemporaryFile(dir=folder).close()


def _check_folder_of(locator: Any) -> None:
    """Numba's check of a folder, but once per folder instead of once per kernel."""
    _check_folder(locator.get_cache_path())


cast("Any", caching)._CacheLocator.ensure_cache_path = _check_folder_of
cast("Any", caching).CacheImpl._locator_classes.append(_ShippedLocator)
