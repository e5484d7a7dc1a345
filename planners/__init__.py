"""What to drive: Frame -> Plan.

    PLANNERS        the planners by name; adding one is one file and one line here
    load_planner    "name" | "module:Class" -> what builds the planner: factory(context, **config) -> Planner

To write your own, read `logs/frame.py` (what a planner is given) and `planners/constant_speed.py` (the template).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING

import replan.own
from logs.errors import ConfigError, PlannerError
from logs.extension import Kind
from planners.base import Planner
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
}
"""The planners by the names that `--planner` takes."""


def _wrong(thing: object) -> str:
    """What is wrong with a planner's factory."""
    fits = callable(thing) and (not isinstance(thing, type) or callable(getattr(thing, "plan", None)))
    return "" if fits else "is no planner: it needs a method plan(frame) -> Plan"


PLANNER: Kind[PlannerFactory] = Kind("planner", "planners", PLANNERS, _wrong, PlannerError, "module:Class")
"""Those of ours, and of users."""


def load_planner(spec: str, *, also: Iterable[str] = ()) -> PlannerFactory:
    """The factory of the planner that the user named.

    Args:
        spec: A name in PLANNERS or of an entry point, or "module:Class".
        also: Further names that the caller knows, for the error message about an unknown name.

    Raises:
        ConfigError: No planner has this name.
        PlannerError: The module cannot be imported, or has no such planner.
    """
    if spec.partition(":")[0] in ("exec", "tcp"):
        raise ConfigError(f"planner '{spec}': write exec:COMMAND or tcp://HOST:PORT; neither is loaded into Python")
    return PLANNER.find(spec, also=also)


if not TYPE_CHECKING:  # a type checker would take any name for one of ours
    __getattr__ = replan.own.missing("planners")
