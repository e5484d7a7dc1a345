"""Features of a frame: ego, agents and objects; lanes and route are those of `map_features`.

With p the rear axle of the ego now and yaw its heading, a point q of the world and a heading h are

(1) q' = R(-yaw) (q - p)       (2) h' = h - yaw, as cos h' and sin h'
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import cos, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replan.core.arrays import TIE, FloatArray, IntArray
from replan.features.form import AGENT_KINDS, Features, FeatureSizes, mask, padded
from replan.features.map_features import crosswalk_features, lane_features, route_features
from replan.logs.agents import AgentKind, ObjectClass
from replan.logs.frame import Frame, PlannerContext
from replan.logs.past import Past, PastSource
from replan.logs.states import EgoState
from replan.logs.vehicle import VehicleParameters

DEFAULT_SIZES = FeatureSizes()
_CLASSES: Mapping[ObjectClass | None, int] = {named: code for code, named in enumerate(ObjectClass)}


def features_of(
    frame: Frame, context: PlannerContext, sizes: FeatureSizes = DEFAULT_SIZES
) -> Features:
    """Return the features of a frame; the past is complete only for a class with `past_s = 2.1`."""
    past, ego = frame.past, frame.ego
    arrays: dict[str, NDArray[Any]] = {
        "ego": _ego_history((*past.ego, ego), ego),
        "ego_known": np.array([s is not PastSource.HELD for s in past.source] + [True]),
        "ego_size": _ego_size(context.vehicle),
        **_agents(frame, past, sizes),
        **_objects(frame, sizes),
        **lane_features(frame, context, sizes),
        **crosswalk_features(frame, context, sizes),
        **route_features(frame, context, sizes),
    }
    return Features(**arrays)


def _ego_history(states: Sequence[EgoState], now: EgoState) -> FloatArray:
    """Return `(k, 10)`, `EGO_COLUMNS`."""
    x, y = now.offset_of(*np.array([(state.x, state.y) for state in states]).T)
    rows = np.zeros((len(states), 10))
    for k, state in enumerate(states):
        c, s = cos(state.yaw - now.yaw), sin(state.yaw - now.yaw)  # (2)
        vx, vy = state.v * c - state.v_lat * s, state.v * s + state.v_lat * c
        pose, across = (x[k], y[k], c, s), state.v**2 * state.kappa
        rows[k] = *pose, vx, vy, state.a, across, state.steer, state.yaw_rate
    return rows


def _ego_size(vehicle: VehicleParameters) -> FloatArray:
    return np.array([vehicle.length, vehicle.width, vehicle.wheelbase, vehicle.axle_to_center])


def _nearest(frame: Frame, sizes: FeatureSizes, *, objects: bool) -> IntArray:
    """Return the rows of the objects, or of the others, within the radius, the nearest first."""
    agents = frame.agents
    away = np.hypot(agents.x - frame.ego.x, agents.y - frame.ego.y)
    is_object = np.array([kind is AgentKind.OBJECT for kind in agents.kinds], np.bool_)
    rows = np.flatnonzero((is_object == objects) & (away <= sizes.radius_m))
    # Whole multiples, so that rounding does not reorder what is equally near
    return rows[np.argsort(np.rint(away[rows] / TIE), kind="stable")]


def _agents(frame: Frame, past: Past, sizes: FeatureSizes) -> dict[str, NDArray[Any]]:
    rows, now, count = _nearest(frame, sizes, objects=False), frame.agents, sizes.agents
    columns = {
        name: np.vstack([getattr(past, name)[:, rows], getattr(now, name)[None, rows]]).T
        for name in ("x", "y", "yaw", "vx", "vy")
    }
    x, y = frame.ego.offset_of(columns["x"], columns["y"])  # (1)
    turn, c, s = columns["yaw"] - frame.ego.yaw, cos(frame.ego.yaw), sin(frame.ego.yaw)
    vx, vy = c * columns["vx"] + s * columns["vy"], c * columns["vy"] - s * columns["vx"]
    histories = np.stack([x, y, np.cos(turn), np.sin(turn), vx, vy], axis=-1)
    seen = np.vstack([past.seen[:, rows], np.ones((1, len(rows)), np.bool_)]).T
    kinds = np.array([AGENT_KINDS.index(now.kinds[i]) for i in rows], np.int64)
    return {
        "agents": padded(histories, count),
        "agents_seen": padded(seen, count),
        "agents_size": padded(np.column_stack([now.length[rows], now.width[rows]]), count),
        "agents_kind": padded(kinds, count, -1),
        "agents_mask": mask(len(rows), count),
        "agents_row": padded(rows, count, -1),
    }


def _objects(frame: Frame, sizes: FeatureSizes) -> dict[str, NDArray[Any]]:
    rows, now, count = _nearest(frame, sizes, objects=True), frame.agents, sizes.objects
    x, y = frame.ego.offset_of(now.x[rows], now.y[rows])
    turn = now.yaw[rows] - frame.ego.yaw
    shapes = (now.length[rows], now.width[rows])
    boxes = np.column_stack([x, y, np.cos(turn), np.sin(turn), *shapes])
    codes = [_CLASSES.get(frame.object_classes.get(now.ids[i]), -1) for i in rows]
    return {
        "objects": padded(boxes, count),
        "objects_class": padded(np.array(codes, np.int64), count, -1),
        "objects_mask": mask(len(rows), count),
    }
