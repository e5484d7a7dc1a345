"""Our packages before all others of their names: these are common ones, and a user's `metrics.py` may lie nearby.

Python searches the folder of a script, or the working directory, before installed packages. So whatever of replan is
imported first puts a finder before all others that gives `logs`, `metrics`, `planners` and `replay` from where this
package lies. A remaining clash is reported in one message with both files and the remedy.

It stands beside the public names, and imports nothing of ours: all four packages begin with it.
"""

from __future__ import annotations

import re
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
            raise ImportError(f"{clash(name, theirs)}, or `import replan` before it", name=name, path=theirs)
    if not any(type(finder).__name__ == OwnPackages.__name__ for finder in sys.meta_path):
        sys.meta_path.insert(0, OwnPackages())


def rival(package: str, member: str) -> str:
    """The file or folder in the Python path with a package's name that seems to have a member; "" if there is none.

    A folder has the modules in it; a file has the names in its text.
    """
    name = member.partition(".")[0]
    for folder in (Path(entry or ".").resolve() for entry in sys.path):
        for file in (folder / package / "__init__.py", folder / f"{package}.py", folder / package):
            if folder == ROOT or not file.exists():
                continue
            inside = file if file.is_dir() else file.parent / package
            text = file.read_text(encoding="utf-8", errors="replace") if file.is_file() else ""
            if any((inside / each).exists() for each in (name, f"{name}.py")) or re.search(
                rf"\b{name}\b|import \*", text
            ):
                return str(file)
    return ""


def clash(package: str, theirs: str) -> str:
    """The error message about a file of the user with the name of a package of replan."""
    ours = ROOT / package / "__init__.py"
    says = f"'{package}' is the name of a package of replan ({ours})"
    return f"{says}: yours ({theirs}) cannot be imported beside it; rename yours"


def is_clash(error: BaseException) -> bool:
    """Whether an error was raised here, because of a file of the user with the name of a package of replan."""
    if not isinstance(error, ImportError) or error.name not in PACKAGES or error.path is None:
        return False
    return not Path(error.path).is_relative_to(ROOT)


def missing(package: str) -> Callable[[str], Any]:
    """The `__getattr__` of a package: if a file of its name has what is missing, the error names both files."""

    def lacking(name: str) -> Any:
        own = ROOT / package / name
        known = name.startswith("__") or own.is_dir() or own.with_suffix(".py").is_file()
        theirs = "" if known else rival(package, name)
        if theirs:
            raise ImportError(f"no '{name}' in '{package}': {clash(package, theirs)}", name=package, path=theirs)
        raise AttributeError(f"module '{package}' has no attribute {name!r}")

    return lacking


first()
