"""Reads the objects in the messages of one topic, with their velocity and size, as `Samples` in the
map frame.

(1) p_map = T_map,frame(t) p_frame with the transform at the time of the message;
        heading that of the rotated x axis
(2) velocity: rotated from the object's frame or the message's into the map. If the type does not
    define the frame, or the data contradict it, the frame that fits the displacement
    (`replan.logs.chords`) is used; if neither fits, no velocity is

An outline without a box (cluster, polygon) becomes the smallest rectangle around it, one side of
which lies along an edge of its hull.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.logs.agents import AgentKind
from replan.logs.chords import Chords
from replan.logs.heights import on_the_way
from replan.logs.kind_words import kind_of_word
from replan.logs.readers.recorded import heading, rotated, unit_or_identity
from replan.logs.readers.ros import schemas
from replan.logs.readers.ros.bag import Bag, Topic
from replan.logs.readers.ros.frames import BETWEEN, FrameTree, Poses, composed
from replan.logs.readers.ros.part import BagPart
from replan.logs.readers.ros.schemas import POSITION, ObjectSchema
from replan.logs.readers.ros.tracks import Samples, identified

MISFIT = 0.5
"""Logged velocities whose median difference exceeds this share of the speed are not used."""
LEAST_SIZE_M = 0.1
"""Smaller sizes are not known, m."""
POLYGON = 2
"""Autoware's number of shapes that are polygons."""


@dataclass(frozen=True, eq=False)
class Messages:
    """Messages of a topic of objects: log times and stamps `(n,)` ns, frames, objects; `names`:
    where fields begin.
    """

    log: IntArray
    stamps: IntArray
    frames: list[str]
    items: list[list[tuple[Any, ...]]]
    names: dict[str, int]


def read_messages(part: BagPart, topic: Topic) -> Messages:
    """The wanted fields of a topic's messages."""
    bag, schema = part.bag, schemas.OBJECTS[topic.kind]
    item = f"{schema.items}."
    wanted: list[Any] = []
    names: dict[str, int] = {}

    def want(name: str, *fields: Any) -> None:
        names[name] = len(wanted)
        wanted.extend(fields)

    want("pose", *(f"{schema.pose}.{name}" for name in POSITION))
    if schema.twist:
        want("twist", *(f"{schema.twist}.linear.{c}" for c in "xyz"))
    if schema.size:
        want("size", *(f"{schema.size}.{c}" for c in "xyz"))
    for name in ("shape", "trusted", "existence"):
        if getattr(schema, name) and bag.has(topic, item + getattr(schema, name)):
            want(name, getattr(schema, name))
    if schema.classes:
        inner = [
            _first(bag, topic, f"{item}{schema.classes}.", path)
            for path in (schema.label, schema.score)
        ]
        want("classes", (schema.classes, tuple(inner)))
    else:
        want("label", schema.label)
    if any(bag.has(topic, item + path) for path in schema.id.split("|")):
        want("id", _first(bag, topic, item, schema.id))
    if schema.outline and bag.has(topic, f"{item}{schema.outline}"):
        want("outline", (schema.outline, ("x", "y")))
    if schema.solid:
        want("solid", f"{schema.solid}.type", (f"{schema.solid}.dimensions", ()))
    log, stamps, rows = part.read(topic, ("header.frame_id", (schema.items, tuple(wanted))))
    frames = [frame.lstrip("/") for frame, _ in rows]
    return Messages(log, stamps, frames, [items for _, items in rows], names)


def _first(bag: Bag, topic: Topic, prefix: str, paths: str) -> str:
    """Return the first of several fields that the type has; the last if it has none of them."""
    choice = paths.split("|")
    return next((path for path in choice if bag.has(topic, prefix + path)), choice[-1])


def samples_of(
    messages: Messages,
    schema: ObjectSchema,
    chosen: IntArray,
    t: IntArray,
    frames: FrameTree,
    frame: str,
    places: FloatArray,
    notes: list[str],
    id_notes: list[str],
) -> Samples:
    """The objects of the messages `chosen` `(k,)` at times t `(k,)` ns, in the map frame `frame` by
    (1).

    Those above or below the ego's `places` `(n, 3)` are left out (`replan.logs.heights`).
    """
    items = [messages.items[i] for i in chosen]
    owner = np.repeat(np.arange(len(items)), [len(item) for item in items])
    rows = [item for objects in items for item in objects]
    if not rows:
        return _no_samples()
    held = _Fields(list(zip(*rows, strict=True)), messages.names)
    values = held.numbers("pose", 7)
    poses = Poses(t[owner], values[:, :3], unit_or_identity(values[:, 3:]))
    # The pose of each sample's frame in the map
    used, turn = [messages.frames[i] for i in chosen], None
    if not all(name in (frame, "") for name in used):
        p, q = np.zeros((len(used), 3)), np.tile([0.0, 0.0, 0.0, 1.0], (len(used), 1))
        for name in sorted(set(used) - {frame, ""}):
            rows_in_frame = np.array([k for k, frame_name in enumerate(used) if frame_name == name])
            frame_poses = frames.poses(frame, name, t[rows_in_frame], BETWEEN)
            p[rows_in_frame], q[rows_in_frame] = frame_poses.p, frame_poses.q
        turn = Poses(t[owner], p[owner], q[owner])
    world = poses if turn is None else composed(turn, poses)
    kinds, in_the_way, score = _kinds(held, schema)
    length, width, moved, yaw, turned = _sizes(held, schema, world, turn, kinds)
    velocity = held.numbers("twist", 3) if "twist" in held else np.full((len(rows), 3), np.nan)
    if "trusted" in held:
        velocity[~np.array(held.column("trusted"), np.bool_)] = np.nan
    if not np.nan_to_num(velocity).any():  # all of the log's are 0: it has none
        velocity[:] = np.nan
    finite = np.logical_and.reduce(np.isfinite(np.column_stack([velocity[:, :2], world.p])), axis=1)
    by_frame = rotated(world.q, velocity), velocity if turn is None else rotated(turn.q, velocity)
    in_object, in_frame = (
        np.where(finite[:, None], velocities[:, :2], np.nan) for velocities in by_frame
    )
    ids = list(held.column("id")) if "id" in held else []
    names = [
        object_id.hex() if isinstance(object_id, bytes) else str(object_id) for object_id in ids
    ] or [""] * len(rows)
    usable = np.isfinite(moved).all(axis=1) & np.isfinite(yaw)
    if not in_the_way.all():
        notes.append(
            f"{(~in_the_way).sum()} samples are of what can be driven over or under, and left out."
        )
    if not usable.all():
        notes.append(f"{(~usable).sum()} samples have no finite pose and are left out.")
    height = held.numbers("size", 3)[:, 2] if "size" in held else np.full(len(rows), np.nan)
    centres = np.column_stack([moved, world.p[:, 2]])
    on_level = on_the_way(places, centres, yaw, height, names, notes)
    keep = np.flatnonzero(usable & in_the_way & on_level)
    if not len(keep):
        return _no_samples()
    samples = Samples(
        owner,
        names,
        kinds,
        moved[:, 0],
        moved[:, 1],
        yaw,
        in_object[:, 0],
        in_object[:, 1],
        length,
        width,
        turned,
        score,
    ).taken(keep)
    if np.isfinite(samples.vx).any():
        samples = identified(samples, t, id_notes)
    by = _frame_of_twist(samples, in_frame[keep], schema, t, notes)
    if by == "object":
        return samples
    vx, vy = in_frame[keep].T if by == "frame" else np.full((2, len(samples)), np.nan)
    return replace(samples, vx=vx, vy=vy)


def _no_samples() -> Samples:
    none = np.empty(0)
    owner = np.empty(0, np.int64)
    floats = (none,) * 7
    return Samples(owner, [], [], *floats, np.empty(0, np.bool_), none, names=[])


@dataclass(frozen=True, eq=False)
class _Fields:
    """The wanted fields of all objects as columns; `names`: the first column of each group."""

    columns: list[tuple[Any, ...]]
    names: dict[str, int]

    def __len__(self) -> int:
        return len(self.columns[0])

    def __contains__(self, name: str) -> bool:
        return name in self.names

    def column(self, name: str, number: int = 0) -> tuple[Any, ...]:
        return self.columns[self.names[name] + number]

    def numbers(self, name: str, count: int) -> FloatArray:
        return np.array([self.column(name, k) for k in range(count)], dtype=np.float64).T


def _kinds(held: _Fields, schema: ObjectSchema) -> tuple[list[AgentKind], BoolArray, FloatArray]:
    """Return the kinds, whether the objects block the way, and the confidence of the detector.

    The confidence is NaN if the type has no such field, or if it is 0 or not a probability.
    """
    score = np.full(len(held), np.nan)
    if "classes" in held:
        classes = held.column("classes")
        best = [max(scored, key=lambda c: c[1])[0] if scored else "" for scored in classes]
        score = np.array(
            [max((c[1] for c in scored), default=np.nan) for scored in classes], np.float64
        )
    else:
        best = list(held.column("label"))
    if "existence" in held:
        score = np.array(held.column("existence"), dtype=np.float64)
    autoware = schema.classes == "classification"
    table = schemas.AUTOWARE_LABELS if autoware else schemas.DERIVED_LABELS
    kinds = {
        label: kind_of_word(label) or AgentKind.OBJECT
        if isinstance(label, str)
        else table.get(label, AgentKind.OBJECT)
        for label in set(best)
    }
    passed = schemas.AUTOWARE_NOT_IN_THE_WAY if autoware else ()
    in_the_way = np.array([label not in passed for label in best], np.bool_)
    return (
        [kinds[label] for label in best],
        in_the_way,
        np.where((score > 0.0) & (score <= 1.0), score, np.nan),
    )


def _sizes(
    held: _Fields, schema: ObjectSchema, world: Poses, turn: Poses | None, kinds: list[AgentKind]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, BoolArray]:
    """Lengths, widths, centres `(m, 2)`, headings, and whether the box is a rectangle around an
    outline.
    """
    n = len(kinds)
    size = held.numbers("size", 2) if "size" in held else np.full((n, 2), np.nan)
    if "solid" in held:  # 1 box, 2 sphere (radius), 3 and 4 cylinder and cone (height, radius)
        size = np.full((n, 2), np.nan)
        for i, (kind, numbers) in enumerate(
            zip(held.column("solid"), held.column("solid", 1), strict=True)
        ):
            if kind == 1 and len(numbers) >= 2:
                size[i] = numbers[:2]
            elif kind == 2 and numbers:
                size[i] = 2.0 * numbers[0]
            elif kind in (3, 4) and len(numbers) >= 2:
                size[i] = 2.0 * numbers[1]
    centre, yaw, turned = world.p[:, :2].copy(), heading(world.q), np.zeros(n, np.bool_)
    if "outline" in held:
        outlines = held.column("outline")
        is_polygon = [kind is AgentKind.OBJECT for kind in kinds]
        if "shape" in held:
            is_polygon = [shape == POLYGON for shape in held.column("shape")]
        outlined = np.array(
            [i for i in range(n) if is_polygon[i] and len(outlines[i]) > 2], np.int64
        )
        boxes: FloatArray = np.empty((0, 5))
        if len(outlined):
            boxes = smallest_rectangles([outlines[i] for i in outlined])
        centre[outlined], yaw[outlined] = boxes[:, :2], boxes[:, 2]
        size[outlined], turned[outlined] = boxes[:, 3:], True
        base = world if schema.outline_frame == "object" else turn
        if base is not None and len(outlined):
            half, none = 0.5 * boxes[:, 2], np.zeros(len(boxes))
            turns = np.column_stack([none, none, np.sin(half), np.cos(half)])
            local = Poses(base.t[outlined], np.column_stack([boxes[:, :2], none]), turns)
            placed = composed(Poses(base.t[outlined], base.p[outlined], base.q[outlined]), local)
            centre[outlined], yaw[outlined] = placed.p[:, :2], placed.yaw
    size[~(size >= LEAST_SIZE_M)] = np.nan
    return size[:, 0], size[:, 1], centre, yaw, turned


def _frame_of_twist(
    samples: Samples, in_frame: FloatArray, schema: ObjectSchema, t: IntArray, notes: list[str]
) -> str | None:
    """The frame of the velocities by (2): "object" (those of `samples`) or "frame" `(m, 2)`; None:
    unused.
    """
    if not np.isfinite(samples.vx).any():
        notes.append("The log has no velocities of objects.")
        return None
    codes = np.unique(np.array(samples.names, dtype=object).astype(str), return_inverse=True)[1]
    seconds = (t - t[0])[samples.message] / 1e9
    order = np.lexsort((seconds, codes))
    offsets = np.flatnonzero(np.diff(codes[order], prepend=-1, append=codes.max() + 1))
    chords = Chords.of(offsets, seconds[order], samples.x[order], samples.y[order])
    logged = {"object": np.array([samples.vx, samples.vy])[:, order], "frame": in_frame[order].T}
    fits = chords.misfits(logged)
    if fits is None:
        return "object" if schema.twist_frame in ("object", "log") else "frame"
    ranks = {name: (round(misfit, 2), name != schema.twist_frame) for name, misfit in fits.items()}
    best = min(ranks, key=ranks.__getitem__)
    # Also of the chords that do not show the frame
    misfit = (chords.misfits({best: logged[best]}) or fits)[best]
    words = {"object": "object's own frame", "frame": "message's frame"}
    if misfit > MISFIT:
        notes.append(
            "The logged velocities of objects do not fit their displacement (median difference "
            f"{misfit:.0%} of the speed) and are not used."
        )
        return None
    if schema.twist_frame == "log" or best != schema.twist_frame:
        notes.append(
            f"Velocities of objects are in the {words[best]}: they fit the displacement within "
            f"{misfit:.0%}."
        )
    return best


_ROWS = 2000


def smallest_rectangles(outlines: list[list[tuple[float, float]]]) -> FloatArray:
    """Rows (centre x, y, yaw, length, width) of the smallest rectangles around `n` outlines
    `(n, 5)`.

    `length >= width`; yaw within a half turn. An outline is a convex polygon of two points or more;
    for others the rectangles along its edges are compared, of which one is near the smallest.
    """
    most = max(map(len, outlines), default=0)
    padded = np.array(
        [outline + [outline[-1]] * (most - len(outline)) for outline in outlines]
    ).reshape(-1, most, 2)
    parts = [np.empty((0, 5))]
    for begin in range(0, len(padded), _ROWS):
        points = padded[begin : begin + _ROWS]
        middle = points.mean(axis=1, keepdims=True)
        around = points - middle
        edges = np.roll(around, -1, axis=1) - around
        angle = np.arctan2(edges[..., 1], edges[..., 0])
        cos, sin = np.cos(angle)[..., None], np.sin(angle)[..., None]
        along = cos * around[:, None, :, 0] + sin * around[:, None, :, 1]
        across = cos * around[:, None, :, 1] - sin * around[:, None, :, 0]
        low = np.stack([along.min(axis=2), across.min(axis=2)], axis=-1)
        high = np.stack([along.max(axis=2), across.max(axis=2)], axis=-1)
        size = high - low
        rows = np.arange(len(points))
        best = np.argmin(size[..., 0] * size[..., 1] + 1e-9 * size.sum(axis=-1), axis=1)
        size, centre, yaw = size[rows, best], 0.5 * (low + high)[rows, best], angle[rows, best]
        c, s = np.cos(yaw), np.sin(yaw)
        x = middle[:, 0, 0] + c * centre[:, 0] - s * centre[:, 1]
        y = middle[:, 0, 1] + s * centre[:, 0] + c * centre[:, 1]
        yaw = yaw + np.where(size[:, 1] > size[:, 0], 0.5 * np.pi, 0.0)
        parts.append(np.column_stack([x, y, yaw, size.max(axis=1), size.min(axis=1)]))
    return np.vstack(parts)
