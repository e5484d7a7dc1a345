"""The scene: ego, agents, plan and log over time, in the world frame, and the agents from the
planner's point of view.

The camera follows the ego: a view whose origin is the entity `world/ego` moves with it. Agents are
drawn at their true positions (`Tracks.truth`), the ego as it drove. Logs have no heights: each kind
has a typical one.

world/predictions     the predicted path of each hypothesis, the likelier the brighter, to the
                      horizon
world/plan/alternatives  the trajectories among which the planner chose, the higher the score the
                      brighter
world/perceived       boxes as they were shown to the planner, if they differ from the true ones
world/sensor          the rim of the sensor's range and field of view, and the hidden ground within
                      it, hatched
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from math import atan2, ceil, cos, hypot, pi, sin

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from replan.core.arrays import FloatArray, IntArray
from replan.draw.drawn_scene import decided, path_of, plan_seconds, rows_in_full, score_ranks
from replan.draw.recording import colours
from replan.draw.recording.road_layer import (
    at_height,
    draw_goal,
    draw_lights,
    draw_lines,
    draw_road,
)
from replan.draw.recording.state_rows import places
from replan.draw.recording.tape import REMOVED, Instants, Tape, joined, pixels, plain
from replan.explain.planner_input import agents_shown
from replan.logs.agents import AgentKind, Agents, codes_of
from replan.logs.frame import Visibility
from replan.logs.plan import Decision, Plan
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
SLOWEST_MPS = 0.3  # Slower agents have no arrow
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
        labels = [plain(name) for agents in shown for name in agents.ids]
        draw_frames(tape, REMOVED, shown, instants, labels, colours.REMOVED, 0.8)


@dataclass(frozen=True, eq=False)
class SceneInstant:
    """The agents at one instant, as a scene shows them."""

    agents: Agents
    full: IntArray  # Rows of the agents that are drawn in full
    decisions: Mapping[str, Decision]  # The decision about each agent, of the plan in force
    ego: tuple[float, float, float]  # x, y, yaw


def draw_moving(
    tape: Tape, trace: Trace, kinds: Collection[AgentKind], instants: Instants, frames: Instants
) -> None:
    """Draw the agents at some instants, and the plans that are in force then (`trace.frames`).

    `kinds` are the kinds of all agents of the drive.
    """
    plans = [frame.plan for frame in trace.frames]
    decisions = [decided(plan) for plan in plans] or [{}]
    begin = int(frames.frame[0]) if plans else 0
    xy, yaw = _poses_at(trace.ego, instants.t)
    scene = []
    for t, frame, (x, y), heading in zip(
        instants.t, instants.frame, xy.tolist(), yaw.tolist(), strict=True
    ):
        agents = trace.agents.truth(float(t))
        in_force = decisions[min(int(frame) - begin, len(decisions) - 1)]
        full = rows_in_full(agents.ids, agents.x, agents.y, in_force, (x, y))
        scene.append(SceneInstant(agents, full, in_force, (x, y, heading)))
    for kind in AgentKind:
        if kind in kinds:
            _draw_kind(tape, kind, scene, instants)
    # the velocity of each moving agent that is drawn in full, as its displacement in one second
    moving = []
    for instant in scene:
        shown = instant.agents.some(instant.full)
        moving.append(shown.some(np.flatnonzero(np.nan_to_num(shown.speed) > SLOWEST_MPS)))
    starts, counts = joined([np.column_stack([agents.x, agents.y]) for agents in moving], 2)
    vectors, _ = joined([np.column_stack([agents.vx, agents.vy]) for agents in moving], 2)
    arrows = rr.Arrows3D.columns(origins=at_height(starts, 0.1), vectors=at_height(vectors, 0.0))
    tape.static("world/agents/velocity", rr.Arrows3D.from_fields(colors=[0xFFFFFFA0], radii=[0.05]))
    tape.rows("world/agents/velocity", instants, arrows, counts)
    _draw_names(tape, scene, instants)
    if not plans:
        return
    # Each plan as a line in the colours of its speed, with a dot at every full second
    lines, speeds, dots = [], [], []
    for plan in plans:
        path = plan.trajectory
        samples = np.linspace(0, len(path) - 1, min(len(path), PLAN_POINTS))
        rows: IntArray = np.unique(samples.round().astype(np.int64))
        xy, v = np.column_stack([path.x[rows], path.y[rows]]), path.v[rows]
        lines.append(np.stack([xy[:-1], xy[1:]], axis=1))
        speeds.append(0.5 * (v[:-1] + v[1:]))
        dots.append(plan_seconds(plan))
    pieces = np.concatenate(lines)
    colour = colours.of_speed(np.concatenate(speeds) / max(1.0, float(trace.ego.v.max())))
    drawn, counts = at_height(pieces.reshape(-1, 2), 0.12), [len(line) for line in lines]
    tape.lines(
        "world/plan/path", frames, drawn, np.full(len(pieces), 2), counts, colour, radii=[0.18]
    )
    _draw_alternatives(tape, plans, frames)
    points, counts = joined(dots, 2)
    tape.static("world/plan/seconds", rr.Points3D.from_fields(colors=[0xFFFFFFFF], radii=[0.22]))
    tape.rows(
        "world/plan/seconds", frames, rr.Points3D.columns(positions=at_height(points, 0.2)), counts
    )


def _draw_alternatives(tape: Tape, plans: Sequence[Plan], frames: Instants) -> None:
    """Draw the alternatives of each plan as a fan, if a plan has any."""
    if not any(plan.alternatives for plan in plans):
        return
    paths: list[FloatArray] = []
    shades: list[int] = []
    for plan in plans:
        paths += [path_of(alternative.trajectory) for alternative in plan.alternatives]
        opacities = [round(50 + 150 * rank) for rank in score_ranks(plan)]
        shades += [colours.with_alpha(colours.ALTERNATIVE, opacity) for opacity in opacities]
    points, lengths = joined(paths, 2)
    tape.lines(
        "world/plan/alternatives",
        frames,
        at_height(points, LOW),
        lengths,
        [len(plan.alternatives) for plan in plans],
        np.array(shades, dtype=np.uint32),
        radii=[pixels(1.5)],
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
    is_logged = (instants.t >= log.t[0] - 1e-9) & (instants.t <= log.t[-1] + 1e-9)
    xy, yaw = _poses_at(log, instants.t[is_logged])
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
    tape.rows("world/log/ego", instants, boxes, is_logged.astype(np.int64))


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
    boxes = _boxes(shown, EGO_HEIGHT, labels)
    style = rr.Boxes3D.from_fields(
        colors=[colour], fill_mode=FRAME_ONLY, radii=[pixels(px)], show_labels=False
    )
    tape.static(entity, style)
    tape.rows(entity, instants, boxes, [len(agents) for agents in shown])


def _boxes(
    shown: Sequence[Agents],
    height: float,
    labels: Sequence[str],
    shades: NDArray[np.uint32] | None = None,
) -> rr.ComponentColumnList:
    """The boxes of the agents of several instants."""

    def column(name: str) -> FloatArray:
        return np.concatenate([getattr(agents, name) for agents in shown])

    x, y = column("x"), column("y")
    sizes = np.column_stack([column("length"), column("width"), np.full(len(x), height)])
    return rr.Boxes3D.columns(
        centers=at_height(np.column_stack([x, y]), height / 2.0),
        half_sizes=0.5 * sizes,
        quaternions=quaternions(column("yaw")),
        labels=labels,
        colors=shades,
    )


def _draw_kind(
    tape: Tape, kind: AgentKind, scene: Sequence[SceneInstant], instants: Instants
) -> None:
    """Boxes of one kind of agent, faint if they are not drawn in full.

    Their ids are visible on hover.
    """
    code = codes_of((kind,))[0]
    rows = [np.flatnonzero(instant.agents.codes == code) for instant in scene]
    shown = [instant.agents.some(of_kind) for instant, of_kind in zip(scene, rows, strict=True)]
    is_full = np.concatenate(
        [np.isin(of_kind, instant.full) for instant, of_kind in zip(scene, rows, strict=True)]
    )
    ids = [name for agents in shown for name in agents.ids]
    labels = {name: plain(tape.short(name)) for name in set(ids)}
    faint = colours.with_alpha(colours.KINDS[kind], FAINT)
    shades = np.where(is_full, colours.KINDS[kind], faint).astype(np.uint32)
    boxes = _boxes(shown, HEIGHTS[kind], [labels[name] for name in ids], shades)
    entity = f"world/agents/{kind.value}"
    tape.static(entity, rr.Boxes3D.from_fields(fill_mode=FILLED, show_labels=False))
    tape.rows(entity, instants, boxes, [len(agents) for agents in shown])


def _draw_names(tape: Tape, scene: Sequence[SceneInstant], instants: Instants) -> None:
    """Ids of the agents that are drawn in full, with the decision in its colour.

    A name is beyond its agent, as seen from the ego, so that it hides no part of it. A label hangs
    below its point, so the point is raised by the height of the label, as seen from above and from
    behind the ego.
    """
    points, labels, shades = list[tuple[float, float, float]](), list[str](), list[int]()
    for instant in scene:
        agents, (ego_x, ego_y, ego_yaw) = instant.agents, instant.ego
        for row in instant.full:
            x, y = float(agents.x[row]), float(agents.y[row])
            turn = float(agents.yaw[row]) - ego_yaw
            length, width = float(agents.length[row]), float(agents.width[row])
            ahead_m = 0.5 * (abs(cos(turn)) * length + abs(sin(turn)) * width) + LABEL_M
            eye_m = hypot(x - ego_x, y - ego_y) + EYE_BACK_M
            height = HEIGHTS[agents.kinds[row]] + LABEL_RISE * eye_m
            points.append((x + ahead_m * cos(ego_yaw), y + ahead_m * sin(ego_yaw), height))
            name, decision = tape.short(agents.ids[row]), instant.decisions.get(agents.ids[row])
            labels.append(plain(f"{name}: {decision.kind.value}" if decision else name))
            shade = colours.DECISIONS[decision.kind] if decision else colours.TICK
            shades.append(colours.of_words(shade))
    entity = "world/agents/names"
    tape.static(entity, rr.Points3D.from_fields(radii=[pixels(0.01)], show_labels=True))
    names = rr.Points3D.columns(
        positions=np.array(points).reshape(-1, 3),
        labels=labels,
        colors=np.array(shades, dtype=np.uint32),
    )
    tape.rows(entity, instants, names, [len(instant.full) for instant in scene])


def draw_others(tape: Tape, trace: Trace, frames: Instants) -> None:
    """Draw predictions, perceived agents and the sensor, if the trace has them, one row per
    frame.
    """
    if any(frame.predictions is not None for frame in trace.frames):
        kinds = dict(zip(trace.agents.ids, trace.agents.kinds, strict=True))
        if trace.perceived is not None:
            kinds = dict(zip(trace.perceived.ids, trace.perceived.kinds, strict=True)) | kinds
        paths: list[FloatArray] = []
        shades: list[int] = []
        per_frame: list[int] = []
        for frame, (x, y) in zip(trace.frames, places(trace).tolist(), strict=True):
            hypotheses = futures(frame, x, y)
            for name, probability, path in hypotheses:
                # unlikely hypotheses stay visible
                opacity = round(50 + 150 * min(max(probability, 0.0), 1.0))
                shades.append(colours.with_alpha(colours.KINDS[kinds[name]], opacity))
                paths.append(path)
            per_frame.append(len(hypotheses))
        points, lengths = joined(paths, 2)
        drawn, colour_of = at_height(points, LOW), np.array(shades, dtype=np.uint32)
        tape.lines(
            "world/predictions", frames, drawn, lengths, per_frame, colour_of, radii=[pixels(1.2)]
        )
    if trace.frames and (len(trace.agents) or trace.perceived is not None):
        # with a sensor model: all agents that it shows; without one: agents that are extrapolated
        # after their log ended
        shown = [perceived_only(trace, float(t)) for t in frames.t]
        ids = (name for agents in shown for name in agents.ids)
        labels = [plain(f"{tape.short(name)} as perceived") for name in ids]
        if labels:
            draw_frames(tape, "world/perceived", shown, frames, labels, colours.PERCEIVED, 1.2)
    if not any(frame.visibility is not None for frame in trace.frames):
        return
    for name, draw, colour in (("edge", rim, colours.SENSOR), ("hidden", hatching, colours.HIDDEN)):
        lines = [
            draw(frame.visibility) if frame.visibility is not None else [] for frame in trace.frames
        ]
        points, lengths = joined(list(chain.from_iterable(lines)), 2)
        counts, drawn = [len(of_frame) for of_frame in lines], at_height(points, LOW / 2)
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
    predictions = frame.predictions
    if predictions is None or not len(predictions) or not len(predictions.t):
        return []
    xs, ys = predictions.x, predictions.y
    near = np.hypot(xs[:, 0] - x, ys[:, 0] - y) <= NEAR_M
    agents, first = np.unique(predictions.agent, return_index=True)
    ids = [frame.agents[agent] for agent in agents]
    full = rows_in_full(ids, xs[first, 0], ys[first, 0], decided(frame.plan), (x, y))
    reach = np.hypot(xs - xs[:, :1], ys - ys[:, :1]).max(axis=1)
    is_full = np.isin(predictions.agent, agents[full])
    return [
        (
            frame.agents[predictions.agent[row]],
            float(predictions.probability[row]),
            np.column_stack([xs[row], ys[row]]),
        )
        for row in np.flatnonzero(near & is_full & (reach >= SHORTEST_M))
    ]


def perceived_only(trace: Trace, t: float) -> Agents:
    """The agents that were shown to the planner in the frame at `t`, and are not drawn as true
    boxes.
    """
    shown = agents_shown(trace, t)
    true_boxes = set(trace.agents.ids_at(t) if trace.perceived is None else ())
    rows = [row for row, name in enumerate(shown.ids) if name not in true_boxes]
    return shown.some(np.array(rows, dtype=np.int64))


def unseen(trace: Trace, t: float) -> list[tuple[str, float]]:
    """The agents within `NEAR_M` of the ego at `t` that were not shown to the planner, and their
    distances, m.
    """
    if trace.perceived is None:
        return []
    agents, shown, ego = trace.agents.truth(t), set(perceived_only(trace, t).ids), trace.ego
    x, y = np.interp(t, ego.t, ego.x), np.interp(t, ego.t, ego.y)
    distances_m = np.hypot(agents.x - x, agents.y - y)
    return [
        (agents.ids[row], float(distances_m[row]))
        for row in np.argsort(distances_m, kind="stable")
        if distances_m[row] <= NEAR_M and agents.ids[row] not in shown
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
    sensor = np.array([[seen.x, seen.y]])
    return [edge if half >= pi else np.vstack([sensor, edge, sensor])]


def hatching(seen: Visibility) -> list[FloatArray]:
    """Lines of sight behind occluding agents: from the near edge of the shadow to the end of the
    range.
    """
    lines, sensor = list[FloatArray](), np.array([seen.x, seen.y])
    for near_right, _, _, near_left in seen.shadows:
        right, left = (atan2(y - seen.y, x - seen.x) for x, y in (near_right, near_left))
        width = (left - right) % (2.0 * pi)
        for u in np.linspace(0.0, 1.0, 2 + int(width / SHADOW_STEP)):
            start = near_right + u * (near_left - near_right)
            sight = start - sensor
            distance_m = float(np.hypot(*sight))
            if 1e-6 < distance_m < seen.range:
                end = sensor + sight * (seen.range / distance_m)
                lines.append(np.stack([start, end]))
    return lines
