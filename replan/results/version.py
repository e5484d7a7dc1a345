"""The version of replan; this module imports nothing that takes time."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version


def replan_version() -> str:
    """The installed version of replan."""
    try:
        return version("replan")
    except PackageNotFoundError:
        return "not installed"
