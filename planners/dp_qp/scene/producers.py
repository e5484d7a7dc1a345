"""The producers of speed caps: one line each."""

from __future__ import annotations

from collections.abc import Callable

from planners.dp_qp.scene import goal_and_rules, hesitant_pedestrians, occlusion, passing_speed, swerve
from planners.dp_qp.scene.caps import PathView, SpeedCap

Producer = Callable[[PathView], tuple[SpeedCap, ...]]

OWN: tuple[Producer, ...] = (goal_and_rules.caps,)
"""What the ego would keep on an empty road, too: the time lost to others counts against these."""
OTHERS: tuple[Producer, ...] = (passing_speed.caps, swerve.caps, occlusion.caps, hesitant_pedestrians.caps)
"""What it keeps for the sake of others, seen or hidden."""
