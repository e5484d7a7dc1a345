"""The former names of modules, when `logs`, `metrics`, `planners` and `replay` were top-level
packages.

Files of that time name a built-in part by its module ("planners.idm:Idm"), and scripts import from
it.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.util import find_spec

from replan.core.own_sources import BESIDE


def present_name(module: str) -> str:
    """Return the present name of a module that had this one; "" if replan has none."""
    if module.partition(".")[0] not in BESIDE:
        return ""
    try:
        spec = find_spec(f"replan.{module}")
    except ImportError:  # its package is a module now, or gone
        return ""
    return f"replan.{module}" if spec else ""


class FormerNames(MetaPathFinder):
    """Finds nothing. Asked after all other finders, it adds the present name to the error of an
    import that fails.
    """

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: object = None
    ) -> None:
        """Return None; ModuleNotFoundError, with the remedy, for a former name of a module of
        replan.
        """
        name = present_name(fullname)
        if name:
            raise _error(fullname, name)


def explain_former_names() -> None:
    """Let failing imports of former names say the present ones.

    Imports that succeed are not touched.
    """
    if not any(isinstance(finder, FormerNames) for finder in sys.meta_path):
        sys.meta_path.append(FormerNames())


def refuse_copy(name: str, package: str) -> None:
    """Raise ModuleNotFoundError if a package of replan is imported under another name.

    In the root of a clone Python finds the folder `logs` as `logs`; that would give every class of
    `replan.logs` twice.
    """
    if name != package:
        raise _error(name, package)


def _error(former: str, present: str) -> ModuleNotFoundError:
    remedy = (
        f"it is '{present}' now; import its names from replan (from replan import Plan, Trajectory)"
    )
    return ModuleNotFoundError(f"No module named '{former}': {remedy}", name=former)
