"""The scene: ego, agents, plan and log over time, in the world frame, and the agents from the
planner's point of view.

The camera follows the ego: a view whose origin is the entity `world/ego` moves with it. Agents are
drawn at their true positions (`Tracks.truth`), the ego as it drove. Logs have no heights: each kind
has a typical one.

world/predictions     the predicted path of each hypothesis, the likelier the brighter, to the
                      horizon
world/perceived       boxes as they were shown to the planner, if they differ from the true ones
world/sensor          the rim of the sensor's range and field of view, and the hidden ground within
                      it, hatched
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from math import atan2, ceil, cos, hypot, pi, sin

import numpy as np
import rerun as rr

from replan.core.arrays import FloatArray, IntArray
from replan.draw.model import decided, in_full, plan_seconds
from replan.draw.recording import colours
from replan.draw.recording.plots import places
from replan.draw.recording.road_layer import (
    at_height,
    draw_goal,
    draw_lights,
    draw_lines,
    draw_road,
)
from replan.draw.recording.tape import REMOVED, Instants, Tape, joined, pixels, plain
from replan.explain.planner_input import agents_shown
from replan.logs.agents import AgentKind, Agents
from replan.logs.frame import Visibility
from replan.logs.plan import Decision
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.trace import PlannedFrame, Trace

HEIGHTS = {
    AgentKind.CAR: 1.5,
    AgentKind.TRUCK: 3.2,
    AgentKind.BUS: 3.1,
    AgentKind.MOTORCYCLE: 1.5,
    AgentKind.BICYCLE: 1.6,
    AgentKind.PEDESTRIAN: 1.75,
    AgentKind.OBJECT: 1.0,
}
EGO_HEIGHT = 1.4
FAINT = 60  # Opacity of agents that are not drawn in full, of 255
LABEL_M, EYE_BACK_M, LABEL_RISE = 2.7, 18.0, 0.03
"""Height of a label from above.

Distance of the eye behind the ego; rise of a name per metre from the eye.
"""
PLAN_POINTS = 60
# For agents farther from the ego than this, neither predictions nor missing detections are shown
NEAR_M = 90.0
SHORTEST_M = 0.5  # A shorter predicted path is not drawn: the agent stands
SHADOW_STEP = 0.03  # Angle between two lines of the hatching of hidden ground, rad
ARC_STEP = 0.1
LOW = 0.06
FILLED = rr.components.FillMode.TransparentFillMajorWireframe
FRAME_ONLY = rr.components.FillMode.MajorWireframe


def quaternions(yaw: FloatArray) -> FloatArray:
    """Rotations about z `(n, 4)`, x y z w."""
    zero = np.zeros(len(yaw))
    return np.column_stack([zero, zero, np.sin(0.5 * yaw), np.cos(0.5 * yaw)])


def draw_scene(tape: Tape, trace: Trace, scenario: Scenario, instants: Instants) -> None:
    """Road, goal, lights, ego and log; agents and plans are drawn by `draw_moving`.

    The driven path has one piece per instant: the blueprint shows all pieces up to the cursor.
    """
    draw_road(tape, scenario.road)
    draw_goal(tape, scenario)
    draw_lights(tape, scenario, instants)
    vehicle, (xy, yaw) = scenario.vehicle, _poses_at(trace.ego, instants.t)
    poses = rr.Transform3D.columns(translation=at_height(xy, 0.0), quaternion=quaternions(yaw))
    tape.rows("world/ego", instants, poses)
    size = [vehicle.length / 2.0, vehicle.width / 2.0, EGO_HEIGHT / 2.0]
    center = [vehicle.axle_to_center, 0.0, EGO_HEIGHT / 2.0]
    box = rr.Boxes3D(
        centers=[center], half_sizes=[size], colors=colours.EGO, fill_mode=FILLED, labels=["ego"]
    )
    tape.static("world/ego/box", box, rr.Boxes3D.from_fields(show_labels=False))
    front, half = vehicle.axle_to_front, vehicle.width / 2.0
    nose = [
        [front - half, half, EGO_HEIGHT],
        [front, 0.0, EGO_HEIGHT],
        [front - half, -half, EGO_HEIGHT],
    ]
    tape.static("world/ego/nose", rr.LineStrips3D([nose], colors=0xFFFFFFFF, radii=0.04))
    pieces = np.stack([xy[np.maximum(np.arange(len(xy)) - 1, 0)], xy], axis=1)
    drawn, pairs = at_height(pieces.reshape(-1, 2), 0.04), np.full(len(xy), 2)
    tape.lines("world/driven", instants, drawn, pairs, colors=[colours.EGO], radii=[0.1])
    if trace.ego is not scenario.ego and len(scenario.ego) > 1:
        _draw_log(tape, trace, scenario, instants)
    if scenario.repair is not None and len(scenario.repair.removed):
        # Hidden by the blueprint at first
        shown = [scenario.repair.removed.perceived(float(t)) for t in instants.t]
        labels = [plain(name) for some in shown for name in some.ids]
        draw_frames(tape, REMOVED, shown, instants, labels, colours.REMOVED, 0.8)


def draw_moving(
    tape: Tape, trace: Trace, kinds: Collection[AgentKind], instants: Instants, frames: Instants
) -> None:
    """Draw the agents at some instants, and the plans that are in force then (`trace.frames`).

    `kinds` are the kinds of all agents of the drive.
    """
    agents = [trace.agents.truth(float(t)) for t in instants.t]
    plans = [frame.plan for frame in trace.frames]
    about = [decided(plan) for plan in plans] or [{}]
    begin = int(frames.frame[0]) if plans else 0
    here = [about[min(int(frame) - begin, len(about) - 1)] for frame in instants.frame]
    xy, yaw = _poses_at(trace.ego, instants.t)
    full = [
        in_full(some.ids, some.x, some.y, now, (x, y))
        for some, now, (x, y) in zip(agents, here, xy, strict=True)
    ]
    for kind in AgentKind:
        if kind in kinds:
            _draw_kind(tape, kind, agents, full, instants)
    # the velocity of each moving agent that is drawn in full, as its displacement in one second
    moving = [
        at[np.nan_to_num(some.speed)[at] > 0.3] for some, at in zip(agents, full, strict=True)
    ]
    starts, counts = joined(
        [np.column_stack([some.x, some.y])[at] for some, at in zip(agents, moving, strict=True)], 2
    )
    vectors, _ = joined(
        [np.column_stack([some.vx, some.vy])[at] for some, at in zip(agents, moving, strict=True)],
        2,
    )
    arrows = rr.Arrows3D.columns(origins=at_height(starts, 0.1), vectors=at_height(vectors, 0.0))
    tape.static("world/agents/velocity", rr.Arrows3D.from_fields(colors=[0xFFFFFFA0], radii=[0.05]))
    tape.rows("world/agents/velocity", instants, arrows, counts)
    _draw_names(tape, agents, full, here, np.column_stack([xy, yaw]), instants)
    if not plans:
        return
    # Each plan as a line in the colours of its speed, with a dot at every full second
    lines, speeds, dots = [], [], []
    for plan in plans:
        path = plan.trajectory
        at: IntArray = np.unique(
            np.linspace(0, len(path) - 1, min(len(path), PLAN_POINTS)).round().astype(np.int64)
        )
        xy = np.column_stack([path.x[at], path.y[at]])
        lines.append(np.stack([xy[:-1], xy[1:]], axis=1))
        speeds.append(0.5 * (path.v[at][:-1] + path.v[at][1:]))
        dots.append(plan_seconds(plan))
    pieces = np.concatenate(lines)
    colour = colours.of_speed(np.concatenate(speeds) / max(1.0, float(trace.ego.v.max())))
    drawn, counts = at_height(pieces.reshape(-1, 2), 0.12), [len(line) for line in lines]
    tape.lines(
        "world/plan/path", frames, drawn, np.full(len(pieces), 2), counts, colour, radii=[0.18]
    )
    points, counts = joined(dots, 2)
    tape.static("world/plan/seconds", rr.Points3D.from_fields(colors=[0xFFFFFFFF], radii=[0.22]))
    tape.rows(
        "world/plan/seconds", frames, rr.Points3D.columns(positions=at_height(points, 0.2)), counts
    )


def _poses_at(ego: Trajectory, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions `(n, 2)` and headings `(n,)` at times.

    Outside the span, those of the nearest end.
    """
    x, y, yaw = (np.interp(t, ego.t, column) for column in (ego.x, ego.y, ego.yaw))
    return np.column_stack([x, y]), yaw


def _draw_log(tape: Tape, trace: Trace, scenario: Scenario, instants: Instants) -> None:
    """The logged ego: its path, and in closed loop its box as a ghost until the end of the log."""
    log, vehicle = scenario.ego, scenario.vehicle
    path = np.column_stack([log.x, log.y])
    draw_lines(tape, "world/log/path", [path], colours.GHOST, 0.05, 0.02)
    if trace.commands is None:
        return
    there = (instants.t >= log.t[0] - 1e-9) & (instants.t <= log.t[-1] + 1e-9)
    xy, yaw = _poses_at(log, instants.t[there])
    center = xy + vehicle.axle_to_center * np.column_stack([np.cos(yaw), np.sin(yaw)])
    half = np.tile([vehicle.length / 2.0, vehicle.width / 2.0, EGO_HEIGHT / 2.0], (len(xy), 1))
    boxes = rr.Boxes3D.columns(
        centers=at_height(center, EGO_HEIGHT / 2.0), half_sizes=half, quaternions=quaternions(yaw)
    )
    style = rr.Boxes3D.from_fields(
        colors=[colours.GHOST],
        labels=["log"],
        show_labels=False,
        fill_mode=FRAME_ONLY,
        radii=[pixels(0.8)],
    )
    tape.static("world/log/ego", style)
    tape.rows("world/log/ego", instants, boxes, there.astype(np.int64))


def draw_frames(
    tape: Tape,
    entity: str,
    shown: Sequence[Agents],
    instants: Instants,
    labels: Sequence[str],
    colour: int,
    px: float,
) -> None:
    """Wireframe boxes of agents at instants, with lines of `px` pixels.

    Their labels are visible on hover.
    """
    x, y, yaw, length, width = (
        np.concatenate([getattr(some, name) for some in shown])
        for name in ("x", "y", "yaw", "length", "width")
    )
    boxes = rr.Boxes3D.columns(
        centers=at_height(np.column_stack([x, y]), EGO_HEIGHT / 2.0),
        half_sizes=0.5 * np.column_stack([length, width, np.full(len(x), EGO_HEIGHT)]),
        quaternions=quaternions(yaw),
        labels=labels,
    )
    style = rr.Boxes3D.from_fields(
        colors=[colour], fill_mode=FRAME_ONLY, radii=[pixels(px)], show_labels=False
    )
    tape.static(entity, style)
    tape.rows(entity, instants, boxes, [len(some) for some in shown])


def _draw_kind(
    tape: Tape,
    kind: AgentKind,
    agents: Sequence[Agents],
    full: Sequence[IntArray],
    instants: Instants,
) -> None:
    """Boxes of one kind of agent, faint if they are not drawn in full.

    Their ids are visible on hover.
    """
    chosen = [
        np.array([i for i, k in enumerate(some.kinds) if k is kind], dtype=np.int64)
        for some in agents
    ]
    x, y, yaw, length, width = (
        np.concatenate([getattr(some, name)[at] for some, at in zip(agents, chosen, strict=True)])
        for name in ("x", "y", "yaw", "length", "width")
    )
    height, xy = HEIGHTS[kind], np.column_stack([x, y])
    half = np.column_stack([length, width, np.full(len(xy), height)]) / 2.0
    names = {
        name: plain(tape.short(name)) for name in {name for some in agents for name in some.ids}
    }
    labels = [names[some.ids[i]] for some, at in zip(agents, chosen, strict=True) for i in at]
    seen = np.concatenate([np.isin(at, rows) for at, rows in zip(chosen, full, strict=True)])
    colour = np.where(
        seen, colours.KINDS[kind], colours.with_alpha(colours.KINDS[kind], FAINT)
    ).astype(np.uint32)
    boxes = rr.Boxes3D.columns(
        centers=at_height(xy, height / 2.0),
        half_sizes=half,
        quaternions=quaternions(yaw),
        labels=labels,
        colors=colour,
    )
    tape.static(
        f"world/agents/{kind.value}", rr.Boxes3D.from_fields(fill_mode=FILLED, show_labels=False)
    )
    tape.rows(f"world/agents/{kind.value}", instants, boxes, [len(at) for at in chosen])


def _draw_names(
    tape: Tape,
    agents: Sequence[Agents],
    full: Sequence[IntArray],
    here: Sequence[dict[str, Decision]],
    ego: FloatArray,
    instants: Instants,
) -> None:
    """Ids of the agents that are drawn in full, with the decision in its colour; `ego` `(n, 3)` x,
    y, yaw.

    A name is beyond its agent, as seen from the ego, so that it hides no part of it. A label hangs
    below its point, so the point is raised by the height of the label, as seen from above and from
    behind the ego.
    """
    points, words, colour = list[tuple[float, float, float]](), list[str](), list[int]()
    for some, rows, about, (x, y, yaw) in zip(agents, full, here, ego.tolist(), strict=True):
        for i in rows:
            decision, name = about.get(some.ids[i]), tape.short(some.ids[i])
            turn = float(some.yaw[i]) - yaw
            half = 0.5 * (
                abs(cos(turn)) * float(some.length[i]) + abs(sin(turn)) * float(some.width[i])
            )
            away = hypot(some.x[i] - x, some.y[i] - y) + EYE_BACK_M
            ahead, up = half + LABEL_M, HEIGHTS[some.kinds[i]] + LABEL_RISE * away
            points.append(
                (float(some.x[i] + ahead * cos(yaw)), float(some.y[i] + ahead * sin(yaw)), up)
            )
            words.append(plain(f"{name}: {decision.kind.value}" if decision else name))
            colour.append(
                colours.of_words(colours.DECISIONS[decision.kind] if decision else colours.TICK)
            )
    entity = "world/agents/names"
    tape.static(entity, rr.Points3D.from_fields(radii=[pixels(0.01)], show_labels=True))
    shown = rr.Points3D.columns(
        positions=np.array(points).reshape(-1, 3),
        labels=words,
        colors=np.array(colour, dtype=np.uint32),
    )
    tape.rows(entity, instants, shown, [len(rows) for rows in full])


def draw_others(tape: Tape, trace: Trace, frames: Instants) -> None:
    """Draw predictions, perceived agents and the sensor, if the trace has them, one row per
    frame.
    """
    if any(frame.predictions is not None for frame in trace.frames):
        known = [trace.agents] if trace.perceived is None else [trace.perceived, trace.agents]
        kinds = {
            name: kind for each in known for name, kind in zip(each.ids, each.kinds, strict=True)
        }
        paths: list[FloatArray] = []
        shades: list[int] = []
        per_frame: list[int] = []
        for frame, (x, y) in zip(trace.frames, places(trace).tolist(), strict=True):
            some = futures(frame, x, y)
            paths += [path for _, _, path in some]
            for name, p, _ in some:  # unlikely hypotheses stay visible
                shade = colours.with_alpha(
                    colours.KINDS[kinds[name]], round(50 + 150 * min(max(p, 0.0), 1.0))
                )
                shades.append(shade)
            per_frame.append(len(some))
        points, lengths = joined(paths, 2)
        drawn, colour_of = at_height(points, LOW), np.array(shades, dtype=np.uint32)
        tape.lines(
            "world/predictions", frames, drawn, lengths, per_frame, colour_of, radii=[pixels(1.2)]
        )
    if trace.frames and (len(trace.agents) or trace.perceived is not None):
        # with a sensor model: all agents that it shows; without one: agents that are extrapolated
        # after their log ended
        shown = [perceived_only(trace, float(t)) for t in frames.t]
        labels = [plain(f"{tape.short(name)} as perceived") for some in shown for name in some.ids]
        if labels:
            draw_frames(tape, "world/perceived", shown, frames, labels, colours.PERCEIVED, 1.2)
    if not any(frame.visibility is not None for frame in trace.frames):
        return
    for name, draw, colour in (("edge", rim, colours.SENSOR), ("hidden", hatching, colours.HIDDEN)):
        lines = [
            draw(frame.visibility) if frame.visibility is not None else [] for frame in trace.frames
        ]
        points, lengths = joined([line for some in lines for line in some], 2)
        counts, drawn = [len(some) for some in lines], at_height(points, LOW / 2)
        tape.lines(
            f"world/sensor/{name}",
            frames,
            drawn,
            lengths,
            counts,
            colors=[colour],
            radii=[pixels(0.8)],
        )


def futures(frame: PlannedFrame, x: float, y: float) -> list[tuple[str, float, FloatArray]]:
    """Agent, probability and path `(k, 2)` of each hypothesis that moves, for the agents that are
    drawn in full.
    """
    some = frame.predictions
    if some is None or not len(some) or not len(some.t):
        return []
    near = np.hypot(some.x[:, 0] - x, some.y[:, 0] - y) <= NEAR_M
    _, first = np.unique(some.agent, return_index=True)
    names = [frame.agents[some.agent[i]] for i in first]
    kept = some.agent[first][
        in_full(names, some.x[first, 0], some.y[first, 0], decided(frame.plan), (x, y))
    ]
    reach = np.hypot(some.x - some.x[:, :1], some.y - some.y[:, :1]).max(axis=1)
    whose = np.zeros(len(frame.agents), np.bool_)
    whose[kept] = True
    rows = np.flatnonzero(near & whose[some.agent] & (reach >= SHORTEST_M))
    return [
        (
            frame.agents[some.agent[i]],
            float(some.probability[i]),
            np.column_stack([some.x[i], some.y[i]]),
        )
        for i in rows
    ]


def perceived_only(trace: Trace, t: float) -> Agents:
    """The agents that were shown to the planner in the frame at `t`, and are not drawn as true
    boxes.
    """
    known, there = (
        agents_shown(trace, t),
        set(trace.agents.ids_at(t) if trace.perceived is None else ()),
    )
    return known.some(
        np.array([i for i, name in enumerate(known.ids) if name not in there], dtype=np.int64)
    )


def unseen(trace: Trace, t: float) -> list[tuple[str, float]]:
    """The agents within `NEAR_M` of the ego at `t` that were not shown to the planner, and their
    distances, m.
    """
    if trace.perceived is None:
        return []
    there, shown, ego = trace.agents.truth(t), set(perceived_only(trace, t).ids), trace.ego
    away = np.hypot(there.x - np.interp(t, ego.t, ego.x), there.y - np.interp(t, ego.t, ego.y))
    near = np.argsort(away, kind="stable")
    return [
        (there.ids[i], float(away[i]))
        for i in near
        if away[i] <= NEAR_M and there.ids[i] not in shown
    ]


def rim(seen: Visibility) -> list[FloatArray]:
    """The rim of the sensor's range within its field of view.

    With two sides if that is less than a circle.
    """
    half = min(0.5 * seen.field_of_view, pi)
    angles = seen.yaw + np.linspace(-half, half, 2 + ceil(2.0 * half / ARC_STEP))
    edge = np.column_stack(
        [seen.x + seen.range * np.cos(angles), seen.y + seen.range * np.sin(angles)]
    )
    here = np.array([[seen.x, seen.y]])
    return [edge if half >= pi else np.vstack([here, edge, here])]


def hatching(seen: Visibility) -> list[FloatArray]:
    """Lines of sight behind occluding agents: from the near edge of the shadow to the end of the
    range.
    """
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
