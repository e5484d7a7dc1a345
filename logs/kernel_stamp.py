"""What the machine code of a kernel depends on, as a hash: its code, the kernels that it calls, constants of modules.

Numba asks a kernel's own file only. But the kernels that it calls are compiled into it, and so are the values of the
modules' constants: when those change, code on disk that was kept for the unchanged file would go on computing with the
old ones, in a cache that outlives an installation just as in a checkout.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from enum import Enum
from functools import cache
from glob import escape
from hashlib import sha256
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np
from numba.core.caching import IndexDataCacheFile
from numba.core.dispatcher import Dispatcher

from replan.own import PACKAGES

_WORD = re.compile(r"[A-Za-z_]\w*")


@cache
def stamp(kernel: Any) -> str:
    """SHA-256 of all that the machine code of a kernel (a dispatcher of numba's) depends on, hexadecimal."""
    digest = sha256(repr(sorted(kernel.targetoptions.items())).encode())
    for part in _parts(kernel.py_func, {kernel}):
        digest.update(f"{part}\n".encode())
    return digest.hexdigest()


def _parts(function: FunctionType, seen: set[Any]) -> Iterator[str]:
    """A function's code, and what its global names stand for; kernels in `seen` are left out, and added to it."""
    yield f"{function.__module__}.{function.__qualname__} {_said(function.__defaults__)}"  # it is loaded from there
    yield from (_said(each) for each in _hinted(function.__annotations__, function.__globals__))
    for code in _codes(function.__code__):
        yield f"{code.co_code.hex()} {code.co_names} {code.co_varnames} {[_said(c) for c in code.co_consts]}"
        for value in _named(code, function.__globals__):
            if not isinstance(value, Dispatcher):
                yield _said(value)
            elif value not in seen:
                seen.add(value)
                yield from _parts(value.py_func, seen)


def _codes(code: CodeType) -> Iterator[CodeType]:
    """A code object, and those in it (comprehensions)."""
    yield code
    for each in code.co_consts:
        if isinstance(each, CodeType):
            yield from _codes(each)


def _named(code: CodeType, names: dict[str, Any]) -> Iterator[Any]:
    """What the global names of a code stand for, and attributes of modules of ours."""
    found = [names[name] for name in code.co_names if name in names]
    yield from found
    for module in found:
        if isinstance(module, ModuleType) and module.__name__.partition(".")[0] in PACKAGES:
            yield from (vars(module)[name] for name in code.co_names if name in vars(module))


def _hinted(hints: dict[str, Any], names: dict[str, Any]) -> Iterator[type]:
    """The classes that annotations name: a kernel's machine code has the places of their fields."""
    for hint in hints.values():
        said = getattr(hint, "__forward_arg__", hint)
        found = [names.get(word) for word in _WORD.findall(said)] if isinstance(said, str) else [said]
        yield from (each for each in found if isinstance(each, type))


def _said(value: Any) -> str:
    """A value in words that change where it does, and are the same in every process."""
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {value.tobytes().hex()}"
    if isinstance(value, frozenset):
        return f"frozenset {sorted(map(_said, value))}"
    if isinstance(value, tuple):
        return f"{getattr(value, '_fields', '')}({', '.join(map(_said, value))})"
    if isinstance(value, Enum):  # also of whole numbers
        return f"{type(value).__qualname__}.{value.name} {value.value!r}"
    if isinstance(value, type):
        return f"{value.__module__}.{value.__qualname__} {_held(value)}"
    if value is None or isinstance(value, bool | int | float | complex | str | bytes):
        return repr(value)
    return f"{type(value).__qualname__} {getattr(value, '__name__', '')}"


def _held(cls: type) -> str:
    """What a class of constants or a named tuple holds, in words; "": it is another."""
    if issubclass(cls, Enum):
        return str([_said(member) for member in cls])
    fields = getattr(cls, "_fields", None)
    if fields is None:
        return ""
    within = _hinted(getattr(cls, "__annotations__", {}), vars(sys.modules[cls.__module__]))
    return f"{fields} {_said(tuple(cls._field_defaults.values()))} {[*map(_said, within)]}"  # type: ignore[attr-defined]


class KernelIndex(IndexDataCacheFile):
    """Numba's index of a kernel's machine code on disk, which is fresh where `stamp` is the same.

    A file of machine code is named by all that it is for. Numba numbers the files of a kernel: where two processes
    compile it at once for different arguments, the one's code may end under the other's number, and is run as that.

    What its folder does not have may lie beside the source, where a wheel brought it.
    """

    def __init__(self, kernel: Any, folder: str | None = None) -> None:
        self._kernel = kernel
        numbas = kernel._cache._cache_file
        self._base = numbas._index_name.removesuffix(".nbi")
        super().__init__(folder or numbas._cache_path, self._base, "")  # type: ignore[no-untyped-call]
        beside = str(Path(kernel.py_func.__code__.co_filename).parent / "__pycache__")
        self._beside = None if beside == self._cache_path else KernelIndex(kernel, beside)

    def load(self, key: Any) -> Any:
        """The machine code of one kind of arguments, as numba kept it; None: there is none."""
        try:
            found = super().load(key)  # type: ignore[no-untyped-call]
        except ModuleNotFoundError:  # the module of a kernel that was compiled into it has moved since
            found = None
        return self._beside.load(key) if found is None and self._beside else found

    def holds(self, processor: Any) -> bool:
        """Whether there is any for a processor (numba's `magic_tuple`)."""
        kept = self._load_index()
        return any(key[1] == processor for key in kept) or (self._beside is not None and self._beside.holds(processor))

    def _load_index(self) -> Any:
        try:
            return super()._load_index()  # type: ignore[no-untyped-call]
        except (ImportError, AttributeError):  # an older replan wrote it: a class that it names has moved
            return {}

    def save(self, key: Any, data: Any) -> None:
        """Keep the machine code of one kind of arguments; what is kept of another `stamp` is removed."""
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
        return stamp(self._kernel)  # asked when it is first used: by then all that it calls is there

    @_source_stamp.setter
    def _source_stamp(self, _: object) -> None:
        """Numba's own is not asked."""
