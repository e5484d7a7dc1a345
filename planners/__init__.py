"""Planners: Frame -> Plan.

    PLANNERS        the planners by name; a new one needs one file and one line here
    load_planner    "name" | "module:Class" -> the planner's factory: factory(context, **config) -> Planner

To write your own, read `logs/frame.py` (the input of a planner) and `planners/constant_speed.py` (the template).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import replan.own
from logs.errors import ConfigError, PlannerError
from logs.extension import ExtensionKind
from planners.base import Planner
from planners.blind import Blind, Parked
from planners.constant_speed import ConstantSpeed
from planners.dp_qp import DpQp
from planners.idm import Idm
from planners.lattice import Lattice
from planners.pdm import Pdm

PlannerFactory = Callable[..., Planner]
"""Builds a planner: `factory(context, **config)`."""

PLANNERS: dict[str, PlannerFactory] = {
    "dp_qp": DpQp,
    "lattice": Lattice,
    "idm": Idm,
    "pdm": Pdm,
    "constant_speed": ConstantSpeed,
    "blind": Blind,
    "parked": Parked,
}
"""The planners by the names that `--planner` takes."""


def _wrong(thing: object) -> str:
    """Describe why an object cannot build planners; empty if it can."""
    fits = callable(thing) and (not isinstance(thing, type) or callable(getattr(thing, "plan", None)))
    return "" if fits else "is not a planner: it needs a method plan(frame) -> Plan"


PLANNER: ExtensionKind[PlannerFactory] = ExtensionKind(
    "planner", "planners", PLANNERS, _wrong, PlannerError, "module:Class"
)
"""Finds planners by name: the built-in ones and those of users."""


def load_planner(spec: str, *, also: Iterable[str] = ()) -> PlannerFactory:
    """Load the factory of a planner.

    Args:
        spec: A name in PLANNERS, the name of an entry point, or "module:Class".
        also: Further names that the caller knows, for the error message about an unknown name.

    Raises:
        ConfigError: No planner has this name.
        PlannerError: The module cannot be imported, or has no such planner.
    """
    if spec.partition(":")[0] in ("exec", "tcp"):
        raise ConfigError(f"planner '{spec}': write exec:COMMAND or tcp://HOST:PORT; neither is loaded into Python")
    return PLANNER.find(spec, also=also)


if not TYPE_CHECKING:  # a type checker would accept any name as a member of this package
    __getattr__ = replan.own.missing("planners")
