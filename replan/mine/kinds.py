"""The table of event kinds."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from replan.core.extension import ExtensionKind, an_instance
from replan.mine.conflicts import CONFLICTS
from replan.mine.driven_log import EventKind
from replan.mine.ego_and_road import EGO_AND_ROAD
from replan.mine.handovers import HANDOVERS
from replan.mine.road_users import ROAD_USERS

KINDS: Mapping[str, EventKind] = MappingProxyType(
    {kind.name: kind for kind in (*ROAD_USERS, *EGO_AND_ROAD, *CONFLICTS, *HANDOVERS)}
)
"""The built-in event kinds by name."""
EVENT_KIND: ExtensionKind[EventKind] = ExtensionKind(
    "event kind", "events", KINDS, an_instance(EventKind, "replan.EventKind")
)
"""Finds event kinds by name: the built-in ones and those of users."""
