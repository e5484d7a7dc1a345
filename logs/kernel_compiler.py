"""Changes of numba's compiler that leave out work of which the result is not used.

Numba optimises each compiled function and generates machine code for it. A function that only compiled functions call
does not need this: LLVM links its code into its callers. Such functions are numba's own (`np.empty` and so on), which
each process compiles again, and ours that `logs.kernel.inner_kernel` marks. Changes:

1. A function is optimised and gets machine code only when Python needs its address.
2. A function without a wrapper for Python has none for C either.
3. LLVM's passes over single functions are left out, because its passes over the module repeat them.
4. Compiler options, which are part of each key of numba's caches of types, are compared by those that were set.
5. Numba reports no event when it enters or leaves LLVM, some 300,000 times: there is no listener.
6. The variables of an instruction are not searched in its numbers, names and source locations.

Together they save more than a fifth of the time. Results do not depend on them: LLVM may not reorder floating-point
arithmetic.
"""

from __future__ import annotations

from typing import Any, cast

import numba
from numba.core import base, codegen, environment, ir, targetconfig, typed_passes

KNOWN = ((0, 61), (0, 68))
"""The first and last version of numba whose internals are changed here; others are left as they are."""

LINKED = "linked"
"""The kind of stored code that was not finalized; numba's own are "object" and "bitcode"."""

llvm: Any = cast("Any", codegen).ll
_Library: Any = codegen.JITCodeLibrary
_Generator: Any = codegen.JITCPUCodegen
_Lowering: Any = typed_passes.BaseNativeLowering
_Options: Any = targetconfig.TargetConfig
_lookup: Any = environment.lookup_environment


class KernelLibrary(_Library):  # type: ignore[misc]
    """The code of one compiled function: linked with what it calls, and finalized when its address is needed."""

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

        Numba loads the address of each called Python object and does not use it; code with such an address, which is
        valid in this process only, cannot be stored.
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
        """Only link: of numba's methods that call this, `get_pointer_to_function` alone needs machine code."""
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
        return any(each.name.startswith("numba.dynamic.globals") for each in self._final_module.global_variables)

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout

    def _finalize_specific(self) -> None:
        super()._finalize_specific()
        for name in [each.name for each in self._final_module.global_variables]:
            if (held := _lookup(name)) is not None:  # that of a function that was linked in
                self._codegen.set_env(name, held)

    def serialize_using_object_code(self) -> Any:
        """The name, the kind and the code to store: machine code if there is any, otherwise LLVM's, for callers."""
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
    """Numba's lowering pass: without a wrapper for C where there is none for Python, but for callbacks in C."""
    if state.flags.no_cpython_wrapper and not state.flags.no_compile:
        state.flags = state.flags.copy()
        state.flags.no_cfunc_wrapper = True
    return _run_pass(lowering, state)


def _same_options(one: Any, other: Any) -> Any:
    """Numba's comparison of compiler options, of those that were set on either side: the others have their defaults."""
    if not isinstance(other, _Options):
        return NotImplemented
    if type(one) is not type(other):
        return one.values() == other.values()
    ours, theirs, options = one._values, other._values, type(one).options
    return ours == theirs or all(
        ours.get(name, options[name].default) == theirs.get(name, options[name].default)
        for name in {**ours, **theirs}
    )  # fmt: skip


def _variables(instruction: Any, value: Any) -> Any:
    """Numba's search for the variables in a part of an instruction; names, numbers and source locations have none."""
    if isinstance(value, _PLAIN):
        return []
    return [value] if type(value) is ir.Var else _rec_list_vars(instruction, value)


def _drop_events() -> None:
    """Remove numba's callbacks from LLVM's lock, unless they are recorded (`NUMBA_CHROME_TRACE`)."""
    callbacks = llvm.ffi.lib._lock._cblist
    if not cast("Any", numba.config).CHROME_TRACE:
        callbacks[:] = [each for each in callbacks if each[0].__module__ != base.__name__]


_set_env, _run_pass, _rec_list_vars = _Generator.set_env, _Lowering.run_pass, cast("Any", ir.Inst)._rec_list_vars
_PLAIN = (str, int, float, type(None), ir.Loc)


def compile_less() -> None:
    """Change numba, for this process and before it compiles anything, if its version is one that is known."""
    if KNOWN[0] <= numba.version_info[:2] <= KNOWN[1]:
        _Generator._library_class = KernelLibrary
        _Generator.set_env = _set_environment
        _Lowering.run_pass = _lower
        _Options.__eq__ = _same_options
        _Options.__hash__ = lambda options: hash(type(options))
        cast("Any", ir.Inst)._rec_list_vars = _variables
        _drop_events()
