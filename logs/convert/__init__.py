"""Other formats -> Scenario, one file each."""

from collections.abc import Callable

from logs.convert.commonroad import read_commonroad
from logs.scenario import Scenario

CONVERTERS: dict[str, Callable[..., Scenario]] = {"commonroad": read_commonroad}
"""Readers by the name of their format; called as `reader(path, **options)`, they raise LogError."""

__all__ = ["CONVERTERS", "read_commonroad"]
