"""Links to the packages of a clone under their names: `python .ci/links.py`, as `./dev test` does.

`replan.logs` is the folder `logs`, and so on ([tool.setuptools.package-dir]). Python finds them by
the installation. Tools that do not import (mypy, import-linter, editors) find them in build/ns;
tests find `studies` in build/studies, and nothing else of the repository's top.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def link(root: Path, into: Path) -> None:
    """Make the links to the packages of a clone below a folder, and remove links to what is
    gone.
    """
    config = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))
    folders = config["tool"]["setuptools"]["package-dir"]
    places = {
        into / "ns" / "studies": root / "studies",
        into / "studies" / "studies": root / "studies",
    }
    into = into / "ns"
    for package, folder in folders.items():
        if "." in package:
            places[into / package.replace(".", "/")] = root / folder
        else:
            places |= {into / package / member.name: member for member in (root / folder).iterdir()}
    for old in (
        link for folder in (into, into / "replan") if folder.is_dir() for link in folder.iterdir()
    ):
        if old.is_symlink() and places.get(old) != old.readlink():
            old.unlink()
    for place, source in places.items():
        place.parent.mkdir(parents=True, exist_ok=True)
        if not place.is_symlink() and not place.name.startswith("__pycache__"):
            place.symlink_to(source)


if __name__ == "__main__":
    link(ROOT, ROOT / "build")
