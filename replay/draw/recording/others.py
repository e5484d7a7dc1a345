"""The agents from the planner's point of view: their predictions, and their boxes as they were shown to it.

world/predictions     the predicted path of each hypothesis, the likelier the brighter, to the horizon
world/perceived       boxes as they were shown to the planner, if they differ from the true ones
world/sensor          the rim of the sensor's range and field of view, and the hidden ground within it, hatched
"""

from __future__ import annotations

from math import atan2, ceil, pi

import numpy as np
import rerun as rr

from logs.frame import Visibility
from logs.kernel import FloatArray
from logs.scenario import Agents
from logs.trace import PlannedFrame, Trace
from replay.draw.recording import colours
from replay.draw.recording.scene import draw_frames
from replay.draw.recording.states import places
from replay.draw.recording.tape import Instants, Tape, joined, pixels, strips
from replay.draw.recording.text import plain
from replay.draw.scene import decided, in_full
from replay.explain.planner_input import SAME_TIME_S, picked

NEAR_M = 90.0
"""For agents farther from the ego than this, neither predictions nor missing detections are shown."""
SHORTEST_M = 0.5
"""A shorter predicted path is that of a standing agent."""
SHADOW_STEP = 0.03
"""Angle between two lines of the hatching of hidden ground, rad."""
ARC_STEP = 0.1
LOW, GHOST_HEIGHT = 0.06, 1.4


def draw_others(tape: Tape, trace: Trace, frames: Instants) -> None:
    """All of the above that the trace holds, a row per frame."""
    if any(frame.predictions is not None for frame in trace.frames):
        _draw_predictions(tape, trace, frames)
    if trace.frames and (len(trace.agents) or trace.perceived is not None):
        # with a sensor model: all agents that it showed; without: the agents that are carried on after their log ended
        shown = [perceived_only(trace, float(t)) for t in frames.t]
        labels = [plain(f"{tape.short(name)} as perceived") for some in shown for name in some.ids]
        if labels:
            draw_frames(tape, "world/perceived", shown, frames, GHOST_HEIGHT, labels, colours.PERCEIVED, 1.2)
    if not any(frame.visibility is not None for frame in trace.frames):
        return
    for name, draw, colour in (("edge", rim, colours.SENSOR), ("hidden", hatching, colours.HIDDEN)):
        entity = f"world/sensor/{name}"
        lines = [draw(frame.visibility) if frame.visibility is not None else [] for frame in trace.frames]
        points, lengths = joined([line for some in lines for line in some], 2)
        tape.static(entity, rr.LineStrips3D.from_fields(colors=[colour], radii=[pixels(0.8)]))
        drawn = strips(np.column_stack([points, np.full(len(points), LOW / 2)]), lengths)
        tape.rows(entity, frames, rr.LineStrips3D.columns(strips=drawn), [len(some) for some in lines])


def _draw_predictions(tape: Tape, trace: Trace, frames: Instants) -> None:
    known = [trace.agents] if trace.perceived is None else [trace.perceived, trace.agents]
    kinds = {name: kind for some in known for name, kind in zip(some.ids, some.kinds, strict=True)}
    lines: list[FloatArray] = []
    colour: list[int] = []
    counts: list[int] = []
    for frame, (x, y) in zip(trace.frames, places(trace).tolist(), strict=True):
        drawn = futures(frame, x, y)
        lines += [line for _, _, line in drawn]
        for name, p, _ in drawn:  # visible however unlikely
            colour.append(colours.with_alpha(colours.KINDS[kinds[name]], round(50 + 150 * min(max(p, 0.0), 1.0))))
        counts.append(len(drawn))
    points, lengths = joined(lines, 2)
    tape.static("world/predictions", rr.LineStrips3D.from_fields(radii=[pixels(1.2)]))
    shown = rr.LineStrips3D.columns(
        strips=strips(np.column_stack([points, np.full(len(points), LOW)]), lengths),
        colors=np.array(colour, dtype=np.uint32),
    )
    tape.rows("world/predictions", frames, shown, counts)


def futures(frame: PlannedFrame, x: float, y: float) -> list[tuple[str, float, FloatArray]]:
    """Agent, probability and path `(k, 2)` of each hypothesis that moves, for the agents that are drawn in full."""
    some = frame.predictions
    if some is None or not len(some) or not len(some.t):
        return []
    near = np.hypot(some.x[:, 0] - x, some.y[:, 0] - y) <= NEAR_M
    _, first = np.unique(some.agent, return_index=True)
    names = [frame.agents[some.agent[i]] for i in first]
    kept = some.agent[first][in_full(names, some.x[first, 0], some.y[first, 0], decided(frame.plan), (x, y))]
    reach = np.hypot(some.x - some.x[:, :1], some.y - some.y[:, :1]).max(axis=1)
    whose = np.zeros(len(frame.agents), np.bool_)
    whose[kept] = True
    rows = np.flatnonzero(near & whose[some.agent] & (reach >= SHORTEST_M))
    return [
        (frame.agents[some.agent[i]], float(some.probability[i]), np.column_stack([some.x[i], some.y[i]])) for i in rows
    ]


def perceived_only(trace: Trace, t: float) -> Agents:
    """The agents that were shown to the planner in the frame at `t`, and are not drawn as true boxes."""
    if trace.perceived is None:
        known, there = trace.agents.perceived(t), set(trace.agents.ids_at(t))
        rows = np.array([i for i, name in enumerate(known.ids) if name not in there], dtype=np.int64)
        return known.some(rows)
    tracks = trace.perceived
    at = np.flatnonzero(np.abs(tracks.t - t) < SAME_TIME_S)
    return picked(tracks, np.searchsorted(tracks.offsets, at, side="right") - 1, at)


def unseen(trace: Trace, t: float) -> list[tuple[str, float]]:
    """The agents within `NEAR_M` of the ego at `t` that were not shown to the planner, and their distances, m."""
    if trace.perceived is None:
        return []
    there, shown, ego = trace.agents.truth(t), set(perceived_only(trace, t).ids), trace.ego
    away = np.hypot(there.x - np.interp(t, ego.t, ego.x), there.y - np.interp(t, ego.t, ego.y))
    near = np.argsort(away, kind="stable")
    return [(there.ids[i], float(away[i])) for i in near if away[i] <= NEAR_M and there.ids[i] not in shown]


def rim(seen: Visibility) -> list[FloatArray]:
    """The rim of the sensor's range within its field of view; with two sides if that is less than all round."""
    half = min(0.5 * seen.field_of_view, pi)
    angles = seen.yaw + np.linspace(-half, half, 2 + ceil(2.0 * half / ARC_STEP))
    edge = np.column_stack([seen.x + seen.range * np.cos(angles), seen.y + seen.range * np.sin(angles)])
    here = np.array([[seen.x, seen.y]])
    return [edge if half >= pi else np.vstack([here, edge, here])]


def hatching(seen: Visibility) -> list[FloatArray]:
    """Lines of sight behind occluding agents: from the near edge of the shadow to the end of the range."""
    lines: list[FloatArray] = []
    for near_right, _, _, near_left in seen.shadows:
        right, left = (atan2(y - seen.y, x - seen.x) for x, y in (near_right, near_left))
        width = (left - right) % (2.0 * pi)
        for u in np.linspace(0.0, 1.0, 2 + int(width / SHADOW_STEP)):
            start = near_right + u * (near_left - near_right)
            away = float(np.hypot(*(start - (seen.x, seen.y))))
            if 1e-6 < away < seen.range:
                end = np.array([seen.x, seen.y]) + (start - (seen.x, seen.y)) * (seen.range / away)
                lines.append(np.stack([start, end]))
    return lines
