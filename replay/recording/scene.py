"""The scene: ego, agents, plan and log over time, in the world frame.

The camera follows by itself: a view whose origin is the entity `world/ego` moves with it. Agents are drawn as they were
(`Tracks.truth`), the ego as it drove. Heights are not in a log: a kind has a typical one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from logs.kernel import FloatArray, IntArray
from logs.scenario import AgentKind, Agents, Scenario
from logs.states import Trajectory
from logs.trace import Decision, DecisionKind, Plan, Trace
from logs.vehicle import VehicleParameters
from replay.recording import colours
from replay.recording.columns import Instants, Tape, joined, pixels, strips
from replay.recording.road import at_height, draw_goal, draw_lights, draw_lines, draw_road
from replay.recording.text import plain

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
LABEL_RANGE_M = 60.0
MAX_NEAR_LABELS = 8
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


def draw_moving(tape: Tape, trace: Trace, instants: Instants, frames: Instants) -> None:
    """The others at some instants, and the plans of some frames, those in force at the instants: `trace.frames`."""
    agents = [trace.agents.truth(float(t)) for t in instants.t]
    for kind in AgentKind:
        if kind in trace.agents.kinds:
            _draw_kind(tape, kind, agents, instants)
    _draw_velocities(tape, agents, instants)
    plans = [frame.plan for frame in trace.frames]
    _draw_names(tape, trace.ego, agents, plans, instants, int(frames.frame[0]) if plans else 0)
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


def _draw_kind(tape: Tape, kind: AgentKind, agents: Sequence[Agents], instants: Instants) -> None:
    """Boxes of one kind of agent; their ids show when they are pointed at."""
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
    names = {name: plain(name) for name in {name for some in agents for name in some.ids}}
    labels = [names[some.ids[i]] for some, at in zip(agents, chosen, strict=True) for i in at]
    style = rr.Boxes3D.from_fields(colors=[colours.KINDS[kind]], fill_mode=FILLED, show_labels=False)
    boxes = rr.Boxes3D.columns(
        centers=at_height(xy, height / 2.0), half_sizes=half, quaternions=quaternions(yaw), labels=labels
    )
    tape.static(f"world/agents/{kind.value}", style)
    tape.rows(f"world/agents/{kind.value}", instants, boxes, [len(at) for at in chosen])


def _draw_velocities(tape: Tape, agents: Sequence[Agents], instants: Instants) -> None:
    """Where each moving agent will be in a second at its velocity."""
    moving = [np.flatnonzero(np.nan_to_num(some.speed) > 0.3) for some in agents]
    starts, counts = joined([np.column_stack([some.x, some.y])[at] for some, at in zip(agents, moving, strict=True)], 2)
    vectors, _ = joined([np.column_stack([some.vx, some.vy])[at] for some, at in zip(agents, moving, strict=True)], 2)
    entity = "world/agents/velocity"
    tape.static(entity, rr.Arrows3D.from_fields(colors=[0xFFFFFFA0], radii=[0.05]))
    arrows = rr.Arrows3D.columns(origins=at_height(starts, 0.1), vectors=at_height(vectors, 0.0))
    tape.rows(entity, instants, arrows, counts)


def _decided(plan: Plan) -> dict[str, Decision]:
    """The decision to be named at each agent: the last that is not "ignore"."""
    found: dict[str, Decision] = {}
    for artefact in plan.internals:
        if isinstance(artefact, Decision) and artefact.kind is not DecisionKind.IGNORE:
            found[artefact.agent] = artefact
    return found


def _named(some: Agents, decided: dict[str, Decision], x: float, y: float) -> list[int]:
    """The agents to be labelled: those with a decision, then the nearest ones in sight."""
    away = np.hypot(some.x - x, some.y - y)
    near = [int(i) for i in np.argsort(away, kind="stable")[:MAX_NEAR_LABELS] if away[i] <= LABEL_RANGE_M]
    return sorted({i for i, name in enumerate(some.ids) if name in decided} | set(near))


def _draw_names(
    tape: Tape,
    ego: Trajectory,
    agents: Sequence[Agents],
    plans: Sequence[Plan],
    instants: Instants,
    begin: int,
) -> None:
    """Ids above the agents that matter, with the decision in its colour; `begin` is the frame of the first plan."""
    xy, _ = _resampled(ego, instants.t)
    decided = [_decided(plan) for plan in plans] or [{}]
    points: list[tuple[float, float, float]] = []
    words: list[str] = []
    colour: list[int] = []
    counts: list[int] = []
    for some, frame, (x, y) in zip(agents, instants.frame, xy, strict=True):
        here = decided[min(int(frame) - begin, len(decided) - 1)]
        named = _named(some, here, float(x), float(y))
        counts.append(len(named))
        for i in named:
            decision = here.get(some.ids[i])
            points.append((float(some.x[i]), float(some.y[i]), HEIGHTS[some.kinds[i]] + 1.2))
            words.append(plain(f"{some.ids[i]}: {decision.kind.value}" if decision else some.ids[i]))
            colour.append(colours.DECISIONS[decision.kind] if decision else colours.TICK)
    entity = "world/agents/names"
    tape.static(entity, rr.Points3D.from_fields(radii=[pixels(0.01)], show_labels=True))
    shown = rr.Points3D.columns(
        positions=np.array(points).reshape(-1, 3), labels=words, colors=np.array(colour, dtype=np.uint32)
    )
    tape.rows(entity, instants, shown, counts)


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
