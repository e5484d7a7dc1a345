"""The scene: ego, agents, plan and log over time, in the world frame.

The camera follows by itself: a view whose origin is the entity `world/ego` moves with it. Agents are drawn as they were
(`Tracks.truth`), the ego as it drove. Heights are not in a log: a kind has a typical one.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from math import cos, hypot, sin

import numpy as np
import rerun as rr

from logs.kernel import BoolArray, FloatArray, IntArray
from logs.scenario import AgentKind, Agents, Scenario, Tracks
from logs.states import Trajectory
from logs.trace import Decision, Plan, Trace
from logs.vehicle import VehicleParameters
from replay.draw.recording import colours
from replay.draw.recording.attention import decided, in_full
from replay.draw.recording.columns import REMOVED, Instants, Tape, joined, pixels, strips
from replay.draw.recording.road import at_height, draw_goal, draw_lights, draw_lines, draw_road
from replay.draw.recording.text import plain

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
FAINT = 60
"""Opacity of those who are not drawn in full, of 255."""
LABEL_M, EYE_BACK_M, LABEL_RISE = 2.7, 18.0, 0.03
"""A label's height from above; how far behind the ego the eye is; by how much a name is raised per metre from there."""
PLAN_POINTS = 60
FILLED = rr.components.FillMode.TransparentFillMajorWireframe


def quaternions(yaw: FloatArray) -> FloatArray:
    """Rotations about z `(n, 4)`, x y z w."""
    zero = np.zeros(len(yaw))
    return np.column_stack([zero, zero, np.sin(0.5 * yaw), np.cos(0.5 * yaw)])


def draw_scene(tape: Tape, trace: Trace, scenario: Scenario, instants: Instants) -> None:
    """Road, goal, lights, ego and log; the others and the plans: `draw_moving`."""
    draw_road(tape, scenario.road)
    draw_goal(tape, scenario)
    draw_lights(tape, scenario, instants)
    _draw_ego(tape, trace.ego, scenario.vehicle, instants)
    _draw_driven(tape, trace.ego, instants)
    if trace.ego is not scenario.ego and len(scenario.ego) > 1:
        _draw_log(tape, trace, scenario, instants)
    if scenario.repair is not None and len(scenario.repair.removed):
        _draw_removed(tape, scenario.repair.removed, instants)


def draw_moving(tape: Tape, trace: Trace, kinds: Collection[AgentKind], instants: Instants, frames: Instants) -> None:
    """The others at some instants, and the plans of some frames, those in force at the instants: `trace.frames`.

    `kinds` are those of all road users of the drive.
    """
    agents = [trace.agents.truth(float(t)) for t in instants.t]
    plans = [frame.plan for frame in trace.frames]
    here = _decided_at(plans, instants, int(frames.frame[0]) if plans else 0)
    xy, yaw = _resampled(trace.ego, instants.t)
    full = [
        in_full(some.ids, some.x, some.y, about, (x, y)) for some, about, (x, y) in zip(agents, here, xy, strict=True)
    ]
    for kind in AgentKind:
        if kind in kinds:
            _draw_kind(tape, kind, agents, full, instants)
    _draw_velocities(tape, agents, full, instants)
    _draw_names(tape, agents, full, here, np.column_stack([xy, yaw]), instants)
    if plans:
        _draw_plans(tape, plans, frames, max(1.0, float(trace.ego.v.max())))


def _resampled(ego: Trajectory, t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions `(n, 2)` and headings `(n,)` at times; the ends hold outside the span."""
    return (
        np.column_stack([np.interp(t, ego.t, ego.x), np.interp(t, ego.t, ego.y)]),
        np.interp(t, ego.t, ego.yaw),
    )


def _draw_ego(tape: Tape, ego: Trajectory, vehicle: VehicleParameters, instants: Instants) -> None:
    xy, yaw = _resampled(ego, instants.t)
    poses = rr.Transform3D.columns(translation=at_height(xy, 0.0), quaternion=quaternions(yaw))
    tape.rows("world/ego", instants, poses)
    size = [vehicle.length / 2.0, vehicle.width / 2.0, EGO_HEIGHT / 2.0]
    center = [vehicle.axle_to_center, 0.0, EGO_HEIGHT / 2.0]
    box = rr.Boxes3D(centers=[center], half_sizes=[size], colors=colours.EGO, fill_mode=FILLED, labels=["ego"])
    tape.static("world/ego/box", box, rr.Boxes3D.from_fields(show_labels=False))
    front, half = vehicle.axle_to_front, vehicle.width / 2.0
    nose = [[front - half, half, EGO_HEIGHT], [front, 0.0, EGO_HEIGHT], [front - half, -half, EGO_HEIGHT]]
    tape.static("world/ego/nose", rr.LineStrips3D([nose], colors=0xFFFFFFFF, radii=0.04))


def _draw_driven(tape: Tape, ego: Trajectory, instants: Instants) -> None:
    """One piece of the driven path per instant; the blueprint shows all pieces up to the cursor."""
    xy, _ = _resampled(ego, instants.t)
    pieces = np.stack([xy[np.maximum(np.arange(len(xy)) - 1, 0)], xy], axis=1)
    lines = strips(at_height(pieces.reshape(-1, 2), 0.04), np.full(len(xy), 2))
    tape.static("world/driven", rr.LineStrips3D.from_fields(colors=[colours.EGO], radii=[0.1]))
    tape.rows("world/driven", instants, rr.LineStrips3D.columns(strips=lines))


def _draw_log(tape: Tape, trace: Trace, scenario: Scenario, instants: Instants) -> None:
    """The logged ego: its path, and in closed loop its box as a ghost for as long as the log lasts."""
    log, vehicle = scenario.ego, scenario.vehicle
    path = np.column_stack([log.x, log.y])
    draw_lines(tape, "world/log/path", [path], colours.GHOST, 0.05, 0.02)
    if trace.commands is None:
        return
    there = (instants.t >= log.t[0] - 1e-9) & (instants.t <= log.t[-1] + 1e-9)
    xy, yaw = _resampled(log, instants.t[there])
    center = xy + vehicle.axle_to_center * np.column_stack([np.cos(yaw), np.sin(yaw)])
    half = np.tile([vehicle.length / 2.0, vehicle.width / 2.0, EGO_HEIGHT / 2.0], (len(xy), 1))
    style = rr.Boxes3D.from_fields(
        colors=[colours.GHOST],
        labels=["log"],
        show_labels=False,
        fill_mode=rr.components.FillMode.MajorWireframe,
        radii=[pixels(0.8)],
    )
    tape.static("world/log/ego", style)
    boxes = rr.Boxes3D.columns(
        centers=at_height(center, EGO_HEIGHT / 2.0), half_sizes=half, quaternions=quaternions(yaw)
    )
    tape.rows("world/log/ego", instants, boxes, there.astype(np.int64))


def _draw_removed(tape: Tape, removed: Tracks, instants: Instants) -> None:
    """The tracks that a repair removed, while each is valid; the blueprint hides them at first."""
    shown = [removed.perceived(float(t)) for t in instants.t]
    x, y, yaw, length, width = (
        np.concatenate([getattr(some, name) for some in shown]) for name in ("x", "y", "yaw", "length", "width")
    )
    style = rr.Boxes3D.from_fields(
        colors=[colours.REMOVED],
        fill_mode=rr.components.FillMode.MajorWireframe,
        radii=[pixels(0.8)],
        show_labels=False,
    )
    half = 0.5 * np.column_stack([length, width, np.full(len(x), EGO_HEIGHT)])
    boxes = rr.Boxes3D.columns(
        centers=at_height(np.column_stack([x, y]), EGO_HEIGHT / 2.0),
        half_sizes=half,
        quaternions=quaternions(yaw),
        labels=[plain(name) for some in shown for name in some.ids],
    )
    tape.static(REMOVED, style)
    tape.rows(REMOVED, instants, boxes, [len(some) for some in shown])


def _decided_at(plans: Sequence[Plan], instants: Instants, begin: int) -> list[dict[str, Decision]]:
    """What the plan in force at each instant decides about each agent; `begin` is the frame of the first plan."""
    each = [decided(plan) for plan in plans] or [{}]
    return [each[min(int(frame) - begin, len(each) - 1)] for frame in instants.frame]


def _draw_kind(
    tape: Tape, kind: AgentKind, agents: Sequence[Agents], full: Sequence[IntArray], instants: Instants
) -> None:
    """Boxes of one kind of agent, faint of those who are not drawn in full; their ids show when they are pointed at."""
    chosen = [np.array([i for i, k in enumerate(some.kinds) if k is kind], dtype=np.int64) for some in agents]
    xy, length, width, yaw = (
        np.concatenate([column[at] for column, at in zip(columns, chosen, strict=True)])
        for columns in (
            [np.column_stack([some.x, some.y]) for some in agents],
            [some.length for some in agents],
            [some.width for some in agents],
            [some.yaw for some in agents],
        )
    )
    height = HEIGHTS[kind]
    half = np.column_stack([length, width, np.full(len(xy), height)]) / 2.0
    names = {name: plain(tape.short(name)) for name in {name for some in agents for name in some.ids}}
    labels = [names[some.ids[i]] for some, at in zip(agents, chosen, strict=True) for i in at]
    seen = np.concatenate([_marked(some, len(all_))[at] for at, some, all_ in zip(chosen, full, agents, strict=True)])
    colour = np.where(seen, colours.KINDS[kind], colours.with_alpha(colours.KINDS[kind], FAINT)).astype(np.uint32)
    style = rr.Boxes3D.from_fields(fill_mode=FILLED, show_labels=False)
    boxes = rr.Boxes3D.columns(
        centers=at_height(xy, height / 2.0),
        half_sizes=half,
        quaternions=quaternions(yaw),
        labels=labels,
        colors=colour,
    )
    tape.static(f"world/agents/{kind.value}", style)
    tape.rows(f"world/agents/{kind.value}", instants, boxes, [len(at) for at in chosen])


def _marked(rows: IntArray, count: int) -> BoolArray:
    """Which of so many are among the rows."""
    out = np.zeros(count, np.bool_)
    out[rows] = True
    return out


def _draw_velocities(tape: Tape, agents: Sequence[Agents], full: Sequence[IntArray], instants: Instants) -> None:
    """Where each moving agent that is drawn in full will be in a second at its velocity."""
    moving = [at[np.nan_to_num(some.speed)[at] > 0.3] for some, at in zip(agents, full, strict=True)]
    starts, counts = joined([np.column_stack([some.x, some.y])[at] for some, at in zip(agents, moving, strict=True)], 2)
    vectors, _ = joined([np.column_stack([some.vx, some.vy])[at] for some, at in zip(agents, moving, strict=True)], 2)
    entity = "world/agents/velocity"
    tape.static(entity, rr.Arrows3D.from_fields(colors=[0xFFFFFFA0], radii=[0.05]))
    arrows = rr.Arrows3D.columns(origins=at_height(starts, 0.1), vectors=at_height(vectors, 0.0))
    tape.rows(entity, instants, arrows, counts)


def _beyond(some: Agents, i: int, eye: Sequence[float]) -> tuple[float, float, float]:
    """Where the name of an agent goes, so that it hides no part of them: beyond them as the ego sees them.

    A label hangs below its point, so that is by its height, as seen from above and from behind the ego.
    """
    x, y, yaw = eye
    turn = float(some.yaw[i]) - yaw
    half = 0.5 * (abs(cos(turn)) * float(some.length[i]) + abs(sin(turn)) * float(some.width[i]))
    away = hypot(some.x[i] - x, some.y[i] - y) + EYE_BACK_M
    ahead, up = half + LABEL_M, HEIGHTS[some.kinds[i]] + LABEL_RISE * away
    return float(some.x[i] + ahead * cos(yaw)), float(some.y[i] + ahead * sin(yaw)), up


def _draw_names(
    tape: Tape,
    agents: Sequence[Agents],
    full: Sequence[IntArray],
    here: Sequence[dict[str, Decision]],
    ego: FloatArray,
    instants: Instants,
) -> None:
    """Ids above the agents that are drawn in full, with the decision in its colour; `ego` `(n, 3)` x, y, yaw."""
    points: list[tuple[float, float, float]] = []
    words: list[str] = []
    colour: list[int] = []
    for some, rows, about, eye in zip(agents, full, here, ego.tolist(), strict=True):
        for i in rows:
            decision, name = about.get(some.ids[i]), tape.short(some.ids[i])
            points.append(_beyond(some, int(i), eye))
            words.append(plain(f"{name}: {decision.kind.value}" if decision else name))
            colour.append(colours.of_words(colours.DECISIONS[decision.kind] if decision else colours.TICK))
    entity = "world/agents/names"
    tape.static(entity, rr.Points3D.from_fields(radii=[pixels(0.01)], show_labels=True))
    shown = rr.Points3D.columns(
        positions=np.array(points).reshape(-1, 3), labels=words, colors=np.array(colour, dtype=np.uint32)
    )
    tape.rows(entity, instants, shown, [len(rows) for rows in full])


def _draw_plans(tape: Tape, plans: Sequence[Plan], frames: Instants, fastest: float) -> None:
    """Each plan as a line in the colours of its speed, with a dot at every full second."""
    lines, speeds, dots = [], [], []
    for plan in plans:
        path = plan.trajectory
        at: IntArray = np.unique(np.linspace(0, len(path) - 1, min(len(path), PLAN_POINTS)).round().astype(np.int64))
        xy = np.column_stack([path.x[at], path.y[at]])
        lines.append(np.stack([xy[:-1], xy[1:]], axis=1))
        speeds.append(0.5 * (path.v[at][:-1] + path.v[at][1:]))
        seconds = np.arange(path.t[0] + 1.0, path.t[-1] + 1e-6, 1.0)
        dots.append(_resampled(path, seconds)[0])
    pieces = np.concatenate(lines)
    colour = colours.of_speed(np.concatenate(speeds) / fastest)
    drawn = strips(at_height(pieces.reshape(-1, 2), 0.12), np.full(len(pieces), 2))
    tape.static("world/plan/path", rr.LineStrips3D.from_fields(radii=[0.18]))
    tape.rows(
        "world/plan/path",
        frames,
        rr.LineStrips3D.columns(strips=drawn, colors=colour),
        [len(line) for line in lines],
    )
    points, counts = joined(dots, 2)
    tape.static("world/plan/seconds", rr.Points3D.from_fields(colors=[0xFFFFFFFF], radii=[0.22]))
    tape.rows("world/plan/seconds", frames, rr.Points3D.columns(positions=at_height(points, 0.2)), counts)
