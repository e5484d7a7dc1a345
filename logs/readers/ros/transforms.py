"""Reads the transforms of a bag, and finds the frames of the map and of the car among them.

Odometry of a sensor's frame (child_frame_id) becomes that of the base where the bag's transforms
lead there. With p, q the base in the sensor's frame, P, Q the sensor's pose, v, w the velocity and
turn rate in its axes

(1) P_base = P + Q p Q*,  Q_base = Q q,  v_base = q* (v + w x p) q
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass

import numpy as np

from replan.core.arrays import FloatArray, IntArray
from replan.core.errors import LogError
from replan.logs.log_settings import LogSettings
from replan.logs.readers.recorded import rotated, unit_or_identity
from replan.logs.readers.ros import schemas
from replan.logs.readers.ros.frames import Clock, FrameTree, Poses, times_of
from replan.logs.readers.ros.part import BagPart
from replan.logs.readers.ros.schemas import STAMP

MAP_NAMES = ("map", "world", "odom", "earth")
BASE_NAMES = ("base_link", "base_footprint", "ego_vehicle", "hero", "ego")
RIGID_M = 1.0
"""Frames of the car move by less in their parent, m."""


@dataclass(frozen=True, eq=False)
class Edge:
    """Transforms as logged: log times and stamps `(n,)` ns, positions `(n, 3)`, quaternions
    `(n, 4)`; whether they never change.
    """

    log: IntArray
    stamps: IntArray
    p: FloatArray
    q: FloatArray
    is_static: bool


Edges = Mapping[tuple[str, str], Edge]


def read_edges(part: BagPart) -> dict[tuple[str, str], Edge]:
    """Read all transforms of the part; static ones from the log's begin on."""
    rows: dict[tuple[str, str], list[tuple[int, int, list[float]]]] = {}
    static: set[tuple[str, str]] = set()
    numbers = (*(f"translation.{c}" for c in "xyz"), *(f"rotation.{c}" for c in "xyzw"))
    names = (f"transform.{name}" for name in numbers)
    fields = (*STAMP, "header.frame_id", "child_frame_id", *names)
    for topic in part.bag.topics:
        if topic.kind not in schemas.TRANSFORMS or not topic.count:
            continue
        is_static = topic.name.endswith("static")
        begin = None if is_static else part.begin
        log, messages = part.bag.read(topic, (("transforms", fields),), begin, part.end)
        for time, (transforms,) in zip(log.tolist(), messages, strict=True):
            for seconds, nanoseconds, parent, child, *pose in transforms:
                pair = parent.lstrip("/"), child.lstrip("/")
                stamp = seconds * 1_000_000_000 + nanoseconds
                rows.setdefault(pair, []).append((time, stamp, pose))
                if is_static:
                    static.add(pair)
    edges = {}
    for pair, samples in rows.items():
        log_times, stamps, poses = zip(*samples, strict=True)
        edges[pair] = edge_of(
            np.array(log_times), np.array(stamps), np.array(poses), is_static=pair in static
        )
    return edges


def edge_of(log: IntArray, stamps: IntArray, pose: FloatArray, *, is_static: bool) -> Edge:
    """Return the finite poses `(n, 7)` at their log times and stamps, sorted by log time; of a
    static edge the last one.
    """
    rows = np.flatnonzero(np.isfinite(pose).all(axis=1))
    rows = rows[np.argsort(log[rows], kind="stable")][-1 if is_static else 0 :]
    p, q = np.hsplit(pose[rows], [3])
    return Edge(log[rows], stamps[rows], p, unit_or_identity(q), is_static)


def map_frame_of(edges: Edges, named: str, settings: LogSettings) -> str:
    """Return the frame of the scenario: as set, else "map" or similar, else the frame of the ego's
    poses.
    """
    if "map" in settings.frames:
        return settings.frames["map"]
    names = {name for edge in edges for name in edge} | {named}
    roots = {parent for parent, _ in edges} - {child for _, child in edges}
    known = [name for name in MAP_NAMES if name in names]
    return known[0] if known else named or min(roots, default="map")


def frames_of(edges: Edges, clock: Clock, notes: list[str]) -> FrameTree:
    """Return the tree of the transforms at the times of the ego's clock; notes tell what is left
    out.
    """
    frames = []
    for (parent, child), edge in edges.items():
        if not len(edge.log):
            continue  # none of its transforms is finite
        if edge.is_static:
            frames.append((parent, child, Poses(edge.log, edge.p, edge.q)))
            continue
        t, keep = times_of(f"/tf {parent} -> {child}", edge.log, edge.stamps, clock, notes)
        frames.append((parent, child, Poses(t, edge.p[keep], edge.q[keep])))
    return FrameTree(frames)


def own_frames(frames: FrameTree, world: Set[str]) -> FrameTree:
    """Return the car's own frames: each stays within `RIGID_M` of one place in its parent, and none
    is the world's.
    """
    return FrameTree(
        (*pair, poses)
        for pair, poses in frames.edges.items()
        if not world & set(pair) and np.ptp(poses.p, axis=0).max() < RIGID_M
    )


def base_of(topic: str, child: str, own: FrameTree, settings: LogSettings, notes: list[str]) -> str:
    """Return the frame of the rear axle: as set, if transforms lead there (else a LogError), or of
    `BASE_NAMES`.
    """
    setting = settings.frames.get("base", "")
    if not child:
        if setting:
            notes.append(
                f"{topic} does not name the frame of its poses: they are taken as those of "
                f"'{setting}', as set."
            )
        return setting or "base_link"
    names = (setting,) if setting else BASE_NAMES
    base = next((name for name in names if own.connects(child, name)), "")
    if setting and not base:
        problem = (
            f"the poses are those of frame {child!r}, and no transform leads from there to "
            f"{setting!r}"
        )
        remedy = "record /tf_static, or leave base out: then they are the rear axle's"
        raise LogError(problem, topic=topic, remedy=remedy)
    if not base:
        notes.append(
            f"{topic} has the poses of frame '{child}', which is taken as the rear axle: no "
            "transform leads on."
        )
    elif base != child:
        notes.append(
            f"{topic} has the poses of frame '{child}': transforms of the bag move them to "
            f"'{base}'."
        )
    return base or child


def moved(twist: FloatArray, place: Poses) -> FloatArray:
    """Return velocities and turn rates `(n, 6)` at another place of a body, in its axes, by (1);
    NaN if they are constant.

    Accelerations too, without their centripetal part.
    """
    velocity, turn_rate = np.hsplit(twist, [3])
    if not np.ptp(np.nan_to_num(velocity), axis=0).any():
        return np.full(twist.shape, np.nan)  # a constant velocity is not a measurement
    back = place.q * np.array([-1.0, -1.0, -1.0, 1.0])
    velocity = velocity + np.cross(turn_rate, place.p)
    return np.column_stack([rotated(back, velocity), rotated(back, turn_rate)])
