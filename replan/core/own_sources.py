"""Where the source files of replan are, and under which name they may be imported."""

from __future__ import annotations

from pathlib import Path

PACKAGE = Path(__file__).parents[1]
"""The folder of the package `replan`."""
BESIDE = ("logs", "metrics", "planners", "replay")
"""The subpackages that lie at the top of the repository: in a clone beside the folder `replan`, installed inside it."""


def own_folders() -> tuple[Path, ...]:
    """Return the folders that hold the modules of replan: one where it is installed, more in a clone."""
    return (PACKAGE, *(PACKAGE.parent / name for name in BESIDE if not (PACKAGE / name).is_dir()))


def refuse_copy(name: str, package: str) -> None:
    """Raise ImportError if a package is imported under another name.

    In the root of a clone Python finds the folder `logs` as `logs`; that would give every class of `replan.logs` twice.
    """
    if name != package:
        raise ImportError(f"this folder is the package {package}: write `import {package}`", name=name)
