"""What to drive: Frame -> Plan.

    PLANNERS        the planners by name; adding one is one file and one line here
    load_planner    "name" | "module:Class" -> what builds the planner: factory(context, **config) -> Planner

To write your own, read `logs/frame.py` (what a planner is given) and `planners/constant_speed.py` (the template).
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from types import ModuleType

from logs.errors import ConfigError, PlannerError, unknown_name
from planners.base import Planner
from planners.constant_speed import ConstantSpeed
from planners.dp_qp import DpQp
from planners.idm import Idm
from planners.lattice import Lattice

PlannerFactory = Callable[..., Planner]
"""Builds a planner: `factory(context, **config)`."""

PLANNERS: dict[str, PlannerFactory] = {
    "dp_qp": DpQp,
    "lattice": Lattice,
    "idm": Idm,
    "constant_speed": ConstantSpeed,
}
"""The planners by the names that `--planner` takes."""

OWN_PACKAGES = ("logs", "metrics", "planners", "replay")
"""Names that a user's own package cannot have beside ours."""


def load_planner(spec: str, *, also: Iterable[str] = ()) -> PlannerFactory:
    """What builds the planner that the user named.

    Args:
        spec: A name in PLANNERS, or "module:Class"; the module is looked for in the Python path and then in the
            working directory.
        also: Names that the caller knows besides, for the message where `spec` is no name at all.

    Raises:
        ConfigError: No planner has this name.
        PlannerError: The module cannot be imported, or has no such planner.
    """
    if spec in PLANNERS:
        return PLANNERS[spec]
    module_name, separator, class_name = spec.partition(":")
    if module_name in ("exec", "tcp"):
        raise ConfigError(f"planner '{spec}': write exec:COMMAND or tcp://HOST:PORT; no such is loaded into Python")
    if not separator:
        raise unknown_name("planner", spec, [*PLANNERS, *also, "module:Class"])
    if not module_name or not class_name:
        raise ConfigError(f"planner '{spec}': write it as module:Class, for example my_package.mine:MyPlanner")
    return _planner_class(spec, _imported(spec, module_name), class_name)


def _imported(spec: str, module_name: str) -> ModuleType:
    """The user's module; whatever importing it raises becomes one line."""
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)
    try:
        return importlib.import_module(module_name)
    except ImportError as error:
        package = (error.name or "").partition(".")[0]
        if package in OWN_PACKAGES:
            raise PlannerError(
                f"planner '{spec}': {error}; '{package}' is the name of a package of replan, so a package of yours"
                f" with that name cannot be imported beside it: rename yours"
                f" (or run the planner as a program of its own: exec:COMMAND)"
            ) from error
        raise PlannerError(
            f"planner '{spec}': {error}; install the package, or run from its folder, or set PYTHONPATH"
        ) from error
    except Exception as error:
        raise PlannerError(
            f"planner '{spec}': importing {module_name} raised {type(error).__name__}: {' '.join(str(error).split())}"
        ) from error


def _planner_class(spec: str, module: ModuleType, class_name: str) -> PlannerFactory:
    factory = getattr(module, class_name, None)
    if factory is None:
        candidates = [name for name, value in vars(module).items() if hasattr(value, "plan")]
        raise PlannerError(f"planner '{spec}': {unknown_name(f'planner in {module.__name__}', class_name, candidates)}")
    if not callable(factory) or (isinstance(factory, type) and not callable(getattr(factory, "plan", None))):
        raise PlannerError(f"planner '{spec}': {class_name} is no planner: it needs a method plan(frame) -> Plan")
    loaded: PlannerFactory = factory
    return loaded
