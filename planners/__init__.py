"""Planners: Frame -> Plan. `replay.parts` has their names.

To write your own, read `logs/frame.py` (the input of a planner) and `planners/constant_speed.py` (the template).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import replan.own

if not TYPE_CHECKING:  # a type checker would accept any name as a member of this package
    __getattr__ = replan.own.missing("planners")
