"""Loads planners, metrics, vehicles, controllers, readers ... by name, those of users included
(docs/extend.md).

An extension of a kind is named as

    NAME           a built-in one, or an entry point of the group `replan.KINDS`
                   ("replan.controllers")
    module:NAME    an attribute of a module

A module is looked for in Python's path, in its order, then in the working directory:

1. beside the script, where a script calls replan; the command line skips this
2. PYTHONPATH
3. the standard library and installed packages
4. the working directory

Processes of planners, workers and notebooks search the same places. The working directory comes
last, so that no file in it hides a library that replan imports.
"""

from __future__ import annotations

import signal
import sys
import sysconfig
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, reduce
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, TypeVar

from replan.core.errors import ConfigError, PlannerError, raised, unknown_name
from replan.core.former_names import present_name

T = TypeVar("T")


def a_callable(thing: object) -> str:
    """Return why an object cannot be used as a factory or function; "" if it can."""
    return "" if callable(thing) else f"is a {type(thing).__name__}, which cannot be called"


def an_instance(cls: type, called: str) -> Callable[[object], str]:
    """Return a check that a value is an instance of a class; `called` is the name under which users
    import it.
    """

    def fault_of(thing: object) -> str:
        return "" if isinstance(thing, cls) else f"is a {type(thing).__name__}, not a {called}"

    return fault_of


@dataclass(frozen=True, eq=False)
class ExtensionKind(Generic[T]):
    """A kind of extension that is found by name."""

    name: str  # its name in messages ("controller")
    plural: str  # its name in `replan list` and in the group of entry points ("controllers")
    builtin: Mapping[str, T]  # the extensions that come with replan, by name
    # describes the fault of a loaded object, in words that follow its name; "": no fault
    fault_of: Callable[[object], str] = a_callable
    # exception to raise if a module cannot be imported or lacks the name
    error: type[ConfigError] | type[PlannerError] = ConfigError
    form: str = "module:NAME"  # how users name an extension of their own
    besides: tuple[str, ...] = ()  # further valid names, which are in no table

    @property
    def group(self) -> str:
        """The group of entry points."""
        return f"replan.{self.plural}"

    def find(self, spec: str) -> T:
        """Return the extension that the user named: built in, of an entry point, or "module:NAME".

        The working directory is added at the end of `sys.path`, and stays there.

        Raises:
            ConfigError: The name is unknown, or two extensions have it.
            error: The module cannot be imported, or its attribute of that name is not of this kind.
        """
        if spec in self.builtin:
            return self.builtin[spec]
        module, name = self.place(spec)
        _search_here()
        try:
            thing, fault = self._loaded(module, name)
        except BaseException as error:  # a module, its attributes, a lazy object may raise anything
            if _is_interruption(error):
                raise
            raise self.error(
                f"{self.name} '{spec}' cannot be loaded: {self._cause(error, module)}"
            ) from error
        if fault:
            raise self.error(f"{self.name} '{spec}'{fault}")
        return thing

    def _loaded(self, module: str, name: str) -> tuple[Any, str]:
        """Return the attribute of a module, and why it cannot be used ("" if it can)."""
        loaded = import_module(module)
        try:
            thing = reduce(getattr, name.split("."), loaded)
        except AttributeError:
            scope = f"{self.name} in {loaded.__name__}"
            return None, f": {unknown_name(scope, name, self._offered(loaded))}"
        fault = self.fault_of(thing)
        return thing, f" {fault}" if fault else ""

    def _offered(self, module: ModuleType) -> list[str]:
        """Return the extensions in a module: of `__all__`, else its own names, and imports under
        another name.
        """
        public = getattr(module, "__all__", None)
        if public is None:
            public = [name for name in vars(module) if _is_own(name, module)]
        return [
            name
            for name, thing in vars(module).items()
            if name in public and not self.fault_of(thing)
        ]

    def place(self, spec: str) -> tuple[str, str]:
        """Return module and attribute of an extension that is not built in; ConfigError if `spec`
        is unknown.
        """
        if ":" not in spec:
            entries = self.entries()
            if spec not in entries:
                raise unknown_name(
                    self.name, spec, [*self.builtin, *self.besides, *entries, self.form]
                )
            spec = f"{entries[spec].module}:{entries[spec].attr}"
        module, _, name = (part.strip() for part in spec.partition(":"))
        if not module or not name:
            raise ConfigError(
                f"{self.name} '{spec}': write it as {self.form}, for example my_package.mine:Mine"
            )
        return _present(module), name

    def entries(self) -> dict[str, EntryPoint]:
        """Return the entry points by name; ConfigError if two extensions have the same name."""
        by_name: dict[str, EntryPoint] = {}
        for entry in _installed_entry_points(self.group, tuple(sys.path)):
            if entry.name in self.builtin or entry.name in by_name:
                raise ConfigError(
                    f"there are two {self.plural} called '{entry.name}'; rename or uninstall "
                    f"{entry.value}"
                )
            by_name[entry.name] = entry
        return by_name

    def installed(self) -> dict[str, T]:
        """Return the objects of the entry points, by name; errors as in `find`."""
        return {name: self.find(name) for name in self.entries()}

    def names(self) -> tuple[str, ...]:
        """Return all names: the built-in ones, then those of entry points."""
        return (*self.builtin, *self.entries())

    def file(self, spec: str) -> Path | None:
        """Return the file of the module that defines it; None if it is built in or has no file."""
        if spec in self.builtin:
            return None
        _search_here()
        try:
            spec_of_module = find_spec(self.place(spec)[0])
        except ImportError:
            return None
        if spec_of_module is None or not spec_of_module.origin:
            return None
        origin = Path(spec_of_module.origin)
        return origin if origin.is_file() else None

    def _cause(self, error: BaseException, module: str) -> str:
        """Return why the user's module cannot be imported, and the remedy if a module is
        missing.
        """
        if not isinstance(error, ModuleNotFoundError) or not error.name:
            return raised(error)
        # The module itself is missing, not one that it imports
        if f"{module}.".startswith(f"{error.name}."):
            return (
                f"No module named '{error.name}' in {_places_tried(error.name)}; set PYTHONPATH "
                "or install its package"
            )
        if present_name(error.name):  # the error says it
            return raised(error)
        package, _, member = error.name.partition(".")
        return raised(error) + (
            "" if member else f"; install '{package}' for {sys.executable}, or set PYTHONPATH"
        )


def _is_own(name: str, module: ModuleType) -> bool:
    """Return whether a name of a module is public, and not that of a function or class which the
    module imports under its own name.
    """
    thing = vars(module)[name]
    if name.startswith("_"):
        return False
    if getattr(thing, "__module__", module.__name__) == module.__name__:
        return True
    return getattr(thing, "__name__", "") != name


def _is_interruption(error: BaseException) -> bool:
    """Return whether an exception may be that of a signal: one of the command line, or, with
    Python's own handler, any KeyboardInterrupt.
    """
    own_handler = signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    return isinstance(error, KeyboardInterrupt) and not (
        own_handler and type(error) is KeyboardInterrupt
    )


@cache
def _installed_entry_points(group: str, path: tuple[str, ...]) -> tuple[EntryPoint, ...]:
    """Return the entry points of a group, sorted by name; `path` (`sys.path`) is the key of the
    cache.
    """
    return tuple(sorted(entry_points(group=group), key=lambda entry: (entry.name, entry.value)))


def _search_here() -> None:
    """Search the working directory last."""
    directory = str(Path.cwd())
    if directory not in sys.path:
        sys.path.append(directory)


def _present(module: str) -> str:
    """Return the present name of a module of replan that has a former name, unless the
    user has one.
    """
    name = present_name(module)
    if not name:
        return module
    _search_here()
    try:
        return module if find_spec(module) else name
    except ModuleNotFoundError:
        return name


def _places_tried(module: str) -> str:
    """Return where a module was looked for, in order: the folders of its package, or those of the
    Python path.
    """
    package = sys.modules.get(module.rpartition(".")[0])
    if package is not None:
        return ", ".join(getattr(package, "__path__", [f"{package.__name__}, which is no package"]))
    library = tuple(sysconfig.get_path(name) for name in ("stdlib", "platstdlib"))
    places = (str(Path(entry).absolute()) for entry in sys.path if not entry.endswith(".zip"))
    packages = ("site-packages", "dist-packages")
    return ", ".join(
        place for place in places if not place.startswith(library) or place.endswith(packages)
    )
