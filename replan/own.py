"""Our packages before all others of their names: these are common ones, and a user's `metrics.py` may lie nearby.

Python searches the folder of a script, or the working directory, before installed packages. So whatever of replan is
imported first puts a finder before all others that gives `logs`, `metrics`, `planners` and `replay` from where this
package lies. A remaining clash is reported in one message with both files and the remedy.

It stands beside the public names, and imports nothing of ours: all four packages begin with it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("logs", "metrics", "planners", "replay")


class OwnPackages(MetaPathFinder):
    """Finds the packages of replan, and no others."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The place of a package of replan; None for any other name."""
        return PathFinder.find_spec(fullname, [str(ROOT)]) if fullname in PACKAGES else None


def first() -> None:
    """Make Python find the packages of replan before others with the same names.

    Raises:
        ImportError: Another of these names is imported already.
    """
    for name in PACKAGES:
        module = sys.modules.get(name)
        places = [] if module is None else [module.__file__ or "", *getattr(module, "__path__", ())]
        if module is not None and not any(Path(place).resolve().is_relative_to(ROOT / name) for place in places):
            theirs = next(filter(None, places), "in memory")
            raise ImportError(f"{clash(name, theirs)}, or `import replan` before it", name=name)
    if not any(type(finder).__name__ == OwnPackages.__name__ for finder in sys.meta_path):
        sys.meta_path.insert(0, OwnPackages())


def rival(package: str) -> str:
    """The file or folder in the Python path with the name of a package of replan; "" if there is none."""
    for folder in (Path(entry or ".").resolve() for entry in sys.path):
        for file in (folder / package / "__init__.py", folder / f"{package}.py", folder / package):
            if folder != ROOT and file.exists():
                return str(file)
    return ""


def clash(package: str, theirs: str) -> str:
    """The error message about a file of the user with the name of a package of replan."""
    ours = ROOT / package / "__init__.py"
    yours = f"yours ({theirs})" if theirs else "a package of yours with that name"
    says = f"'{package}' is the name of a package of replan ({ours})"
    return f"{says}: {yours} cannot be imported beside it; rename yours"


def missing(package: str) -> Callable[[str], Any]:
    """The `__getattr__` of a package: if the user has a file of the package's name, the error names both files."""

    def lacking(name: str) -> Any:
        theirs = "" if name.startswith("__") else rival(package)
        own = ROOT / package / name
        if theirs and not (own.is_dir() or own.with_suffix(".py").is_file()):
            raise ImportError(f"no '{name}' in '{package}': {clash(package, theirs)}", name=package)
        raise AttributeError(f"module '{package}' has no attribute {name!r}")

    return lacking


first()
