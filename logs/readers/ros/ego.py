"""Reads the ego's poses and speed from their topics, and derives motion from jittering positions.

Poses, in this order: nav_msgs/Odometry in the map frame; the chain of transforms from the map to
the car; Odometry in another frame; PoseStamped with or without covariance. Of several topics of a
kind, the one with most messages is used, then the first by name. Speed: that of the odometry; else
of a topic of velocities; else derived from the poses. A topic of speeds or accelerations is used if
it has no gap over `COVERS_S`; a pose gets its last value.

Motion is derived causally, by least squares over a short backward window. With u = t_i - t_k <= 0
the times of the samples in the window relative to its last one k, per coordinate

(1) z(u) = z_k + z'_k u + z''_k u^2 / 2
        fitted to the samples with u >= -W: z'_k is the rate, z''_k its change

A parabola has no lag while the acceleration is constant; its end is noisier than that of a line.
With 1.5 cm of noise at 50 Hz and W = 0.6 s the standard deviation of the speed is 0.06 m/s
(difference of two samples: 1.1 m/s), of the acceleration 0.2 m/s2. Where the window holds fewer
than `PARABOLA` samples, a straight line is fitted. With sigma the noise of a position, the rate of
a straight line has the standard deviation

(2) sigma_z' = sigma / sqrt(sum (u_i - mean u)^2)

Odometry of a sensor's frame (child_frame_id) becomes that of the base where the bag's transforms
lead there. With p, q the base in the sensor's frame, P, Q the sensor's pose, v, w the velocity and
turn rate in its axes

(3) P_base = P + Q p Q*,  Q_base = Q q,  v_base = q* (v + w x p) q
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np

from replan.core.arrays import FloatArray, IntArray
from replan.core.errors import LogError
from replan.logs.chords import Chords
from replan.logs.conventions import axes_of, in_axes
from replan.logs.ego_columns import with_agreed_columns
from replan.logs.log_settings import LogSettings
from replan.logs.readers.recorded import held_curvature, rotated, stands, unit_or_identity
from replan.logs.readers.ros import schemas
from replan.logs.readers.ros.bag import Bag, Topic
from replan.logs.readers.ros.fields import Wanted
from replan.logs.readers.ros.frames import (
    HELD,
    Clock,
    FrameTree,
    Poses,
    clock_of,
    composed,
    describe_timing,
    inverse,
    restarts,
    times_of,
)
from replan.logs.readers.ros.schemas import STAMP

NONE = "-"
"""Name of a topic in the settings that means: use no topic."""
MAP_NAMES = ("map", "world", "odom", "earth")
BASE_NAMES = ("base_link", "base_footprint", "ego_vehicle", "hero", "ego")
RIGID_M = 1.0
LEAST_POSES = 2
COVERS_S = 0.5
WARM_UP_S = 0.3
"""Time of poses before the first state, s, from which its speed is derived without later poses."""
POSITION = (*(f"position.{axis}" for axis in "xyz"), *(f"orientation.{axis}" for axis in "xyzw"))


@dataclass(frozen=True, eq=False)
class BagPart:
    """The messages of a bag that are read: those from `begin` to `end`, log times in ns (None: no
    bound).
    """

    bag: Bag
    settings: LogSettings
    begin: int | None = None
    end: int | None = None
    # list to which assumptions and omissions are added, one sentence each
    notes: list[str] = field(default_factory=list)
    drive: bool = False  # whether the bounds are those of one of several drives in the bag

    def topics(self, kinds: Mapping[str, object] | tuple[str, ...], role: str) -> list[Topic]:
        """Return the topics of these types with messages, most first.

        Or that of the settings, or a LogError.
        """
        wanted = self.settings.topics.get(role, "")
        if wanted == NONE:
            return []
        fitting = [topic for topic in self.bag.topics if topic.kind in kinds and topic.count]
        if wanted:
            named = [topic for topic in fitting if topic.name == wanted]
            if not named:
                there = next(
                    (topic.kind for topic in self.bag.topics if topic.name == wanted), None
                )
                what = f"the topic for {role!r} " + (
                    "is not in the log" if there is None else f"has the type {there}"
                )
                remedy = (
                    "for this role the log has "
                    f"{', '.join(t.name for t in fitting) or 'none'}; '-' takes none"
                )
                raise LogError(what, topic=wanted, remedy=remedy)
            return named
        return sorted(fitting, key=lambda topic: (-topic.count, topic.name))

    def read(
        self, topic: Topic, wanted: Wanted, stamp: Wanted = STAMP
    ) -> tuple[IntArray, IntArray, list[Any]]:
        """Return log times and stamps `(n,)`, ns, of a topic's messages, and rows: seconds,
        nanoseconds, `wanted`.
        """
        log, rows = self.bag.read(topic, (*stamp, *wanted), self.begin, self.end)
        return (
            log,
            np.array([row[0] * 1_000_000_000 + row[1] for row in rows], dtype=np.int64),
            rows,
        )


@dataclass(frozen=True, eq=False)
class Edge:
    """Transforms as logged: log times and stamps `(n,)` ns, poses `(n, 3)`, `(n, 4)`.

    Whether they never change.
    """

    log: IntArray
    stamps: IntArray
    p: FloatArray
    q: FloatArray
    static: bool


Edges = Mapping[tuple[str, str], Edge]


@dataclass(frozen=True, eq=False)
class EgoLog:
    """The logged ego: source, clock, frames, poses and speed `(n,)`; the speed is NaN where it must
    be derived.

    `restarts` are the log times, ns, at which another drive begins, because the clock of the topic
    `restarted` does.
    """

    source: str
    clock: Clock
    map: str
    base: str
    frames: FrameTree
    poses: Poses
    v: FloatArray
    restarts: IntArray
    restarted: str

    def in_map(self, poses: Poses, frame: str) -> Poses:
        """Return poses in a frame, as a message names it, as poses in the frame `map`; "" is that
        frame.
        """
        name = frame.lstrip("/")
        return (
            poses
            if name in (self.map, "")
            else composed(self.frames.poses(self.map, name, poses.t, HELD), poses)
        )


def read_edges(part: BagPart) -> dict[tuple[str, str], Edge]:
    """Read all transforms of the part; static ones from the log's begin on."""
    rows: dict[tuple[str, str], list[tuple[float, ...]]] = {}
    static: set[tuple[str, str]] = set()
    moved = (*(f"translation.{c}" for c in "xyz"), *(f"rotation.{c}" for c in "xyzw"))
    fields = (*STAMP, "header.frame_id", "child_frame_id", *(f"transform.{name}" for name in moved))
    for topic in part.bag.topics:
        if topic.kind not in schemas.TRANSFORMS or not topic.count:
            continue
        fixed = topic.name.endswith("static")
        log, messages = part.bag.read(
            topic, (("transforms", fields),), None if fixed else part.begin, part.end
        )
        for time, (transforms,) in zip(log.tolist(), messages, strict=True):
            for sec, nsec, parent, child, *pose in transforms:
                edge = parent.lstrip("/"), child.lstrip("/")
                rows.setdefault(edge, []).append((time, sec * 1_000_000_000 + nsec, *pose))
                if fixed:
                    static.add(edge)
    return {edge: _edge(values, edge in static) for edge, values in rows.items()}


def _edge(rows: list[tuple[float, ...]], static: bool) -> Edge:
    log = np.array([row[0] for row in rows], dtype=np.int64)
    stamps = np.array([row[1] for row in rows], dtype=np.int64)
    pose = np.array([row[2:] for row in rows])
    good = np.isfinite(pose).all(axis=1)
    order = np.argsort(log[good], kind="stable")[-1 if static else 0 :]
    log, stamps, pose = log[good][order], stamps[good][order], pose[good][order]
    return Edge(log, stamps, pose[:, :3], unit_or_identity(pose[:, 3:]), static)


def _map_frame(edges: Edges, named: str, settings: LogSettings) -> str:
    """Return the frame of the scenario: as set, else "map" or similar, else the frame of the ego's
    poses.
    """
    if "map" in settings.frames:
        return settings.frames["map"]
    names = {name for edge in edges for name in edge} | {named}
    roots = {parent for parent, _ in edges} - {child for _, child in edges}
    known = [name for name in MAP_NAMES if name in names]
    return known[0] if known else named or min(roots, default="map")


def read_ego(part: BagPart) -> EgoLog:
    """Read the ego's poses; LogError if the log has none."""
    edges, settings, notes = read_edges(part), part.settings, part.notes
    wanted = settings.topics.get("ego", "")
    by_transforms = any(
        topic.name == wanted and topic.kind in schemas.TRANSFORMS for topic in part.bag.topics
    )
    found = None if by_transforms else _odometry(part, edges)
    if found is not None:
        return _from_topic(part, found, edges)
    map_frame = _map_frame(edges, "", settings)
    moving = {
        child: len(edge.log)
        for (_, child), edge in edges.items()
        if not edge.static and len(edge.log) > 1
    }
    moving.pop(map_frame, None)
    named = [name for name in BASE_NAMES if any(child == name for _, child in edges)]
    if "base" in settings.frames:
        base, why = settings.frames["base"], "as set"
    elif named:
        base, why = named[0], "by its name"
    elif moving:
        base = min(moving, key=lambda name: (-moving[name], name))
        several = "of the frames that move the one with most transforms"
        why = "the only frame that moves" if len(moving) == 1 else several
    else:
        base, why = "", ""
    if not base:
        raise _no_ego(part.bag)
    chain = FrameTree((p, c, Poses(e.log, e.p, e.q)) for (p, c), e in edges.items()).chain(
        map_frame, base
    )
    fastest = max((edges[p, c] for p, c, _ in chain), key=lambda edge: len(edge.log), default=None)
    if fastest is None or len(fastest.log) < LEAST_POSES:
        raise _no_ego(part.bag)
    clock = clock_of(fastest.log, fastest.stamps, settings.clock)
    source = "/tf"
    steps = " -> ".join([map_frame, *(c if down else p for p, c, down in chain)])
    notes.append(f"The ego is frame '{base}' ({why}), its pose by transforms: {steps}.")
    notes += describe_timing(source, fastest.log, fastest.stamps, int(fastest.log[0]))
    frames = _frames(edges, clock, notes)
    t = frames.times(map_frame, base)
    if len(t) < LEAST_POSES:
        raise _no_ego(part.bag)
    poses, v = frames.poses(map_frame, base, t, HELD), np.full(len(t), np.nan)
    return EgoLog(
        source, clock, map_frame, base, frames, poses, v, *_restarts(part, source, fastest)
    )


def _restarts(part: BagPart, source: str, edge: Edge) -> tuple[IntArray, str]:
    """Return when another drive begins in the bag, log times in ns: by the ego's stamps, else by
    /clock; the topic.
    """
    found = {source: restarts(edge.log, edge.stamps)}
    for topic in part.bag.topics:
        if topic.kind == schemas.CLOCK and topic.count and not len(found[source]):
            log, rows = part.bag.read(topic, ("clock.sec", "clock.nanosec"), part.begin, part.end)
            stamps = np.array([row[0] * 1_000_000_000 + row[1] for row in rows], dtype=np.int64)
            found[topic.name] = restarts(log[stamps > 0], stamps[stamps > 0])  # 0: not yet known
    topic_name = max(found, key=lambda name: len(found[name]))
    return found[topic_name], topic_name


_Found = tuple[Topic, str, str, Edge, FloatArray]


def _six(path: str) -> tuple[str, ...]:
    return tuple(f"{path}{part}.{axis}" for part in ("linear", "angular") for axis in "xyz")


def _odometry(part: BagPart, edges: Edges) -> _Found | None:
    """Return the topic of odometry or poses of the ego; None: transforms are better, or there is no
    such topic.
    """
    kinds = {**dict.fromkeys(schemas.ODOMETRY, "pose.pose"), **schemas.POSES}
    settings = part.settings
    topics = [topic for topic in part.topics(kinds, "ego") if topic.count >= LEAST_POSES]
    if "ego" not in settings.topics:
        topics = [
            topic
            for topic in topics
            if "goal" not in topic.name and "initialpose" not in topic.name
        ]
    ordered = sorted(topics, key=lambda topic: topic.kind not in schemas.ODOMETRY)
    transforms = any(not edge.static and len(edge.log) >= LEAST_POSES for edge in edges.values())
    for topic in ordered:
        odometry = topic.kind in schemas.ODOMETRY
        more = ("child_frame_id", *_six("twist.twist.")) if odometry else ()
        pose = (f"{kinds[topic.kind]}.{name}" for name in POSITION)
        log, _, rows = part.read(topic, ("header.frame_id", *pose, *more))
        if not rows:
            remedy = "choose begin and end within the log"
            raise LogError("no poses in this part of the log", topic=topic.name, remedy=remedy)
        stamped = zip(log.tolist(), rows, strict=True)
        edge = _edge(
            [(time, row[0] * 1_000_000_000 + row[1], *row[3:10]) for time, row in stamped], False
        )
        good = np.isfinite([row[3:10] for row in rows]).all(axis=1)
        twist = np.array([row[11:17] if odometry else (np.nan,) * 6 for row in rows])[good]
        frame, child = rows[0][2].lstrip("/"), rows[0][10].lstrip("/") if odometry else ""
        at_once = odometry and frame == _map_frame(edges, frame, settings)
        if len(edge.log) >= LEAST_POSES and ("ego" in settings.topics or at_once or not transforms):
            return topic, frame, child, edge, twist
    return None


def _from_topic(part: BagPart, found: _Found, edges: Edges) -> EgoLog:
    (topic, frame, child, edge, twist), settings, notes = found, part.settings, part.notes
    others = [each for each in part.bag.topics if each.kind == topic.kind and each.count]
    several = (
        f" (of {len(others)} such topics the one with most messages)" if len(others) > 1 else ""
    )
    notes.append(f"The ego's pose is that of {topic.name}{several}, frame '{frame}'.")
    clock = clock_of(edge.log, edge.stamps, settings.clock)
    notes += describe_timing(topic.name, edge.log, edge.stamps, int(edge.log[0]))
    t, keep = times_of(topic.name, edge.log, edge.stamps, clock, notes)
    poses, twist = Poses(t, edge.p[keep], edge.q[keep]), twist[keep]
    map_frame = _map_frame(edges, frame, settings)
    own = _own_frames(_frames(edges, clock, []), {frame, map_frame, *MAP_NAMES})
    base = _base_of(topic.name, child, own, settings, notes)
    if base != child and own.connects(child, base):
        at = own.poses(child, base, t, HELD)
        poses, twist = composed(poses, at), _moved(twist, at)  # (3)
    above = own.path(base)  # the car's own frames hang below its base
    turned = {pair: inverse(own.edges[pair[::-1]]) for pair in pairwise(above)}
    frames = _frames(
        {pair: each for pair, each in edges.items() if pair[1] not in above}, clock, notes
    )
    speed = _speed_along(twist, poses, settings, topic.name, notes)
    known = frames.edges | turned | {(frame, base): poses}
    frames = FrameTree((parent, name, each) for (parent, name), each in known.items())
    if map_frame != frame and map_frame in frames.path(frame):
        poses = frames.poses(map_frame, base, t, HELD)
    else:
        map_frame = frame
    if np.ptp(np.nan_to_num(speed)) == 0.0:
        speed = np.full(len(t), np.nan)  # a constant speed is not a measurement
    return EgoLog(
        topic.name, clock, map_frame, base, frames, poses, speed, *_restarts(part, topic.name, edge)
    )


def _speed_along(
    twist: FloatArray, poses: Poses, settings: LogSettings, topic: str, notes: list[str]
) -> FloatArray:
    """Return the speed along the heading `(n,)` of velocities `(n, 6)`, in the axes in which they
    fit the poses.
    """
    vx, vy, yaw = twist[:, 0], twist[:, 1], poses.yaw
    axes = settings.ego_axes
    if not axes:
        seconds = (poses.t - poses.t[0]) / 1e9
        chords = Chords.of(np.array([0, len(seconds)]), seconds, poses.p[:, 0], poses.p[:, 1])
        shown = axes_of(chords, vx, vy, yaw, "own")
        if shown is None or shown[0] in ("own", ""):
            return vx
        axes, misfit, usual = shown
        notes.append(
            f"The velocity of {topic} is in {axes} axes: it fits the poses within {misfit:.0%}, in "
            f'its own axes {usual:.0%} (ego_axes = "own" in [log] takes it as it is).'
        )
    in_world = in_axes(axes, vx, vy, yaw)
    return in_world[0] * np.cos(yaw) + in_world[1] * np.sin(yaw)


def _own_frames(frames: FrameTree, world: Set[str]) -> FrameTree:
    """Return the car's own frames: each stays within `RIGID_M` of one place in its parent, and none
    is the world's.
    """
    own = [(*pair, poses) for pair, poses in frames.edges.items() if not world & set(pair)]
    return FrameTree(each for each in own if np.ptp(each[2].p, axis=0).max() < RIGID_M)


def _base_of(
    topic: str, child: str, own: FrameTree, settings: LogSettings, notes: list[str]
) -> str:
    """Return the frame of the rear axle: as set, if transforms lead there (else a LogError), or of
    `BASE_NAMES`.
    """
    asked = settings.frames.get("base", "")
    if not child:
        if asked:
            notes.append(
                f"{topic} does not name the frame of its poses: they are taken as those of "
                f"'{asked}', as set."
            )
        return asked or "base_link"
    base = next(
        (name for name in ((asked,) if asked else BASE_NAMES) if own.connects(child, name)), ""
    )
    if asked and not base:
        what = (
            f"the poses are those of frame {child!r}, and no transform leads from there to "
            f"{asked!r}"
        )
        raise LogError(
            what,
            topic=topic,
            remedy="record /tf_static, or leave base out: then they are the rear axle's",
        )
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


def _moved(twist: FloatArray, at: Poses) -> FloatArray:
    """Return velocities and turn rates `(n, 6)` at another place of a body, in its axes; NaN if
    they are constant.

    Accelerations too, without their centripetal part.
    """
    if not np.ptp(np.nan_to_num(twist[:, :3]), axis=0).any():
        return np.full(twist.shape, np.nan)  # a constant velocity is not a measurement
    back = at.q * np.array([-1.0, -1.0, -1.0, 1.0])
    moved = twist[:, :3] + np.cross(twist[:, 3:], at.p)  # (3)
    return np.column_stack([rotated(back, moved), rotated(back, twist[:, 3:])])


def _frames(edges: Edges, clock: Clock, notes: list[str]) -> FrameTree:
    out = []
    for (parent, child), edge in edges.items():
        if not len(edge.log):
            continue  # none of its transforms is finite
        if edge.static:
            out.append((parent, child, Poses(edge.log, edge.p, edge.q)))
            continue
        t, keep = times_of(f"/tf {parent} -> {child}", edge.log, edge.stamps, clock, notes)
        out.append((parent, child, Poses(t, edge.p[keep], edge.q[keep])))
    return FrameTree(out)


def _no_ego(bag: Bag) -> LogError:
    held = sorted({topic.kind.replace("/msg/", "/") for topic in bag.topics if topic.count})
    what = f"nothing in the bag says where the ego is; it holds {', '.join(held) or 'no messages'}"
    remedy = (
        "needed are /tf from map to base_link, nav_msgs/Odometry or geometry_msgs/PoseStamped "
        "(log.topics.ego)"
    )
    return LogError(what, remedy=remedy)


@dataclass(frozen=True, eq=False)
class Signal:
    """A number over time: increasing times `(n,)` ns on the scenario's clock, and values."""

    topic: str
    t: IntArray
    values: FloatArray


def signal(part: BagPart, kinds: Mapping[str, str], role: str, ego: EgoLog) -> Signal | None:
    """Read the topic of a role as numbers; None if no topic has at least two messages.

    A twist or acceleration in the frame of a sensor becomes that of the ego's base where transforms
    lead there.
    """
    for topic in part.topics(kinds, role):
        if topic.count < LEAST_POSES and role not in part.settings.topics:
            continue
        stamp = STAMP if part.bag.has(topic, "header.stamp") else ("stamp.sec", "stamp.nanosec")
        path, vector = kinds[topic.kind], kinds[topic.kind].removesuffix("linear.x")
        fields = ("header.frame_id", *_six(vector)) if vector != path else (path,)
        log, stamps, rows = part.read(topic, fields, stamp)
        if not rows:
            continue
        frame, own = str(rows[0][2]).lstrip("/"), _own_frames(ego.frames, {ego.map, *MAP_NAMES})
        values: FloatArray = np.array(
            [row[-1] if vector == path else row[3] for row in rows], dtype=np.float64
        )
        if (
            vector != path
            and frame != ego.base
            and frame in own.names
            and own.connects(frame, ego.base)
        ):
            at = own.poses(frame, ego.base, log, HELD)
            values = _moved(np.array([row[3:] for row in rows], dtype=np.float64), at)[:, 0]
            part.notes.append(
                f"{topic.name} is of frame '{frame}': transforms of the bag move it to "
                f"'{ego.base}'."
            )
        good = np.isfinite(values)
        if not good.any():
            continue
        t, keep = times_of(topic.name, log[good], stamps[good], ego.clock, part.notes)
        if len(t):
            return Signal(topic.name, t, values[good][keep])
    return None


def at_poses(some: Signal | None, t: IntArray, word: str, notes: list[str]) -> FloatArray:
    """Return the signal's last value at each pose `(n,)`.

    All NaN, with a note, if it does not cover all poses.
    """
    out = np.full(len(t), np.nan)
    if some is None:
        return out
    before = np.searchsorted(some.t, t, side="right") - 1
    age = np.where(before >= 0, (t - some.t[np.maximum(before, 0)]) / 1e9, np.inf)
    if age.max() > COVERS_S:
        notes.append(f"{some.topic} has no {word} for part of the drive and is not used for it.")
        return out
    notes.append(f"The ego's {word} is that of {some.topic}.")
    return some.values[before]


def states(ego: EgoLog, v: FloatArray, a: FloatArray, notes: list[str]) -> dict[str, FloatArray]:
    """Return columns x, y, yaw, v, a, kappa `(n,)` of all poses; kappa is derived, and v and a
    where they are NaN.

    In the first `WARM_UP_S` of the log, a derived speed has too few poses: `begin_of` leaves them
    out.
    """
    seconds = (ego.poses.t - ego.poses.t[0]) / 1e9
    x, y = ego.poses.p[:, 0], ego.poses.p[:, 1]
    yaw = np.unwrap(ego.poses.yaw)
    logged = {
        "t": seconds,
        "x": x,
        "y": y,
        "yaw": yaw,
        "v": v,
        "a": a,
        "kappa": np.full(len(x), np.nan),
    }
    logged = with_agreed_columns(logged, notes)
    v, a = logged["v"], logged["a"]
    usual = float(np.median(np.diff(seconds))) if len(seconds) > 1 else 0.0
    window = np.full(len(seconds), max(EGO_WINDOW_S, LEAST * usual))
    values = np.array([x - x[0], y - y[0], yaw])
    rate, change = rates(seconds, values, np.zeros(len(seconds), np.int64), window, parabola=True)
    lone = 1 + np.flatnonzero(np.isnan(rate[0, 1:]))  # the first after a gap: the way over the gap
    rate[:, lone], change[:, lone] = (
        (values[:, lone] - values[:, lone - 1]) / (seconds[lone] - seconds[lone - 1]),
        0.0,
    )
    cos, sin = np.cos(yaw), np.sin(yaw)
    derived_v, derived_a = (each[0] * cos + each[1] * sin for each in (rate, change))
    if len(seconds) > 1:
        derived_v[0], derived_a[0], rate[2, 0] = derived_v[1], 0.0, rate[2, 1]
    still = (np.abs(derived_v) < STANDS_MPS) | stands(seconds, x, y, yaw, derived_v)
    derived_v, derived_a = np.where(still, 0.0, derived_v), np.where(still, 0.0, derived_a)
    lacking = [
        word
        for word, column in (("speed", v), ("acceleration", a))
        if not np.isfinite(column).all()
    ]
    notes.append(
        f"The log has no ego {' and no ego '.join([*lacking, 'curvature'])}: derived from the "
        "poses of the last"
        f" {window[0]:.2g} s (least squares, no later pose)."
    )
    v = np.where(np.isfinite(v), v, derived_v)
    return {
        "x": x,
        "y": y,
        "yaw": yaw,
        "v": v,
        "a": np.where(np.isfinite(a), a, derived_a),
        "kappa": held_curvature(rate[2], v),
    }


def begin_of(ego: EgoLog, v: FloatArray) -> int:
    """Return the first pose that becomes a state: pose 0, or the first after `WARM_UP_S` if the
    speed is derived.
    """
    if np.isfinite(v).all():
        return 0
    t = ego.poses.t
    warm = int(np.searchsorted(t, t[0] + round(1e9 * WARM_UP_S)))
    return warm if len(t) - warm > len(t) // 2 else 0


EGO_WINDOW_S = 0.6
LEAST = 3.0
"""The shortest window, in usual intervals."""
PARABOLA = 5
STANDS_MPS = 0.05
"""Slower cars stand, m/s: the localisation of a standing car moves at such speeds."""
AGENT_WINDOW_S, OBJECT_WINDOW_S = 0.5, 1.0
"""Windows for boxes of road users and of objects at 10 Hz, s: outlines of clusters jump by
decimetres.
"""


def spread(t: FloatArray, first: IntArray, window: FloatArray) -> FloatArray:
    """The root in (2) `(n,)`, s, of the windows of `rates`; 0 where a window has one sample."""
    begin = np.maximum(first, _begins(t, first, window))
    count = np.arange(len(t)) - begin + 1
    since = t - t[begin]
    sums = np.zeros((2, len(t)))
    for back in range(int(count.max(initial=0))):
        u = np.where(back < count, t[np.maximum(np.arange(len(t)) - back, 0)] - t, 0.0) + since * (
            back < count
        )
        sums += u, u**2
    return np.sqrt(np.maximum(sums[1] - sums[0] ** 2 / count, 0.0))


def rates(
    t: FloatArray, values: FloatArray, first: IntArray, window: FloatArray, *, parabola: bool
) -> tuple[FloatArray, FloatArray]:
    """Fit (1), or straight lines, at every sample: return rates and their changes of `values`, all
    `(c, n)`.

    `t` `(n,)`, s, rises where `first`, the first sample that may be in the window, is the same;
    `window` is W `(n,)`, s. A lone sample has NaN.
    """
    begin = np.maximum(first, _begins(t, first, window))
    rows = np.arange(len(t))
    span = t - t[begin]
    scale = np.where(span > 0.0, span, 1.0)
    powers, moments = np.zeros((5, len(t))), np.zeros((3, len(values), len(t)))
    # One after another: later samples change no bit
    for back in range(int((rows - begin).max(initial=0)) + 1):
        inside = rows - back >= begin
        at = np.maximum(rows - back, 0)
        u = np.where(inside, (t[at] - t) / scale, 0.0)
        weights = inside * np.array([u**0, u, u**2, u**3, u**4])
        powers += weights
        moments += weights[:3, None] * np.where(inside, values[:, at] - values, 0.0)
    rate, change = np.full((2, *values.shape), np.nan)
    curved = (powers[0] >= PARABOLA) & parabola
    det = powers[0] * powers[2] - powers[1] ** 2
    line = (powers[0] >= 2) & ~curved & (det > 0.0)
    rate[:, line] = (
        (powers[0] * moments[1] - powers[1] * moments[0])[:, line] / det[line] / scale[line]
    )
    change[:, line] = 0.0
    if curved.any():
        normal = np.array([[powers[i + j][curved] for j in range(3)] for i in range(3)]).transpose(
            2, 0, 1
        )
        found = np.linalg.solve(normal, moments[:, :, curved].transpose(2, 0, 1))
        rate[:, curved] = (found[:, 1] / scale[curved, None]).T
        change[:, curved] = (2.0 * found[:, 2] / scale[curved, None] ** 2).T
    return rate, change


def _begins(t: FloatArray, first: IntArray, window: FloatArray) -> IntArray:
    """Return the first sample within the window of each sample, among those of the same owner."""
    out = np.empty(len(t), np.int64)
    bounds = np.flatnonzero(np.diff(first, prepend=-1))
    for begin, end in zip(bounds, np.append(bounds[1:], len(t)), strict=True):
        out[begin:end] = begin + np.searchsorted(
            t[begin:end], t[begin:end] - window[begin:end] - 1e-9
        )
    return out
