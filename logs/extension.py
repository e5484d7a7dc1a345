"""One loader for what users add by name: planners, metrics, vehicles, controllers, readers ... (docs/extend.md).

A thing of a kind is named as

    NAME           of the kind's own table, or of an entry point of the group `replan.KINDS` ("replan.controllers")
    module:NAME    of a module in the Python path, which is searched for in the working directory last
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache, reduce
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Generic, TypeVar

from logs.errors import ConfigError, PlannerError, raised, unknown_name
from replan.own import PACKAGES, clash, rival

T = TypeVar("T")


def a_callable(thing: object) -> str:
    """Why a thing cannot serve as a factory or function; "": it can."""
    return "" if callable(thing) else f"is a {type(thing).__name__}, which cannot be called"


def an_instance(cls: type, called: str) -> Callable[[object], str]:
    """A check that a value is an instance of a class, which users import as `called`."""
    return lambda thing: "" if isinstance(thing, cls) else f"is a {type(thing).__name__}, not a {called}"


@dataclass(frozen=True, eq=False)
class Kind(Generic[T]):
    """A kind of things that are found by name.

    Attributes:
        name: In messages ("controller").
        plural: As `replan list` and the entry points' group have it ("controllers").
        builtin: The things that come with replan.
        wrong: What is wrong with what was found, in words that follow its name; "": nothing.
        error: What is raised where a module cannot be imported, or has no such thing.
        form: How one of the user's own is named.
        besides: Names that stand for no thing in a table.
    """

    name: str
    plural: str
    builtin: Mapping[str, T]
    wrong: Callable[[object], str] = a_callable
    error: type[ConfigError] | type[PlannerError] = ConfigError
    form: str = "module:NAME"
    besides: tuple[str, ...] = ()

    @property
    def group(self) -> str:
        """Of entry points."""
        return f"replan.{self.plural}"

    def find(self, spec: str, *, also: Iterable[str] = ()) -> T:
        """What the user named.

        Args:
            spec: A name of ours or of an entry point, or "module:NAME".
            also: Further names that the caller knows, for the error message about an unknown name.

        Raises:
            ConfigError: Nothing has this name, or two things have it.
            error: The module cannot be imported, or what it has of that name is no such thing.
        """
        if spec in self.builtin:
            return self.builtin[spec]
        module, name = self.place(spec, also=also)
        _search_here()
        try:
            loaded = import_module(module)
        except (Exception, SystemExit) as error:
            hint = "; install the package, or run from its folder, or set PYTHONPATH"
            hint = self._clash(error) or (hint if isinstance(error, ModuleNotFoundError) else "")
            raise self.error(f"{self.name} '{spec}' cannot be loaded: {raised(error)}{hint}") from error
        try:
            thing: Any = reduce(getattr, name.split("."), loaded)
        except (AttributeError, ImportError) as error:  # ImportError: `replan.own.missing`
            there, public = [], getattr(loaded, "__all__", None)
            for key, offered in vars(loaded).items():  # without `__all__`: its own, or imported under a name of its own
                imported = getattr(offered, "__module__", loaded.__name__) != loaded.__name__
                own = not key.startswith("_") and not (imported and getattr(offered, "__name__", "") == key)
                if (own if public is None else key in public) and not self.wrong(offered):
                    there.append(key)
            nearest = unknown_name(f"{self.name} in {loaded.__name__}", name, there)
            hint = self._clash(error) if rival(loaded.__name__) else ""
            raise self.error(f"{self.name} '{spec}': {nearest}{hint}") from None
        wrong = self.wrong(thing)
        if wrong:
            raise self.error(f"{self.name} '{spec}' {wrong}")
        return thing

    def place(self, spec: str, *, also: Iterable[str] = ()) -> tuple[str, str]:
        """Module and attribute of a thing that is not built in; ConfigError where `spec` names nothing."""
        if ":" not in spec:
            entries = self.entries()
            if spec not in entries:
                raise unknown_name(self.name, spec, [*self.builtin, *self.besides, *also, *entries, self.form])
            spec = f"{entries[spec].module}:{entries[spec].attr}"
        module, _, name = (part.strip() for part in spec.partition(":"))
        if not module or not name:
            raise ConfigError(f"{self.name} '{spec}': write it as {self.form}, for example my_package.mine:Mine")
        return module, name

    def entries(self) -> dict[str, EntryPoint]:
        """The entry points, by name; ConfigError where two have one name."""
        found: dict[str, EntryPoint] = {}
        for entry in _installed_entry_points(self.group, tuple(sys.path)):
            if entry.name in self.builtin or entry.name in found:
                raise ConfigError(
                    f"there are two {self.plural} called '{entry.name}'; rename or uninstall {entry.value}"
                )
            found[entry.name] = entry
        return found

    def installed(self) -> dict[str, T]:
        """What the entry points stand for, by name; errors as `find`."""
        return {name: self.find(name) for name in self.entries()}

    def names(self) -> tuple[str, ...]:
        """All names: ours, then those of entry points."""
        return (*self.builtin, *self.entries())

    def file(self, spec: str) -> Path | None:
        """The file of the module that has it; None: it is ours, or has no file."""
        if spec in self.builtin:
            return None
        _search_here()
        try:
            found = find_spec(self.place(spec)[0])
        except ImportError:
            return None
        return Path(found.origin) if found is not None and found.origin and Path(found.origin).is_file() else None

    def _clash(self, error: BaseException) -> str:
        """The hint where a package of replan was found in place of the user's; "": it was not."""
        of = error.name if isinstance(error, ImportError) else getattr(getattr(error, "obj", None), "__name__", "")
        package = str(of).partition(".")[0]
        program = " (or run the planner as a program of its own: exec:COMMAND)" if self.error is PlannerError else ""
        return f"; {clash(package, rival(package))}{program}" if package in PACKAGES else ""


@cache
def _installed_entry_points(group: str, path: tuple[str, ...]) -> tuple[EntryPoint, ...]:
    """The entry points of a group, by name; `path` is Python's, with which they change."""
    return tuple(sorted(entry_points(group=group), key=lambda each: (each.name, each.value)))


def _search_here() -> None:
    """Search the working directory, last."""
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)
