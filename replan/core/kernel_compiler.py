"""The compilation of kernels with numba: work that is left out, and the cache of machine code on
disk.

Changes of numba's compiler leave out work of which the result is not used. It optimises each
compiled function and generates machine code for it. A function that only compiled functions call
does not need this: LLVM links its code into its callers. Such functions are numba's own (`np.empty`
and so on), which each process compiles again, and ours that `replan.core.kernel.inner_kernel`
marks. Changes:

1. A function is optimised and gets machine code only when Python needs its address.
2. A function without a wrapper for Python has none for C either.
3. LLVM's passes over single functions are left out, because its passes over the module repeat them.
4. Compiler options, which are part of each key of numba's caches of types, are compared by those
that were set.
5. Numba reports no event when it enters or leaves LLVM, some 300,000 times: there is no listener.
6. The variables of an instruction are not searched in its numbers, names and source locations.

Together they save more than a fifth of the time. Results do not depend on them: LLVM may not
reorder floating-point arithmetic.

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
from numba.core import base, caching, codegen, environment, ir, targetconfig, typed_passes
from numba.core.caching import IndexDataCacheFile
from numba.core.dispatcher import Dispatcher

KNOWN = ((0, 61), (0, 68))
"""The first and last version of numba whose internals are changed here.

Others are left as they are.
"""

LINKED = "linked"
"""The kind of stored code that was not finalized; numba's own are "object" and "bitcode"."""

llvm: Any = cast("Any", codegen).ll
_Library: Any = codegen.JITCodeLibrary
_Generator: Any = codegen.JITCPUCodegen
_Lowering: Any = typed_passes.BaseNativeLowering
_Options: Any = targetconfig.TargetConfig
_lookup: Any = environment.lookup_environment


class KernelLibrary(_Library):  # type: ignore[misc]
    """The code of one compiled function: linked with what it calls, and finalized when its address
    is needed.
    """

    _linked = False
    _linking_libraries: list[Any]

    def _link(self) -> None:
        """Link what the function calls into the module: once, at the first use."""
        if not self._linked:
            self._linked = True
            for library in dict.fromkeys(self._linking_libraries):
                self._reload_init.update(library._reload_init)
                self._final_module.link_in(library._get_module_for_linking(), preserve=True)
            self._linking_libraries = []
            self._tidy()

    def _tidy(self) -> None:
        """Remove dead code, so that less is linked into callers.

        Numba loads the address of each called Python object and does not use it; code with such an
        address, which is valid in this process only, cannot be stored.
        """
        passes, builder = llvm.create_new_module_pass_manager(), self._codegen._pass_builder()
        passes.add_sroa_pass()
        passes.add_simplify_cfg_pass()
        passes.add_dead_code_elimination_pass()
        passes.add_global_dead_code_eliminate_pass()
        passes.run(self._final_module, builder)

    def finalize(self) -> None:
        """Optimise, and generate machine code."""
        self._link()
        super().finalize()

    def _ensure_finalized(self) -> None:
        """Only link: of numba's methods that call this, `get_pointer_to_function` alone needs
        machine code.
        """
        self._link()

    def get_pointer_to_function(self, name: str) -> int:
        """The address of a function; 0 if the module does not define it."""
        self._link()
        if not self._finalized:
            if all(each.name != name for each in self.get_defined_functions()):
                return 0
            self.finalize()
        return cast("int", super().get_pointer_to_function(name))

    @property
    def has_dynamic_globals(self) -> bool:
        """Whether it contains addresses of this process, so that it cannot be stored."""
        self._link()
        return any(
            each.name.startswith("numba.dynamic.globals")
            for each in self._final_module.global_variables
        )

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout

    def _finalize_specific(self) -> None:
        super()._finalize_specific()
        for name in [each.name for each in self._final_module.global_variables]:
            if (held := _lookup(name)) is not None:  # that of a function that was linked in
                self._codegen.set_env(name, held)

    def serialize_using_object_code(self) -> Any:
        """The name, the kind and the code to store: machine code if there is any, otherwise LLVM's,
        for callers.
        """
        self._link()
        if self._finalized:
            return super().serialize_using_object_code()
        return self.name, LINKED, self._final_module.as_bitcode()

    @classmethod
    def _unserialize(cls, generator: Any, state: Any) -> Any:
        name, kind, data = state
        if kind == LINKED:
            made = generator.create_library(name)
            made._final_module = llvm.parse_bitcode(data)
        else:
            made = super()._unserialize(generator, state)
        made._linked = True
        return made


def _set_environment(generator: Any, name: str, environment: Any) -> None:
    """Numba's `set_env`, for functions with machine code."""
    if generator._engine.is_symbol_defined(name):
        _set_env(generator, name, environment)


def _lower(lowering: Any, state: Any) -> Any:
    """Numba's lowering pass: without a wrapper for C where there is none for Python, but for
    callbacks in C.
    """
    if state.flags.no_cpython_wrapper and not state.flags.no_compile:
        state.flags = state.flags.copy()
        state.flags.no_cfunc_wrapper = True
    return _run_pass(lowering, state)


def _same_options(one: Any, other: Any) -> Any:
    """Numba's comparison of compiler options, of those that were set on either side: the others
    have their defaults.
    """
    if not isinstance(other, _Options):
        return NotImplemented
    if type(one) is not type(other):
        return one.values() == other.values()
    ours, theirs, options = one._values, other._values, type(one).options
    return ours == theirs or all(
        ours.get(name, options[name].default) == theirs.get(name, options[name].default)
        for name in {**ours, **theirs}
    )


def _variables(instruction: Any, value: Any) -> Any:
    """Numba's search for the variables in a part of an instruction.

    Names, numbers and source locations have none.
    """
    if isinstance(value, _PLAIN):
        return []
    return [value] if type(value) is ir.Var else _rec_list_vars(instruction, value)


def _drop_events() -> None:
    """Remove numba's callbacks from LLVM's lock, unless they are recorded
    (`NUMBA_CHROME_TRACE`).
    """
    callbacks = llvm.ffi.lib._lock._cblist
    if not cast("Any", numba.config).CHROME_TRACE:
        callbacks[:] = [each for each in callbacks if each[0].__module__ != base.__name__]


_set_env, _run_pass, _rec_list_vars = (
    _Generator.set_env,
    _Lowering.run_pass,
    cast("Any", ir.Inst)._rec_list_vars,
)
_PLAIN = (str, int, float, type(None), ir.Loc)


def compile_less() -> None:
    """Change numba, for this process and before it compiles anything, if its version is one that is
    known.
    """
    if KNOWN[0] <= numba.version_info[:2] <= KNOWN[1]:
        _Generator._library_class = KernelLibrary
        _Generator.set_env = _set_environment
        _Lowering.run_pass = _lower
        _Options.__eq__ = _same_options
        _Options.__hash__ = lambda options: hash(type(options))
        cast("Any", ir.Inst)._rec_list_vars = _variables
        _drop_events()


# Cache of machine code

_WORD = re.compile(r"[A-Za-z_]\w*")
_LINE = re.compile(r"-\d+(?=\.py\d+)")
"""The line number in numba's names of files ("shapes.corners-142.py311")."""


@cache
def stamp(kernel: Any) -> str:
    """Return the SHA-256, in hexadecimal, of all inputs of the machine code of a kernel (a numba
    dispatcher).
    """
    digest = sha256(f"{LINKED} {sorted(kernel.targetoptions.items())!r}".encode())
    for part in _parts_of_kernel(kernel.py_func, {kernel}):
        digest.update(f"{part}\n".encode())
    return digest.hexdigest()


def _parts_of_kernel(function: FunctionType, seen: set[Any]) -> Iterator[str]:
    """Yield a function's code and the values of its globals.

    Kernels in `seen` are skipped, new ones added.
    """
    # numba finds machine code by this name
    yield f"{function.__module__}.{function.__qualname__} {_as_text(function.__defaults__)}"
    yield from (
        _as_text(each) for each in _hinted_classes(function.__annotations__, function.__globals__)
    )
    for code in _codes(function.__code__):
        said = function.__doc__
        constants = [_as_text(None if said and each == said else each) for each in code.co_consts]
        yield f"{code.co_code.hex()} {code.co_names} {code.co_varnames} {constants}"
        held = [
            function.__globals__[name] for name in code.co_names if name in function.__globals__
        ]
        ours = [
            each
            for each in held
            if isinstance(each, ModuleType) and each.__name__.partition(".")[0] == "replan"
        ]
        attributes = (
            vars(each)[name] for each in ours for name in code.co_names if name in vars(each)
        )
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
    """Yield the classes in annotations: a kernel's machine code depends on the layout of their
    fields.
    """
    for hint in hints.values():
        text = getattr(hint, "__forward_arg__", hint)
        found = (
            [names.get(word) for word in _WORD.findall(text)] if isinstance(text, str) else [text]
        )
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
            within = _hinted_classes(
                getattr(value, "__annotations__", {}), vars(sys.modules[value.__module__])
            )
            defaults = tuple(value._field_defaults.values())  # type: ignore[attr-defined]
            held = f"{columns} {_as_text(defaults)} {[*map(_as_text, within)]}"
        return f"{value.__module__}.{value.__qualname__} {held}"
    if value is None or isinstance(value, bool | int | float | complex | str | bytes):
        return repr(value)
    return f"{type(value).__qualname__} {getattr(value, '__name__', '')}"


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
        return any(key[1] == processor for key in kept) or (
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
        kept = self._load_index()
        if not kept:
            self._clear()
        kept[key] = (
            f"{self._base}.{sha256(f'{self._source_stamp} {key!r}'.encode()).hexdigest()[:16]}.nbc"
        )
        self._save_data(kept[key], data)  # type: ignore[no-untyped-call]
        self._save_index(kept)  # type: ignore[no-untyped-call]

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
        if next(Path(self.get_cache_path()).glob("*.nbi"), None) is None:  # type: ignore[no-untyped-call]
            raise FileNotFoundError


@cache
def _check_folder(folder: str) -> None:
    """Create the folder for machine code; OSError if it is not usable.

    It must be writable. A `NUMBA_CACHE_DIR` that holds kernels need only be readable (a read-only
    container image).
    """
    chosen = cast("Any", numba.config).CACHE_DIR
    if (
        chosen
        and Path(folder).is_relative_to(chosen)
        and next(Path(folder).glob("*.nbi"), None) is not None
    ):
        return
    Path(folder).mkdir(parents=True, exist_ok=True)
    tempfile.TemporaryFile(dir=folder).close()


cast("Any", caching)._CacheLocator.ensure_cache_path = lambda self: _check_folder(
    self.get_cache_path()
)
"""Numba's check, but once per folder instead of once per kernel."""
cast("Any", caching).CacheImpl._locator_classes.append(_ShippedLocator)
