"""CommonRoad XML -> Scenario; `logs.readers.commonroad` is its reader."""

from logs.convert.commonroad import read_commonroad

__all__ = ["read_commonroad"]
