"""Other road users: arrays from the messages of one topic, their frame, velocity and size, and tracks of them.

(1) p_map = T_map,frame(t) p_frame with the transform at the message's time; heading that of the turned x axis
(2) velocity: turned from the object's frame or the message's into the map. Where the type does not say which, or the
    data say otherwise, the one counts that fits the displacement over `MOTION_S`; where neither does, none does

A log has a box of its own in each frame, a Scenario one for each agent: the median of its sizes, and the kind that it
had most often. Outlines without a box (clusters, polygons) become the smallest rectangle around them.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from logs.agents import USUAL_SIZE_M, AgentKind
from logs.kernel import BoolArray, FloatArray, IntArray
from logs.readers.ros import schemas
from logs.readers.ros.bag import Bag, Topic
from logs.readers.ros.fields import Wanted
from logs.readers.ros.identity import are_identities, joined
from logs.readers.ros.motion import AGENT_WINDOW_S, OBJECT_WINDOW_S, rates, spread
from logs.readers.ros.rectangles import smallest_rectangles
from logs.readers.ros.schemas import ObjectSchema
from logs.readers.ros.transforms import BETWEEN, Frames, Poses, composed, heading, rotated, unit
from logs.scenario import Tracks

STAMP: Wanted = ("header.stamp.sec", "header.stamp.nanosec")
MOTION_S = 0.5
"""Displacement over at most this is compared with the velocity."""
MOVES_MPS = 1.0
"""Only of who is faster."""
MISFIT = 0.5
"""A median difference of more than this share of the speed is no velocity."""
NOISE_M = {
    AgentKind.PEDESTRIAN: 0.07, AgentKind.BICYCLE: 0.07, AgentKind.MOTORCYCLE: 0.17, AgentKind.TRUCK: 0.17,
    AgentKind.BUS: 0.17,
}  # fmt: skip
NOISE_OTHERS_M, NOISES = 0.1, 2.0
"""Noise of box centres (root mean square in the 13 drives of Tartu); a derived velocity counts from so many times the
standard deviation that follows on: who was seen twice 0.1 s apart is not yet known to move."""
LEAST_SIZE_M = 0.1
EGO_WITHIN_M, EGO_LEAST_S = 1.0, 1.0
"""A track whose centre stays so near the ego's for so long while the ego drives is the ego."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Objects of all frames, `(m,)` each: message, id, kind, pose in the map, velocity, size (NaN: not known)."""

    message: IntArray
    ids: list[Any]
    kinds: list[AgentKind]
    x: FloatArray
    y: FloatArray
    yaw: FloatArray
    vx: FloatArray
    vy: FloatArray
    length: FloatArray
    width: FloatArray
    turned: BoolArray

    def __len__(self) -> int:
        return len(self.ids)

    def taken(self, keep: IntArray) -> Samples:
        """Some of them, in the order of `keep`."""
        lists: dict[str, Any] = {name: [getattr(self, name)[i] for i in keep] for name in ("ids", "kinds")}
        names = ("message", "x", "y", "yaw", "vx", "vy", "length", "width", "turned")
        return replace(self, **lists | {name: getattr(self, name)[keep] for name in names})


@dataclass(frozen=True, eq=False)
class Messages:
    """The messages of a topic of objects: log times and stamps `(n,)` ns, frames `n`, objects by `_names`."""

    log: IntArray
    stamps: IntArray
    frames: list[str]
    items: list[list[tuple[Any, ...]]]
    names: dict[str, int]


def read_messages(bag: Bag, topic: Topic, begin: int | None, end: int | None) -> Messages:
    """The wanted fields of all messages between two log times, ns."""
    schema = schemas.OBJECTS[topic.kind]
    wanted, names = _wanted(bag, topic, schema)
    log, rows = bag.read(topic, (*STAMP, "header.frame_id", (schema.items, wanted)), begin, end)
    stamps = np.array([row[0] * 1_000_000_000 + row[1] for row in rows], dtype=np.int64)
    return Messages(log, stamps, [row[2].lstrip("/") for row in rows], [row[3] for row in rows], names)


def _wanted(bag: Bag, topic: Topic, schema: ObjectSchema) -> tuple[Wanted, dict[str, int]]:
    """What is read of an object, and where the first of each group of fields stands in the answer."""
    item = f"{schema.items}."
    wanted: list[Any] = []
    names: dict[str, int] = {}

    def want(name: str, *fields: Any) -> None:
        names[name] = len(wanted)
        wanted.extend(fields)

    want("pose", *(f"{schema.pose}.position.{c}" for c in "xyz"), *(f"{schema.pose}.orientation.{c}" for c in "xyzw"))
    if schema.twist:
        want("twist", *(f"{schema.twist}.linear.{c}" for c in "xyz"))
    if schema.size:
        want("size", *(f"{schema.size}.{c}" for c in "xy"))
    for name in ("shape", "trusted"):
        if getattr(schema, name) and bag.has(topic, item + getattr(schema, name)):
            want(name, getattr(schema, name))
    if schema.classes:
        inner = [_first(bag, topic, f"{item}{schema.classes}.", path) for path in (schema.label, schema.score)]
        want("classes", (schema.classes, tuple(inner)))
    else:
        want("label", schema.label)
    if any(bag.has(topic, item + path) for path in schema.id.split("|")):
        want("id", _first(bag, topic, item, schema.id))
    if schema.outline and bag.has(topic, f"{item}{schema.outline}"):
        want("outline", (schema.outline, ("x", "y")))
    if schema.solid:
        want("solid", f"{schema.solid}.type", (f"{schema.solid}.dimensions", ()))
    return tuple(wanted), names


def _first(bag: Bag, topic: Topic, prefix: str, paths: str) -> str:
    """The first of several fields that the type has; the last where it has none."""
    choice = paths.split("|")
    return next((path for path in choice if bag.has(topic, prefix + path)), choice[-1])


def samples_of(
    messages: Messages, schema: ObjectSchema, chosen: IntArray, t: IntArray, frames: Frames, frame: str, said: list[str]
) -> Samples:
    """The objects of the messages `chosen` `(k,)` at times t `(k,)` ns, in the map frame `frame` by (1)."""
    items = [messages.items[i] for i in chosen]
    owner = np.repeat(np.arange(len(items)), [len(item) for item in items])
    rows = [item for some in items for item in some]
    if not rows:
        none = np.empty(0)
        return Samples(owner, [], [], none, none, none, none, none, none, none, np.empty(0, np.bool_))
    columns = list(zip(*rows, strict=True))
    poses = _local(columns, messages.names, t[owner])
    turn = _turns([messages.frames[i] for i in chosen], owner, t, frames, frame)
    world = poses if turn is None else composed(turn, poses)
    kinds, in_the_way = _kinds(columns, messages.names, len(rows), schema)
    length, width, moved, yaw, turned = _sizes(columns, messages.names, schema, world, turn, kinds)
    velocity = _velocity(columns, messages.names, len(rows))
    ids = list(columns[messages.names["id"]]) if "id" in messages.names else []
    out = Samples(
        owner, [_text(each) for each in ids], kinds, moved[:, 0], moved[:, 1], yaw, velocity[:, 0], velocity[:, 1],
        length, width, turned,
    )  # fmt: skip
    if len(ids) and set(out.ids) <= {""}:
        out = replace(out, ids=[])
    return _with_velocities(out, velocity, world, turn, schema, t, said, in_the_way)


def _with_velocities(
    out: Samples, velocity: FloatArray, world: Poses, turn: Poses | None, schema: ObjectSchema, t: IntArray,
    said: list[str], in_the_way: BoolArray,
) -> Samples:  # fmt: skip
    by_frame = {"object": rotated(world.q, velocity), "frame": velocity if turn is None else rotated(turn.q, velocity)}
    finite = np.logical_and.reduce(np.isfinite(np.column_stack([velocity[:, :2], world.p])), axis=1)
    usable = np.isfinite(out.x) & np.isfinite(out.y) & np.isfinite(out.yaw)
    left_out = int((~in_the_way).sum()), int((~usable).sum())
    if left_out[0]:
        said.append(f"{left_out[0]} samples are of what can be driven over or under, and left out.")
    if left_out[1]:
        said.append(f"{left_out[1]} samples have no finite pose and are left out.")
    filled = [np.where(finite[:, None], by_frame[name][:, :2], np.nan) for name in ("object", "frame")]
    keep = np.flatnonzero(usable & in_the_way)
    ids = out.ids or list(np.full(len(out.kinds), ""))
    both = replace(out, ids=ids, vx=filled[0][:, 0], vy=filled[0][:, 1]).taken(keep)
    other = filled[1][keep]
    both = _identified(both, bool(out.ids), t, said)
    chosen = _frame_of_twist(both, other, schema, t, said)
    if chosen is None:
        nan = np.full(len(both), np.nan)
        return replace(both, vx=nan, vy=nan)
    return both if chosen == "object" else replace(both, vx=other[:, 0], vy=other[:, 1])


def _text(name: Any) -> str:
    return name.hex() if isinstance(name, bytes) else str(name)


def _local(columns: list[tuple[Any, ...]], names: dict[str, int], t: IntArray) -> Poses:
    first = names["pose"]
    values = np.array(columns[first : first + 7], dtype=np.float64).T
    return Poses(t, values[:, :3], unit(values[:, 3:]))


def _turns(used: list[str], owner: IntArray, t: IntArray, frames: Frames, frame: str) -> Poses | None:
    """The pose of each sample's frame in the map; None where all are in the map."""
    if all(name in (frame, "") for name in used):
        return None
    p, q = np.zeros((len(used), 3)), np.tile([0.0, 0.0, 0.0, 1.0], (len(used), 1))
    for name in sorted(set(used) - {frame, ""}):
        at = np.array([k for k, each in enumerate(used) if each == name])
        poses = frames.poses(frame, name, t[at], BETWEEN)
        p[at], q[at] = poses.p, poses.q
    return Poses(t[owner], p[owner], q[owner])


def _kinds(
    columns: list[tuple[Any, ...]], names: dict[str, int], n: int, schema: ObjectSchema
) -> tuple[list[AgentKind], BoolArray]:
    """The kinds, and whether they are in the way."""
    if "classes" in names:
        best = [max(each, key=lambda c: c[1])[0] if each else "" for each in columns[names["classes"]]]
    else:
        best = list(columns[names["label"]])
    table = schemas.AUTOWARE_LABELS if schema.classes == "classification" else schemas.DERIVED_LABELS
    kinds = {
        label: schemas.kind_of_word(label) if isinstance(label, str) else table.get(label, AgentKind.OBJECT)
        for label in set(best)
    }
    passed = schemas.AUTOWARE_NOT_IN_THE_WAY if schema.classes == "classification" else ()
    return [kinds[label] for label in best], np.array([label not in passed for label in best], np.bool_)


def _sizes(
    columns: list[tuple[Any, ...]], names: dict[str, int], schema: ObjectSchema, world: Poses, turn: Poses | None,
    kinds: list[AgentKind],
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, BoolArray]:  # fmt: skip
    """Lengths, widths, centres `(m, 2)`, headings, and whether the box is a rectangle around an outline."""
    n = len(kinds)
    size = np.full((n, 2), np.nan)
    if "size" in names:
        size = np.array(columns[names["size"] : names["size"] + 2], dtype=np.float64).T
    if "solid" in names:
        size = _solids(columns[names["solid"]], columns[names["solid"] + 1])
    centre, yaw, turned = world.p[:, :2].copy(), heading(world.q), np.zeros(n, np.bool_)
    if "outline" in names:
        outlines = columns[names["outline"]]
        shapes = columns[names["shape"]] if "shape" in names else [2 if k is AgentKind.OBJECT else 0 for k in kinds]
        some = np.array([i for i in range(n) if shapes[i] == 2 and len(outlines[i]) > 2], np.int64)
        if len(some):
            centre[some], yaw[some], size[some] = _around([outlines[i] for i in some], some, schema, world, turn)
            turned[some] = True
    size[~(size >= LEAST_SIZE_M)] = np.nan
    return size[:, 0], size[:, 1], centre, yaw, turned


def _around(
    outlines: list[list[tuple[float, float]]], some: IntArray, schema: ObjectSchema, world: Poses, turn: Poses | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Centres, headings and sizes of the rectangles around outlines, in the map."""
    boxes = smallest_rectangles(outlines)
    base = world if schema.outline_frame == "object" else turn
    if base is None:
        return boxes[:, :2], boxes[:, 2], boxes[:, 3:]
    inner = np.column_stack([boxes[:, :2], np.zeros(len(boxes))])
    half = 0.5 * boxes[:, 2]
    none = np.zeros(len(boxes))
    local = Poses(base.t[some], inner, np.column_stack([none, none, np.sin(half), np.cos(half)]))
    placed = composed(Poses(base.t[some], base.p[some], base.q[some]), local)
    return placed.p[:, :2], placed.yaw, boxes[:, 3:]


def _solids(types: tuple[Any, ...], dimensions: tuple[Any, ...]) -> FloatArray:
    """Length and width of solids: 1 box, 2 sphere (radius), 3 and 4 cylinder and cone (height, radius)."""
    out = np.full((len(types), 2), np.nan)
    for i, (kind, numbers) in enumerate(zip(types, dimensions, strict=True)):
        if kind == 1 and len(numbers) >= 2:
            out[i] = numbers[:2]
        elif kind == 2 and numbers:
            out[i] = 2.0 * numbers[0]
        elif kind in (3, 4) and len(numbers) >= 2:
            out[i] = 2.0 * numbers[1]
    return out


def _velocity(columns: list[tuple[Any, ...]], names: dict[str, int], n: int) -> FloatArray:
    """The velocity as logged `(n, 3)`; NaN where there is none, or it is not trusted, or all of the log's are 0."""
    if "twist" not in names:
        return np.full((n, 3), np.nan)
    velocity = np.array(columns[names["twist"] : names["twist"] + 3], dtype=np.float64).T
    if "trusted" in names:
        velocity[~np.array(columns[names["trusted"]], np.bool_)] = np.nan
    if not np.nan_to_num(velocity).any():
        velocity[:] = np.nan
    return velocity


def _identified(samples: Samples, with_ids: bool, t: IntArray, said: list[str]) -> Samples:
    """The samples with ids that are identities, each once a frame."""
    seconds = (t - t[0])[samples.message] / 1e9 if len(t) else np.empty(0)
    if with_ids and are_identities(samples.ids, samples.message, seconds, samples.x, samples.y):
        return samples
    sizes = np.where(samples.turned[:, None], np.column_stack([samples.length, samples.width]), np.nan)
    names = joined(samples.message, seconds, samples.x, samples.y, samples.kinds, sizes)
    count = int(names.max(initial=0))
    why = "are no identities (they jump)" if with_ids else "are not there"
    said.append(f"Ids of objects {why}: objects are joined from frame to frame by position, to {count} tracks.")
    return replace(samples, ids=[str(name) for name in names])


def _frame_of_twist(
    samples: Samples, in_frame: FloatArray, schema: ObjectSchema, t: IntArray, said: list[str]
) -> str | None:
    """The frame of the velocities by (2): "object" (those of `samples`) or "frame" `(m, 2)`; None: they are none."""
    if not np.isfinite(samples.vx).any():
        said.append("The log has no velocities of objects.")
        return None
    codes = np.unique(np.array(samples.ids, dtype=object).astype(str), return_inverse=True)[1]
    seconds = (t - t[0])[samples.message] / 1e9
    order = np.lexsort((seconds, codes))
    first = _firsts(codes[order])
    window = np.full(len(order), MOTION_S)
    moved = rates(seconds[order], np.array([samples.x, samples.y])[:, order], first, window, parabola=False)[0]
    logged = {"object": np.array([samples.vx, samples.vy])[:, order], "frame": in_frame[order].T}
    fits = {}
    for name, velocity in logged.items():
        asked = np.isfinite(moved).all(axis=0) & (np.hypot(*velocity) > MOVES_MPS) & (np.arange(len(order)) > first + 2)
        if asked.sum() < 10:
            return "object" if schema.twist_frame in ("object", "log") else "frame"
        apart = np.hypot(*(velocity - moved)[:, asked])
        fits[name] = float(np.median(apart / np.hypot(*velocity[:, asked])))
    best = min(fits, key=lambda name: (round(fits[name], 2), name != schema.twist_frame))
    words = {"object": "object's own frame", "frame": "message's frame"}
    if fits[best] > MISFIT:
        said.append(
            f"The logged velocities of objects do not fit their displacement (median difference {fits[best]:.0%} of the"
            " speed) and are not used."
        )
        return None
    if schema.twist_frame == "log" or best != schema.twist_frame:
        said.append(
            f"Velocities of objects are in the {words[best]}: they fit the displacement within {fits[best]:.0%}."
        )
    return best


def _firsts(codes: IntArray) -> IntArray:
    """Of sorted codes `(m,)`, the index of the first equal one."""
    starts = np.flatnonzero(np.diff(codes, prepend=-1))
    return np.repeat(starts, np.diff(np.append(starts, len(codes))))


def tracks_of(samples: Samples, t: FloatArray, said: list[str]) -> Tracks:
    """The samples as tracks; t `(k,)` s are the times of their messages."""
    if not len(samples):
        return Tracks.empty()
    names = np.array(samples.ids, dtype=object).astype(str)
    _, first_seen, codes = np.unique(names, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first_seen, kind="stable"), kind="stable")
    codes = rank[codes]
    order = np.lexsort((samples.message, codes))
    twice = np.r_[False, (np.diff(codes[order]) == 0) & (np.diff(samples.message[order]) == 0)]
    if twice.any():
        said.append(f"{int(twice.sum())} samples repeat an id within a frame: the first counts.")
    order = order[~twice]
    some, codes = samples.taken(order), codes[order]
    first = _firsts(codes)
    offsets = np.append(np.unique(first), len(codes))
    seconds = t[some.message]
    parts = [slice(*ends) for ends in pairwise(offsets)]
    kinds = tuple(Counter(some.kinds[part]).most_common(1)[0][0] for part in parts)
    yaw, length, width = _aligned(some, parts)
    yaw = _one_front(yaw, some, seconds, parts, kinds, said)
    sizes = _median_sizes(length, width, kinds, parts, said)
    vx, vy = _filled(some, seconds, first, kinds, np.diff(offsets), said)
    return Tracks(
        tuple(some.ids[part.start] for part in parts), kinds, *sizes, np.zeros(len(parts), np.bool_), offsets, seconds,
        some.x, some.y, yaw, vx, vy,
    )  # fmt: skip


def _aligned(samples: Samples, parts: list[slice]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Headings and sizes of rectangles around outlines, which may lie on any of four sides: each as the one before."""
    yaw, length, width = samples.yaw.copy(), samples.length.copy(), samples.width.copy()
    for part in parts:
        for i in range(part.start + 1, part.stop):
            if samples.turned[i] and samples.turned[i - 1]:
                turns = round((yaw[i - 1] - yaw[i]) / (0.5 * np.pi))
                yaw[i] += 0.5 * np.pi * turns
                if turns % 2:
                    length[i], width[i] = width[i], length[i]
    return yaw, length, width


def _one_front(
    yaw: FloatArray, samples: Samples, t: FloatArray, parts: list[slice], kinds: tuple[AgentKind, ...], said: list[str]
) -> FloatArray:
    """Headings of boxes whose front and back change places, so that none turns round from one sample to the next.

    The front is where an agent that moves goes, by most of its samples; of one that stands what most headings say.
    """
    out, turned = yaw.copy(), 0
    for part, kind in zip(parts, kinds, strict=True):
        if kind is AgentKind.PEDESTRIAN or part.stop - part.start < 2:
            continue
        # by how many half turns each differs from the one before, summed up
        steps = np.round(np.diff(yaw[part]) / np.pi)
        half = np.r_[0.0, np.cumsum(steps)]
        if not (half % 2).any():
            continue
        own = yaw[part] - np.pi * half
        along = np.diff(samples.x[part]) * np.cos(own[1:]) + np.diff(samples.y[part]) * np.sin(own[1:])
        speed = along / np.diff(t[part])
        moves = np.abs(speed) > MOVES_MPS
        backward = np.sum(np.sign(speed[moves])) < 0 if moves.mean() > 0.5 else (half % 2).mean() > 0.5
        out[part] = own + (np.pi if backward else 0.0)
        turned += int(min((half % 2).sum(), len(half) - (half % 2).sum()))
    if turned:
        said.append(f"{turned} samples of objects have front and back exchanged and are turned round.")
    return out


def _median_sizes(
    length: FloatArray, width: FloatArray, kinds: tuple[AgentKind, ...], parts: list[slice], said: list[str]
) -> tuple[FloatArray, FloatArray]:
    out, assumed, varied = np.empty((2, len(parts))), 0, 0
    for k, part in enumerate(parts):
        for row, column in enumerate((length, width)):
            values = column[part][np.isfinite(column[part])]
            out[row, k] = np.median(values) if len(values) else USUAL_SIZE_M[kinds[k]][row]
            assumed += not len(values)
            varied += bool(len(values) and np.ptp(values) > 0.01)
    if assumed:
        said.append("Some objects have no size: that of their kind is assumed.")
    if varied:
        said.append("An agent's box is the median of its sizes, its kind the one that it had most often.")
    return out[0], out[1]


def _filled(
    samples: Samples, t: FloatArray, first: IntArray, kinds: tuple[AgentKind, ...], counts: IntArray, said: list[str]
) -> tuple[FloatArray, FloatArray]:
    """The logged velocities, and where there are none the motion over a backward window; a first sample has none."""
    missing = ~(np.isfinite(samples.vx) & np.isfinite(samples.vy))
    if not missing.any():
        return samples.vx, samples.vy
    windows = np.array([OBJECT_WINDOW_S if kind is AgentKind.OBJECT else AGENT_WINDOW_S for kind in kinds])
    values = np.array([samples.x, samples.y])
    found = rates(t, values, first, np.repeat(windows, counts), parabola=False)[0]
    noise = np.repeat([NOISE_M.get(kind, NOISE_OTHERS_M) for kind in kinds], counts)
    explained = NOISES * noise >= np.hypot(*found) * spread(t, first, np.repeat(windows, counts))
    found = np.where(explained, 0.0, found)
    said.append(
        f"Velocities of objects ({missing.mean():.0%} of the samples) are derived from their positions in the last"
        f" {AGENT_WINDOW_S} s, of what is no road user in the last {OBJECT_WINDOW_S:g} s; what the noise of positions"
        " explains is a stand."
    )
    return np.where(missing, found[0], samples.vx), np.where(missing, found[1], samples.vy)


def without_ego(tracks: Tracks, t: FloatArray, x: FloatArray, y: FloatArray, said: list[str]) -> Tracks:
    """The tracks but for one that is the ego's own box; x, y `(n,)` are the ego's box centre at t, s."""
    if not len(tracks) or np.hypot(x - x[0], y - y[0]).max() < 10.0 * EGO_WITHIN_M:
        return tracks
    keep = np.ones(len(tracks.t), np.bool_)
    for i in range(len(tracks)):
        part = tracks.samples(i)
        own = tracks.t[part]
        inside = (own >= t[0]) & (own <= t[-1])
        if not inside.any() or np.ptp(own[inside]) < EGO_LEAST_S:
            continue
        away = np.hypot(np.interp(own, t, x) - tracks.x[part], np.interp(own, t, y) - tracks.y[part])[inside]
        travelled = np.ptp(np.interp(own[inside], t, x)) + np.ptp(np.interp(own[inside], t, y))
        if away.max() < EGO_WITHIN_M and travelled > 5.0 * EGO_WITHIN_M:
            keep[part] = False
            said.append(f"Object {tracks.ids[i]} is the ego itself and is left out.")
    return tracks if keep.all() else tracks.taken(keep)
