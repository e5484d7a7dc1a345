"""What producers of speed caps of `dp_qp` are given, and the limits that they make of it."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from replan.planners.dp_qp.goal_window import GoalWindow, SpeedTarget
from replan.planners.dp_qp.path.passing import PassTarget
from replan.planners.dp_qp.speed.caps import (
    CautionConfig,
    LoweredLimit,
    PathView,
    SpeedCap,
    SpeedTask,
    lower_limit,
)
from replan.planners.frenet.path import Path
from replan.planners.frenet.scene import Scene
from replan.planners.frenet.st_boundaries import StGraphConfig, st_boundaries


def view(
    now: Scene, path: Path, *, targets: tuple[PassTarget, ...] = (), **changes: object
) -> PathView:
    """What a producer of speed caps is given for a path on which all agents are met, with braking
    of 6 m/s2; `changes` replace its fields.
    """
    none = np.zeros(len(now.frame.agents), np.bool_)
    taken = st_boundaries(now, path, none, frozenset(), StGraphConfig())
    task = SpeedTask(
        passed={},
        skip=none,
        stops=(),
        targets=targets,
        is_pass=False,
        goal=GoalWindow(None, now.reference, now.vehicle),
        target=SpeedTarget(),
    )
    seen = PathView(
        scene=now,
        path=path,
        task=task,
        limit=np.full(len(path.s), 15.0),
        taken=taken,
        came={},
        hard_mps2=6.0,
        margin_m=0.6,
        caution=CautionConfig(),
    )
    return replace(seen, **changes)  # type: ignore[arg-type]


def limit_of(seen: PathView, producer: Callable[[PathView], tuple[SpeedCap, ...]]) -> LoweredLimit:
    """The limit of a view with the caps of one producer in it."""
    road = LoweredLimit(seen.limit, np.zeros(len(seen.limit), np.bool_))
    return lower_limit(seen.path.sigma, road, producer(seen))
