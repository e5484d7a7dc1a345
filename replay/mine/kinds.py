"""The table of event kinds, and its page in the documentation."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from logs.extension import Kind, an_instance
from replay.mine.conflicts import CONFLICTS
from replay.mine.ego_and_road import EGO_AND_ROAD
from replay.mine.events import EventKind
from replay.mine.road_users import ROAD_USERS

KINDS: Mapping[str, EventKind] = MappingProxyType(
    {each.name: each for each in (*ROAD_USERS, *EGO_AND_ROAD, *CONFLICTS)}
)
"""By name."""
EVENT_KIND: Kind[EventKind] = Kind("event kind", "events", KINDS, an_instance(EventKind, "replan.EventKind"))
"""Finds those, and users' own."""
