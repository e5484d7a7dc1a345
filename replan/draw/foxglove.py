"""Channels with Foxglove's well-known schemas, beside the native ones of a log or a trace
(`--foxglove`).

    /foxglove/road        SceneUpdate     once: lanes by their boundaries, crosswalks, the goal's
                          regions
    /foxglove/stop_lines  SceneUpdate     stop lines in the colours of their lights, whenever one
                          changes
    /foxglove/obstacles   SceneUpdate     once: agents that never move
    /foxglove/agents      SceneUpdate     all other agents, as boxes with their names, coloured by
                          kind
    /foxglove/tf          FrameTransform  `BASE` (the ego's rear axle) in `MAP`
    /foxglove/ego         SceneUpdate     once: the ego's box, bound to `BASE`
    /foxglove/onboard, /foxglove/plan    PosesInFrame    plans of the log's own planner, and of the
                                         trace
    /foxglove/plan_line   SceneUpdate     the plans of the trace as lines
    /foxglove/events      Log             the begin of each marked stretch of the log

The messages are Protobuf, from Foxglove's own package (extra `foxglove`). `MAP` has the coordinates
of the log, relative to its origin; the ground is z = 0. Each message replaces the whole content of
its topic, so that a viewer may jump to any time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields
from operator import attrgetter

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.errors import ConfigError
from replan.core.names import ShortNames
from replan.draw.markers import Marker
from replan.draw.recording import colours
from replan.draw.recording.road_layer import LIGHTS, STOP_SIGN
from replan.logs.agents import AgentKind, Agents
from replan.logs.mcap.trace_file import driven_scenario
from replan.logs.mcap.writer import Entry, log_times
from replan.logs.rules import Colour
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.trace import Trace, kept_samples

try:
    from foxglove_schemas_protobuf.Color_pb2 import Color
    from foxglove_schemas_protobuf.CubePrimitive_pb2 import CubePrimitive
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
    from foxglove_schemas_protobuf.KeyValuePair_pb2 import KeyValuePair
    from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
    from foxglove_schemas_protobuf.Log_pb2 import Log
    from foxglove_schemas_protobuf.Point3_pb2 import Point3
    from foxglove_schemas_protobuf.Pose_pb2 import Pose
    from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
    from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
    from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
    from foxglove_schemas_protobuf.SceneEntityDeletion_pb2 import SceneEntityDeletion
    from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
    from foxglove_schemas_protobuf.TextPrimitive_pb2 import TextPrimitive
    from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
    from google.protobuf.timestamp_pb2 import Timestamp
except ModuleNotFoundError:
    raise ConfigError(
        "--foxglove needs foxglove-schemas-protobuf: pip install 'replan[foxglove]'"
    ) from None

MAP, BASE = "map", "base_link"
# Least interval between samples of the ego and of agents: 50 Hz is more than a screen shows
STEP_S = 0.02
HEIGHT_M = {
    AgentKind.CAR: 1.5,
    AgentKind.TRUCK: 3.2,
    AgentKind.BUS: 3.2,
    AgentKind.MOTORCYCLE: 1.5,
    AgentKind.BICYCLE: 1.7,
    AgentKind.PEDESTRIAN: 1.75,
    AgentKind.OBJECT: 1.0,
}
"""Typical heights, for drawing only: a log has none."""
LINE_M = 0.1
"""Thickness of lines, m."""
LABEL_PX = 12.0
"""Size of names, pixels."""
LABEL_ABOVE_M = 0.3
"""Names stand this far above the box of their agent, m."""
AGENT_ALPHA = 200
"""Opacity of agents, of 255."""


def scenario_messages(scenario: Scenario, markers: Sequence[Marker] = ()) -> Iterator[Entry]:
    """The messages of a log and of its markers.

    Raises:
        LogError: A log time is before the epoch.
    """
    yield from _events(scenario, markers)
    yield from _road(scenario)
    yield from _agents(scenario)
    yield from _ego(scenario)
    plans = [(plan.known, plan.trajectory) for plan in scenario.onboard]
    yield from _plans("/foxglove/onboard", plans, scenario.start_ns)


def _events(scenario: Scenario, markers: Sequence[Marker]) -> Iterator[Entry]:
    """The begins of stretches of the log, in the order of time."""
    start = scenario.start_ns
    ordered = sorted(markers, key=attrgetter("begin"))
    times = log_times(np.array([marker.begin for marker in ordered]), start, "/foxglove/events")
    for time, marker in zip(times, ordered, strict=True):
        stamp, words = _stamp(time), marker.words
        log = Log(timestamp=stamp, level=Log.INFO, message=words, name=marker.kind)
        yield time, "/foxglove/events", log


def _agents(scenario: Scenario) -> Iterator[Entry]:
    """Agents that never move, once; the others at each time at which one of them was sampled, and
    at the end.
    """
    start, tracks, short = scenario.start_ns, scenario.tracks, scenario.short_names
    still = np.repeat(tracks.static, np.diff(tracks.offsets))
    if still.any():
        yield start, "/foxglove/obstacles", _boxes(tracks.taken(still).truth(0.0), start, short)
    if not still.all():
        moving = tracks.taken(~still)
        instants = _thin_times(np.unique(np.r_[moving.t, scenario.duration]))
        for t, time in zip(
            instants.tolist(), log_times(instants, start, "/foxglove/agents"), strict=True
        ):
            yield time, "/foxglove/agents", _boxes(moving.truth(t), time, short)


def _ego(scenario: Scenario) -> Iterator[Entry]:
    """The ego's poses, and once its box, which is bound to them."""
    start, ego, vehicle = scenario.start_ns, scenario.ego, scenario.vehicle
    thinned = np.isin(ego.t, _thin_times(ego.t))
    states = zip(
        ego.x[thinned].tolist(), ego.y[thinned].tolist(), ego.yaw[thinned].tolist(), strict=True
    )
    for time, (x, y, yaw) in zip(
        log_times(ego.t[thinned], start, "/foxglove/tf"), states, strict=True
    ):
        pose = FrameTransform(
            timestamp=_stamp(time),
            parent_frame_id=MAP,
            child_frame_id=BASE,
            translation=Vector3(x=x, y=y),
            rotation=_quaternion_of_yaw(yaw),
        )
        yield time, "/foxglove/tf", pose
    height = HEIGHT_M[AgentKind.CAR]
    size = Vector3(x=vehicle.length, y=vehicle.width, z=height)
    centre = _pose(vehicle.axle_to_center, 0.0, 0.0, 0.5 * height)
    box = CubePrimitive(pose=centre, size=size, color=_colour(colours.EGO))
    known = [KeyValuePair(key=f.name, value=str(getattr(vehicle, f.name))) for f in fields(vehicle)]
    entity = SceneEntity(
        timestamp=_stamp(start),
        frame_id=BASE,
        id="ego",
        frame_locked=True,
        metadata=known,
        cubes=[box],
    )
    yield start, "/foxglove/ego", SceneUpdate(entities=[entity])


def trace_messages(trace: Trace, scenario: Scenario) -> Iterator[Entry]:
    """The messages of a drive: those of its log, and its plans.

    Raises:
        LogError: A log time is before the epoch.
    """
    start = scenario.start_ns
    yield from scenario_messages(driven_scenario(trace, scenario))
    plans = [(frame.t, frame.plan.trajectory) for frame in trace.frames]
    yield from _plans("/foxglove/plan", plans, start)
    times = log_times(np.array([t for t, _ in plans]), start, "/foxglove/plan_line")
    for time, (_, plan) in zip(times, plans, strict=True):
        line = _line(np.column_stack([plan.x, plan.y])[kept_samples(plan.t)], colours.QP)
        yield time, "/foxglove/plan_line", _scene(time, [_entity("plan", time, [line])])


def _road(scenario: Scenario) -> Iterator[Entry]:
    """The road once, and all stop lines at the start and whenever a light changes.

    Lanes by boundaries (white, grey if they may be crossed, yellow to opposite lanes), crosswalks
    and the goal.
    """
    start, road, entities = scenario.start_ns, scenario.road, list[SceneEntity]()
    for lane in road.lanes.values():
        sides = []
        for side in ("left", "right"):
            inner = colours.MARKING if getattr(lane, f"{side}_crossable") else colours.EDGE
            colour = colours.OPPOSITE if getattr(lane, f"{side}_opposite") else inner
            sides.append(_line(getattr(lane, side), colour if lane.drivable else colours.FAINT))
        known = {"kind": lane.kind, "speed_limit_mps": f"{lane.speed_limit:.2f}"}
        entities.append(_entity(f"lane {lane.id}", start, sides, known))
    for crosswalk in road.crosswalks:
        entities.append(
            _entity(
                f"crosswalk {crosswalk.id}",
                start,
                [_line(crosswalk.polygon, colours.EDGE, closed=True)],
            )
        )
    regions = scenario.goal.regions if scenario.goal else ()
    if regions:
        entities.append(
            _entity("goal", start, [_line(region, colours.GOAL, closed=True) for region in regions])
        )
    yield start, "/foxglove/road", _scene(start, entities)
    if not road.stop_lines:
        return
    topic, lights = "/foxglove/stop_lines", {light.id: light for light in scenario.lights}
    changes = np.unique(np.concatenate([[0.0], *(light.t for light in scenario.lights)]))
    for t, time in zip(changes.tolist(), log_times(changes, start, topic), strict=True):
        entities = []
        for line in road.stop_lines:
            colour = STOP_SIGN if line.must_stop else colours.EDGE
            if line.light is not None:
                colour = LIGHTS[lights[line.light].at(t) if line.light in lights else Colour.OFF]
            entities.append(_entity(f"stop line {line.id}", time, [_line(line.points, colour)]))
        yield time, topic, _scene(time, entities)


def _boxes(agents: Agents, time: int, short: ShortNames) -> SceneUpdate:
    columns = (agents.x, agents.y, agents.yaw, agents.length, agents.width, agents.vx, agents.vy)
    rows = np.column_stack(columns).tolist()
    entities = []
    for name, kind, (x, y, yaw, length, width, vx, vy) in zip(
        agents.ids, agents.kinds, rows, strict=True
    ):
        height = HEIGHT_M[kind]
        size = Vector3(x=length, y=width, z=height)
        colour = _colour(colours.with_alpha(colours.KINDS[kind], AGENT_ALPHA))
        entity = _entity(
            name, time, [], {"kind": kind.value, "speed_mps": f"{np.hypot(vx, vy):.1f}"}
        )
        entity.cubes.append(
            CubePrimitive(pose=_pose(x, y, yaw, 0.5 * height), size=size, color=colour)
        )
        entity.texts.append(
            TextPrimitive(
                pose=_pose(x, y, 0.0, height + LABEL_ABOVE_M),
                billboard=True,
                font_size=LABEL_PX,
                scale_invariant=True,
                color=_colour(colours.TICK),
                text=short(name),
            )
        )
        entities.append(entity)
    return _scene(time, entities)


def _plans(topic: str, plans: Sequence[tuple[float, Trajectory]], start: int) -> Iterator[Entry]:
    """Plans at the times at which they were known, thinned by `kept_samples`."""
    times = log_times(np.array([known for known, _ in plans]), start, topic)
    for time, (_, plan) in zip(times, plans, strict=True):
        rows = kept_samples(plan.t)
        states = zip(
            plan.x[rows].tolist(), plan.y[rows].tolist(), plan.yaw[rows].tolist(), strict=True
        )
        poses = [_pose(x, y, yaw, 0.0) for x, y, yaw in states]
        yield time, topic, PosesInFrame(timestamp=_stamp(time), frame_id=MAP, poses=poses)


def _thin_times(t: FloatArray) -> FloatArray:
    """Thin increasing times: keep the first one, and each that is at least `STEP_S` after the last
    kept one.
    """
    times = [-np.inf]
    for time in t.tolist():
        if time >= times[-1] + STEP_S - 1e-9:
            times.append(time)
    return np.array(times[1:])


def _scene(time: int, entities: Iterable[SceneEntity]) -> SceneUpdate:
    """The new content of a topic: the entities replace all earlier ones."""
    gone = SceneEntityDeletion(timestamp=_stamp(time), type=SceneEntityDeletion.ALL)
    return SceneUpdate(deletions=[gone], entities=entities)


def _entity(
    name: str, time: int, lines: Sequence[LinePrimitive], metadata: dict[str, str] | None = None
) -> SceneEntity:
    known = [KeyValuePair(key=key, value=value) for key, value in (metadata or {}).items()]
    return SceneEntity(timestamp=_stamp(time), frame_id=MAP, id=name, metadata=known, lines=lines)


def _line(points: FloatArray, colour: int, *, closed: bool = False) -> LinePrimitive:
    """A polyline `(n, 2)` on the ground."""
    kind = LinePrimitive.LINE_LOOP if closed else LinePrimitive.LINE_STRIP
    drawn = [Point3(x=x, y=y) for x, y in points.tolist()]
    return LinePrimitive(
        type=kind,
        pose=_pose(0.0, 0.0, 0.0, 0.0),
        thickness=LINE_M,
        points=drawn,
        color=_colour(colour),
    )


def _pose(x: float, y: float, yaw: float, z: float) -> Pose:
    return Pose(position=Vector3(x=x, y=y, z=z), orientation=_quaternion_of_yaw(yaw))


def _quaternion_of_yaw(yaw: float) -> Quaternion:
    return Quaternion(z=np.sin(0.5 * yaw), w=np.cos(0.5 * yaw))


def _colour(packed: int) -> Color:
    """The colour of a packed value 0xRRGGBBAA."""
    red, green, blue, opacity = (byte / 255.0 for byte in packed.to_bytes(4))
    return Color(r=red, g=green, b=blue, a=opacity)


def _stamp(time: int) -> Timestamp:
    seconds, nanos = divmod(time, 1_000_000_000)
    return Timestamp(seconds=seconds, nanos=nanos)
