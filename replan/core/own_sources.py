"""Where the source files of replan are."""

from __future__ import annotations

from pathlib import Path

PACKAGE = Path(__file__).parents[1]
"""The folder of the package `replan`."""
BESIDE = ("logs", "metrics", "planners", "replay")
"""The subpackages that lie at the top of the repository: in a clone beside the folder `replan`,
installed inside it.
"""


def own_folders() -> tuple[Path, ...]:
    """Return the folders that hold the modules of replan: one where it is installed, more in a
    clone.
    """
    return (PACKAGE, *(PACKAGE.parent / name for name in BESIDE if not (PACKAGE / name).is_dir()))
