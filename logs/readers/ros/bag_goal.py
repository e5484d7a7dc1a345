"""Reads the goal of a bag: the place around its goal pose."""

from __future__ import annotations

from math import cos, sin

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.readers.recorded import unit_or_identity
from replan.logs.readers.ros import schemas
from replan.logs.readers.ros.ego import EgoLog
from replan.logs.readers.ros.frames import Poses
from replan.logs.readers.ros.part import BagPart
from replan.logs.readers.ros.schemas import POSITION, STAMP
from replan.logs.road import GOAL_LENGTH_M, GOAL_WIDTH_M, Goal
from replan.logs.vehicle import VehicleParameters

LATE_GOAL_S = 1.0
"""A goal stamped this much after its record gets a note, s."""


def read_goal(
    part: BagPart, ego: EgoLog, begin_ns: int, origin: FloatArray, vehicle: VehicleParameters
) -> Goal | None:
    """Read the place around the log's goal pose: the newest at the begin (ns, log time), else the
    first one.
    """
    topics, notes = part.topics(schemas.GOALS, "goal"), part.notes
    if "goal" not in part.settings.topics:
        topics = [
            topic for topic in topics if topic.kind not in schemas.POSES or "goal" in topic.name
        ]
    if not topics:
        return None
    topic = topics[0]
    path = schemas.GOALS[topic.kind]
    fields = (*STAMP, "header.frame_id", *(f"{path}.{name}" for name in POSITION))
    log, rows = part.bag.read(topic, fields, *((part.begin, part.end) if part.is_drive else ()))
    good = [k for k, (_, _, _, *pose) in enumerate(rows) if np.isfinite(pose).all()]
    if not good:
        return None
    known = [k for k in good if log[k] <= begin_ns]
    k = known[-1] if known else good[0]
    sec, nsec, frame, *logged = rows[k]
    p, q = np.hsplit(np.array([logged], dtype=np.float64), [3])
    pose = ego.in_map(Poses(ego.clock(log[k : k + 1]), p, unit_or_identity(q)), frame)
    x, y = pose.p[0, :2] - origin
    yaw, ahead = float(pose.yaw[0]), vehicle.axle_to_center
    others = f"; its {len(good) - 1} other goals are not used" if len(good) > 1 else ""
    notes.append(
        f"The goal is {GOAL_LENGTH_M:g} m by {GOAL_WIDTH_M:g} m around the pose of "
        f"{topic.name}{others}."
    )
    late = (sec * 1_000_000_000 + nsec - log[k]) / 1e9
    if sec and late > LATE_GOAL_S:
        notes.append(
            f"The goal's stamp is {late:.1f} s after its record: it was set when it was known "
            "where the drive led."
        )
    return Goal.around(x + ahead * cos(yaw), y + ahead * sin(yaw), yaw)
