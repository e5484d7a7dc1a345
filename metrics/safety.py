"""Collisions, gaps, time to collision, and leaving the road.

Closed loop: compares the ego's box along its drive with the others' boxes as they moved.
`proposals` judges plans by the same rules, in both loops.

Collision: two boxes touch or overlap; each agent counts once. The kind is the first that applies,
in nuPlan's order (FROM_START and CUT_IN are additions of replan):

    FROM_START      they touch when the drive begins or the other first appears              not at
                    fault
    STOPPED_EGO     the ego stands (<= 0.05 m/s)
        not at fault
    STOPPED_TRACK   the other stands or is an object, and did not come from behind           at
                    fault
    CUT_IN          as ACTIVE_REAR, within reach of the lane entry of the ego before it
                    (`cut_in`)        at fault
    ACTIVE_REAR     the other's centre is behind: more than 150 degrees off the heading, seen from
                    the rear axle
                                                                                             not at
                                                                                             fault
    ACTIVE_FRONT    the ego's front bumper touches                                           at
                    fault
    LATERAL         any other                          at fault unless the ego keeps its lane
                    (`lanes.keeps_lane`)

The other came from behind if its centre is behind, as in ACTIVE_REAR, and the boxes would not touch
if it had stayed where it was one step before. Objects without a kind may be following vehicles, and
an ego that moves away from a slow road user does not drive into it.

Time to collision TTC: the greater of two times until the boxes touch, so neither a course that a
turn leaves nor one that a turn enters is a danger yet. TTC is never less than the straight time,
which the scores of nuPlan and NAVSIM use:

    straight   both go on with their velocity vectors and headings (`shapes.time_to_contact`)
    turning    both turn as they do now, at constant speed and yaw rate, for `TURN_S`, then go
               straight on
               (`shapes.time_to_contact_turning`): the ego at v kappa, the others as estimated
               (`replan.logs.motion`)

Both up to 10 s; agents behind (as above), agents from their first contact on, and a standing ego
(<= 0.005 m/s) have none. At a collision at fault TTC is 0, also with agents behind. Each step,
including the last, has a duration w_k (`metric.durations`):

(1) TET = sum of w_k [TTC_k < tau],  time exposed, s;
        TIT = sum of w_k (tau - TTC_k) [TTC_k <= tau],  time integrated,
    s2: the published variant; another variant integrates 1 / TTC - 1 / tau and is infinite at a
    contact

Severity, at the first touch of each road user, with the velocity vectors v, the ego's mass m_e and
that of the other's class m_o (`MASS_KG`; an object is immovable; nuPlan assumes 2000 kg for both).
Not measured for FROM_START:

(2) impact speed = |v_e - v_o|, m/s
(3) delta-v of the ego = m_o / (m_o + m_e) |v_e - v_o|:
        the change of its velocity if both stick together

Off the road: the greatest distance of the ego's outline to the drivable lanes, at points at most
`OUTLINE_M` apart, including its corners. This also detects the corner of a kerb that reaches into
the side of a turning car; anything inside the box has crossed its outline.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from functools import partial
from itertools import pairwise
from math import ceil, cos, hypot, inf, sin
from types import MappingProxyType

import numpy as np

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.core.kernel import kernel
from replan.core.once import once
from replan.logs.agents import AgentKind
from replan.logs.road import RoadSource
from replan.logs.scenario import Scenario
from replan.logs.shapes import corners, distance, overlap
from replan.logs.states import Trajectory
from replan.logs.trace import Mode, Trace
from replan.logs.tracks import Tracks
from replan.logs.vehicle import VehicleParameters
from replan.metrics import metric
from replan.metrics.boxes import (
    NO_TTC_MPS,
    STANDING_MPS,
    TURN_S,
    EgoOutline,
    OtherBoxes,
    car_of,
    contact_time,
    distance_bound,
    ego_boxes,
    indices_of,
    is_behind,
    labels_of,
    name_of,
    nearest,
    pieces,
    some_at,
    touches,
)
from replan.metrics.cut_in import forces_hit
from replan.metrics.lanes import LaneArrays, drivable_lanes, keeps_lane, off_lanes
from replan.metrics.metric import Measured, Metric, Reduction, Series, Unavailable

TTC_HORIZON_S, CLOSE_S = 10.0, 0.95  # Horizon of the time to collision, and nuPlan's bound on it
TAU_S = 1.5  # Critical TTC (criticality metrics catalogue, Westhofen et al. 2023)
CATALOGUE = "criticality metrics catalogue, Westhofen et al., Arch. Comput. Methods Eng. 30 (2023)"
OFF_ROAD_M = 0.3
OUTLINE_M = 0.25  # Between two points the outline is at most half of this farther off than at them
# Required distance when passing, by the ego's speed, linear between
PASSING_MPS, PASSING_M = (3.0, 5.0), (0.5, 1.0)
LEAVING_MPS = 0.5  # An agent that moves away sideways this fast has crossed and is not being passed
PERSON_KG = 75.0  # A driver: Regulation (EU) No 1230/2012
MASS_KG: Mapping[AgentKind, float] = MappingProxyType(
    {
        AgentKind.CAR: 1500.0,  # EN 1317-1, test vehicle of TB 32
        AgentKind.TRUCK: 10_000.0,  # EN 1317-1, rigid heavy goods vehicle of TB 42
        AgentKind.BUS: 13_000.0,  # EN 1317-1, bus of TB 51
        AgentKind.MOTORCYCLE: PERSON_KG + 200.0,  # a middle-weight motorcycle, rounded
        AgentKind.BICYCLE: PERSON_KG + 15.0,  # a city bicycle, rounded
        AgentKind.PEDESTRIAN: PERSON_KG,
        AgentKind.OBJECT: np.inf,
    }
)
PARTS = ("impact_speed", "delta_v")


class ContactKind(Enum):
    """The kind of a collision (module docstring)."""

    FROM_START = "appeared where the ego was"
    STOPPED_EGO = "the ego stood"
    STOPPED_TRACK = "into something that stood"
    ACTIVE_REAR = "from behind"
    ACTIVE_FRONT = "with the front"
    LATERAL = "with the side"
    CUT_IN = "from behind after the ego's lane entry"


KINDS = tuple(ContactKind)


@dataclass(frozen=True, slots=True)
class Contact:
    """The first touch of one agent: step of `trace.ego`, index of the track, kind and fault."""

    step: int
    agent: int
    kind: ContactKind
    at_fault: bool


@once
def contacts(trace: Trace, scenario: Scenario) -> tuple[Contact, ...]:
    """Return the collisions of a drive in order of time."""
    return classify(trace.ego, trace.agents, scenario)


def classify(drive: Trajectory, agents: Tracks, scenario: Scenario) -> tuple[Contact, ...]:
    """Return the collisions of a drive, or of a part of it, with the agents as they moved, in order
    of time.

    Touches at the first state are FROM_START; a part must begin at the drive's start, or where no
    agent is touched.
    """
    ego, car = ego_boxes(drive, scenario), car_of(scenario)
    first: dict[int, int] = {}
    for steps, there, others in pieces(agents, drive.t):
        touched = _first_contacts(ego[:, steps], car, others)
        for row in np.flatnonzero(touched >= 0).tolist():
            first.setdefault(int(there[row]), steps.start + int(touched[row]))
    found = []
    for step, agent in sorted((step, agent) for agent, step in first.items()):
        kind, state = ContactKind.FROM_START, drive.state(step)
        other = some_at(agents, np.array([agent]), drive.t[max(step - 1, 0) : step + 1])
        if step > 0 and other.there[0, 0]:
            before, now = other.pose[:, 0].T
            rear = np.array([state.x, state.y, state.yaw, state.v])
            kind = KINDS[
                contact_kind(
                    rear, car, before, now, other.size[0], agents.kinds[agent] is AgentKind.OBJECT
                )
            ]
        if kind is ContactKind.ACTIVE_REAR and forces_hit(
            drive.between(-inf, state.t), agents, agent, scenario
        ):
            kind = ContactKind.CUT_IN
        fault = kind in (ContactKind.STOPPED_TRACK, ContactKind.CUT_IN, ContactKind.ACTIVE_FRONT)
        if kind is ContactKind.LATERAL:
            x, y, yaw = ego[:3, step]
            fault = not keeps_lane(
                scenario.road, float(x), float(y), corners(x, y, yaw, car.length, car.width)
            )
        found.append(Contact(step, agent, kind, fault))
    return tuple(found)


@kernel
def contact_kind(
    rear: FloatArray,
    car: EgoOutline,
    before: FloatArray,
    pose: FloatArray,
    size: FloatArray,
    is_object: bool,
) -> int:
    """Return the index in `KINDS` of a contact with `pose` `(5,)` and `size` `(2,)`; no touch yet
    at `before` `(5,)`.

    `rear` are x, y, yaw and v of the ego's rear axle.
    """
    if abs(rear[3]) <= STANDING_MPS:
        return 1
    x, y, yaw = rear[0], rear[1], rear[2]
    behind = is_behind(x, y, yaw, pose[0], pose[1])
    if is_object or hypot(pose[3], pose[4]) <= STANDING_MPS:
        mid_x, mid_y = x + car.axle * cos(yaw), y + car.axle * sin(yaw)
        if not behind or overlap(
            mid_x,
            mid_y,
            yaw,
            car.length,
            car.width,
            before[0],
            before[1],
            before[2],
            size[0],
            size[1],
        ):
            return 2
    if behind:
        return 3
    nose_x, nose_y = x + car.front * cos(yaw), y + car.front * sin(yaw)
    return (
        4
        if overlap(nose_x, nose_y, yaw, 0.0, car.width, pose[0], pose[1], pose[2], size[0], size[1])
        else 5
    )


@kernel
def _first_contacts(ego: FloatArray, car: EgoOutline, others: OtherBoxes) -> IntArray:
    """Return for each agent the first step at which the boxes touch; -1 if they never do."""
    out = np.full(len(others.size), -1, np.int64)
    for i in range(len(out)):
        for k in range(others.there.shape[1]):
            x, y, yaw = ego[0, k], ego[1, k], ego[2, k]
            if not others.there[i, k] or distance_bound(x, y, car, others, i, k) > 0.0:
                continue
            if touches(x, y, yaw, car, others, i, k):
                out[i] = k
                break
    return out


@kernel
def _gaps(
    ego: FloatArray,
    car: EgoOutline,
    others: OtherBoxes,
    there: BoolArray,
    wanted: BoolArray,
    recent: int,
) -> tuple[FloatArray, IntArray]:
    """Return for each step the least distance to a wanted agent that is `there` (NaN: none) and its
    index (-1).

    `recent` is the previous nearest agent, which is tried first.
    """
    pose, size, steps = others.pose, others.size, there.shape[1]
    gap, nearest = np.full(steps, np.nan), np.full(steps, -1, np.int64)
    for k in range(steps):
        best = inf
        for turn in range(len(size)):
            i = (recent + turn) % len(size)
            x, y, yaw = ego[0, k], ego[1, k], ego[2, k]
            if not (wanted[i] and there[i, k]) or distance_bound(x, y, car, others, i, k) >= best:
                continue
            px, py, heading = pose[0, i, k], pose[1, i, k], pose[2, i, k]
            found = distance(
                x, y, yaw, car.length, car.width, px, py, heading, size[i, 0], size[i, 1]
            )
            if found < best or nearest[k] < 0:
                best, nearest[k], gap[k] = found, i, found
        recent = max(nearest[k], 0)
    return gap, nearest


@kernel
def _contact_times(
    ego: FloatArray,
    turn: FloatArray,
    car: EgoOutline,
    others: OtherBoxes,
    until: IntArray,
    horizon: float,
) -> tuple[FloatArray, IntArray]:
    """Return for each step the least TTC and straight time `(2, k)` within the horizon (NaN), and
    whose TTC (-1).

    `turn` are the ego's yaw rates `(k,)`, rad/s; agent i counts at the steps before `until[i]`.
    """
    pose, steps = others.pose, others.there.shape[1]
    least, nearest = np.full((2, steps), np.nan), np.full(steps, -1, np.int64)
    for k in range(steps):
        x, y, yaw, vx, vy = ego[0, k], ego[1, k], ego[2, k], ego[3, k], ego[4, k]
        rear_x, rear_y, best, straight = (
            x - car.axle * cos(yaw),
            y - car.axle * sin(yaw),
            horizon,
            horizon,
        )
        if hypot(vx, vy) <= NO_TTC_MPS:
            continue
        for i in range(len(until)):
            if (
                k >= until[i]
                or not others.there[i, k]
                or is_behind(rear_x, rear_y, yaw, pose[0, i, k], pose[1, i, k])
            ):
                continue
            closing = hypot(pose[3, i, k] - vx, pose[4, i, k] - vy)
            if distance_bound(x, y, car, others, i, k) > closing * best:
                continue
            found = contact_time((x, y, yaw, vx, vy), turn[k], car, others, i, k, 0.0)
            if found < straight:
                straight, least[1, k] = found, found
            if found < best:
                found = max(
                    found, contact_time((x, y, yaw, vx, vy), turn[k], car, others, i, k, TURN_S)
                )
            if found < best:
                best, least[0, k], nearest[k] = found, found, i
    return least, nearest


def _collision(trace: Trace, scenario: Scenario, *, fault_only: bool) -> Measured:
    met = (contact for contact in contacts(trace, scenario) if contact.at_fault or not fault_only)
    events = [
        (c.step, f"{label(c, trace)}, {impact_speed(c, trace, scenario):.1f} m/s") for c in met
    ]
    return metric.counted(trace.ego.t, events)


def label(contact: Contact, trace: Trace) -> str:
    """Return road user, kind and fault as text: "car 12: from behind, not at fault"."""
    fault = "at fault" if contact.at_fault else "not at fault"
    return f"{name_of(trace.agents, contact.agent)}: {contact.kind.value}, {fault}"


def _counted_agents(trace: Trace, vulnerable_only: bool) -> BoolArray:
    """Return which agents are considered `(n,)`: all, or pedestrians and riders."""
    return np.array(
        [kind.is_vulnerable or not vulnerable_only for kind in trace.agents.kinds], np.bool_
    )


def impact_speed(contact: Contact, trace: Trace, scenario: Scenario) -> float:
    """Return the length of the difference of the velocity vectors at the first touch, m/s."""
    other = some_at(
        trace.agents, np.array([contact.agent]), trace.ego.t[contact.step : contact.step + 1]
    )
    mine, theirs = ego_boxes(trace.ego, scenario)[3:, contact.step], other.pose[3:, 0, 0]
    return float(np.hypot(*(theirs - mine)))


def delta_v(speed: float, mass: float, other_mass: float) -> float:
    """Return the delta-v of the ego (3), m/s."""
    return speed if np.isinf(other_mass) else speed * other_mass / (other_mass + mass)


def _severity(trace: Trace, scenario: Scenario) -> Mapping[str, Measured]:
    found, labels = np.full((2, len(trace.ego)), np.nan), [""] * len(trace.ego)
    for contact in contacts(trace, scenario):
        k, mass = contact.step, MASS_KG[trace.agents.kinds[contact.agent]]
        speed = impact_speed(contact, trace, scenario)
        change = delta_v(speed, scenario.vehicle.mass, mass)
        if contact.kind is not ContactKind.FROM_START and not found[1, k] >= change:
            found[:, k] = speed, change
            labels[k] = label(contact, trace)
    return {
        part: Series(trace.ego.t, found[i], tuple(labels), "no collision")
        for i, part in enumerate(PARTS)
    }


@kernel
def _approachable(
    ego: FloatArray, car: EgoOutline, others: OtherBoxes, leaving: float
) -> BoolArray:
    """Return which agents a moving ego passes or approaches `(n, k)`: not behind, nor moving aside
    at `leaving` m/s.
    """
    there, pose = others.there, others.pose
    out = there.copy()
    for k in range(there.shape[1]):
        x, y, yaw = ego[0, k], ego[1, k], ego[2, k]
        stands = hypot(ego[3, k], ego[4, k]) <= STANDING_MPS
        for i in range(len(there)):
            behind = is_behind(
                x - car.axle * cos(yaw), y - car.axle * sin(yaw), yaw, pose[0, i, k], pose[1, i, k]
            )
            left = (pose[1, i, k] - y) * cos(yaw) - (pose[0, i, k] - x) * sin(yaw)
            away = (pose[4, i, k] * cos(yaw) - pose[3, i, k] * sin(yaw)) * (
                1.0 if left > 0.0 else -1.0
            )
            out[i, k] = there[i, k] and not stands and not behind and away < leaving
    return out


def _gap(
    trace: Trace,
    scenario: Scenario,
    *,
    vulnerable_only: bool,
    kept: bool = False,
    leaving: float = inf,
) -> Measured:
    ego, car, wanted = (
        ego_boxes(trace.ego, scenario),
        car_of(scenario),
        _counted_agents(trace, vulnerable_only),
    )
    who = "pedestrian or rider" if vulnerable_only else "other road user"
    if not wanted.any():
        return Unavailable(f"no {who} in the scene")
    gap, agents = np.full(len(trace.ego), np.nan), np.full(len(trace.ego), -1)
    recent = 0
    for steps, seen, others in pieces(trace.agents, trace.ego.t):
        there = _approachable(ego[:, steps], car, others, leaving) if kept else others.there
        after = int(np.searchsorted(seen, recent)) % max(len(seen), 1)
        gap[steps], row = _gaps(ego[:, steps], car, others, there, wanted[seen], after)
        agents[steps] = indices_of(seen, row)
        recent = max(int(agents[steps.stop - 1]), 0)
    where = "beside or ahead of an ego that drives" if kept else "in the scene"
    return Series(trace.ego.t, gap, labels_of(trace, agents), f"no {who} {where}")


def _passing_room(trace: Trace, scenario: Scenario) -> Measured:
    found = _gap(trace, scenario, vulnerable_only=True, kept=True, leaving=LEAVING_MPS)
    if isinstance(found, Unavailable):
        return found
    required = np.interp(np.abs(trace.ego.v), PASSING_MPS, PASSING_M)
    return Series(found.t, found.value - required, found.labels, found.missing)


@once
def least_contact_times(
    trace: Trace, scenario: Scenario, vulnerable_only: bool
) -> tuple[FloatArray, IntArray]:
    """Return at each step the least TTC and straight time `(2, k)`, s (NaN: none), and the agent of
    the first (-1).
    """
    drive, ego, car = trace.ego, ego_boxes(trace.ego, scenario), car_of(scenario)
    until = np.where(_counted_agents(trace, vulnerable_only), len(drive), 0)
    met = [contact for contact in contacts(trace, scenario) if until[contact.agent]]
    until[[contact.agent for contact in met]] = [contact.step for contact in met]

    def contact_times(k: slice, seen: IntArray, others: OtherBoxes) -> tuple[FloatArray, IntArray]:
        return _contact_times(ego[:, k], turn[k], car, others, until[seen] - k.start, TTC_HORIZON_S)

    turn = drive.v * drive.kappa
    least, agents = nearest(trace.agents, drive.t, contact_times)
    for contact in met:
        if contact.at_fault:
            least[0, contact.step], agents[contact.step] = 0.0, contact.agent
    return least, agents


def _ttc(trace: Trace, scenario: Scenario, *, vulnerable_only: bool) -> Measured:
    if not _counted_agents(trace, vulnerable_only).any():
        return Unavailable(
            f"no {'pedestrian or rider' if vulnerable_only else 'other road user'} in the scene"
        )
    (least, _), agents = least_contact_times(trace, scenario, vulnerable_only)
    never = f"never on a course to touch within {TTC_HORIZON_S:g} s"
    return Series(trace.ego.t, least, labels_of(trace, agents), never)


def _integral(series: Series) -> tuple[float, int]:
    """Return TIT (1), s2, and the first step that contributes."""
    flags = series.known & (series.value <= TAU_S)
    return float(
        np.sum((metric.durations(series.t) * (TAU_S - series.value))[flags])
    ), metric.first_of(flags)


def known_lanes(scenario: Scenario) -> LaneArrays | Unavailable:
    """Return the lanes that a car may drive on, if the log has lanes."""
    if scenario.road.source is RoadSource.DRIVEN_PATH:
        return Unavailable("the log has no lanes: the road's edge is not known")
    return drivable_lanes(scenario.road) or Unavailable(
        "the log has no lane on which a car may drive"
    )


def _off_road(trace: Trace, scenario: Scenario) -> Measured:
    if isinstance(lanes := known_lanes(scenario), Unavailable):
        return lanes
    return Series(
        trace.ego.t, box_off_lanes(lanes, ego_boxes(trace.ego, scenario), scenario.vehicle)
    )


def box_off_lanes(
    lanes: LaneArrays, box: FloatArray, vehicle: VehicleParameters, step: float = OUTLINE_M
) -> FloatArray:
    """Return the greatest distance `(k,)` of a box's outline (centre, yaw: `(3 or more, k)`) to the
    drivable lanes, m.

    `step` is the greatest distance between two points of the outline, m; inf: only the corners.
    """
    ends = (
        0.5
        * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1], [1, 1]])
        * [vehicle.length, vehicle.width]
    )
    sides = [
        np.linspace(a, b, max(ceil(np.hypot(*(b - a)) / step), 1), False) for a, b in pairwise(ends)
    ]
    x, y, yaw = box[:3]
    return _farthest_off(lanes, x, y, np.cos(yaw), np.sin(yaw), np.vstack(sides))


@kernel
def _farthest_off(
    lanes: LaneArrays,
    x: FloatArray,
    y: FloatArray,
    c: FloatArray,
    s: FloatArray,
    outline: FloatArray,
) -> FloatArray:
    """Return the greatest `off_lanes` of an outline's points (ahead, left) at poses with cosine c
    and sine s of yaw.
    """
    worst = np.zeros(len(x))
    for i in range(len(outline)):
        ahead, left = outline[i, 0], outline[i, 1]
        worst = np.maximum(
            worst, off_lanes(lanes, x + ahead * c - left * s, y + ahead * s + left * c)
        )
    return worst


_NUPLAN = "nuPlan devkit e9241677, no_ego_at_fault_collisions"
COLLISION = Metric(
    "collision",
    "count",
    "lower",
    (Mode.CLOSED,),
    partial(_collision, fault_only=False),
    (metric.COUNT,),
    "Road users that the ego's box touched, each once.",
    _NUPLAN,
    formula="sum over the others of 1 where the boxes touch at some step",
)
COLLISION_AT_FAULT = Metric(
    "collision_at_fault",
    "count",
    "lower",
    (Mode.CLOSED,),
    partial(_collision, fault_only=True),
    (metric.COUNT,),
    "Collisions into a standing road user, with the front, or with the side while not keeping a "
    "lane.",
    _NUPLAN,
    formula="as collision; kinds and fault in nuPlan's order",
    parameters=(f"standing {STANDING_MPS} m/s", "behind: more than 150 degrees off the heading"),
)
COLLISION_SEVERITY = Metric(
    "collision_severity",
    "m/s",
    "lower",
    (Mode.CLOSED,),
    _severity,
    (metric.MAX,),
    "Impact speed of a collision, and the change of the ego's velocity if both stick together.",
    "nuPlan devkit e9241677, no_ego_at_fault_collisions; masses: EN 1317-1, Regulation (EU) No "
    "1230/2012",
    parts=PARTS,
    formula="impact_speed = |v_e - v_o|; delta_v = m_o / (m_o + m_e) |v_e - v_o|",
    parameters=(
        "m_e: the vehicle's mass",
        "m_o: "
        + ", ".join(
            f"{kind.value} {mass:g} kg" for kind, mass in MASS_KG.items() if np.isfinite(mass)
        ),
        "object: immovable",
    ),
    needs="a collision",
)
_KEPT = (
    "as gap, while the ego moves (above 0.05 m/s) and of agents not more than 150 degrees off "
    "its heading"
)
_PERSON = "a pedestrian or rider"
GAP, GAP_VULNERABLE, GAP_KEPT, GAP_KEPT_VULNERABLE = (
    Metric(
        name,
        "m",
        "higher",
        (Mode.CLOSED,),
        partial(_gap, vulnerable_only=needs == _PERSON, kept=formula == _KEPT),
        (
            metric.MIN,
            metric.time_below(0.5, "time_below_50cm")
            if needs == _PERSON
            else metric.time_below(0.2, "time_below_20cm"),
        ),
        meaning,
        formula=formula,
        needs=needs,
    )
    for name, formula, needs, meaning in (
        (
            "gap",
            "min over the others of the distance of the boxes",
            "other road users",
            "Least distance between the ego's box and another's, 0 where they touch.",
        ),
        ("gap_vulnerable", "as gap", _PERSON, "Least distance to a pedestrian or rider."),
        (
            "gap_kept",
            _KEPT,
            "another road user",
            "Least distance that the ego leaves to another as it drives: not to those behind, and "
            "none while it stands.",
        ),
        (
            "gap_kept_vulnerable",
            _KEPT,
            _PERSON,
            "Least distance that the ego leaves to a pedestrian or rider as it drives.",
        ),
    )
)
PASSING_ROOM = Metric(
    "passing_room",
    "m",
    "higher",
    (Mode.CLOSED,),
    _passing_room,
    (metric.MIN, metric.time_below(0.0, "time_too_near")),
    "Least distance to a pedestrian or rider who is passed, less what the ego's speed asks for.",
    formula=(
        f"{_KEPT} nor going away to the side; less 0.5 m up to 3 m/s, 1 m from 5 m/s on, "
        "linear between"
    ),
    parameters=(f"going away: {LEAVING_MPS} m/s",),
    needs="a pedestrian or rider",
)
_TTC_TIMES = (
    metric.MIN,
    metric.time_below(CLOSE_S, "time_below_950ms"),
    metric.time_below(TAU_S, "time_below_1500ms"),
    Reduction("integrated_1500ms", _integral, "s2", "lower", 0.0),
)
_TTC_HOW = (
    f"horizon {TTC_HORIZON_S:g} s",
    "bounds 0.95 s and 1.5 s (tau of TET and TIT)",
    f"turns last {TURN_S} s",
    "not to who is more than 150 degrees off the heading, nor from their first contact on",
    "0 at a collision at fault",
)
_TTC_FORMULA = (
    "max over straight, turning of the least t >= 0 at which the boxes touch; TET = sum w [TTC < "
    "tau], "
    "TIT = sum w (tau - TTC) [TTC <= tau]"
)
_TTC_SOURCE = (
    "bound 0.95 s: nuPlan devkit e9241677, time_to_collision_within_bound; TET and TIT: "
    "Minderhoud, Bovy, "
    "Accid. Anal. Prev. 33 (2001) 89"
)
TTC, TTC_VULNERABLE = (
    Metric(
        name,
        "s",
        "higher",
        (Mode.CLOSED,),
        partial(_ttc, vulnerable_only=who == _PERSON),
        _TTC_TIMES,
        meaning,
        _TTC_SOURCE,
        version,
        formula=_TTC_FORMULA,
        parameters=_TTC_HOW,
        needs=f"{who} on a course to touch an ego that drives",
    )
    for name, who, version, meaning in (
        (
            "ttc",
            "another",
            3,
            "Least time until boxes touch at constant velocity vectors, or at constant speeds and "
            "yaw rates if that is"
            " later, within 10 s; not to those behind.",
        ),
        (
            "ttc_vulnerable",
            _PERSON,
            2,
            "Least time until the ego's box touches a pedestrian or rider, as ttc.",
        ),
    )
)
OFF_ROAD = Metric(
    "off_road",
    "m",
    "lower",
    (Mode.CLOSED,),
    _off_road,
    (metric.MAX, metric.time_above(OFF_ROAD_M, "time_beyond_30cm")),
    "Greatest distance of the ego's outline from the drivable lanes.",
    "bound 0.3 m: nuPlan devkit e9241677, drivable_area_compliance (its corners alone)",
    2,
    formula="max over points of the outline of the distance to the nearest drivable lane",
    parameters=(f"bound {OFF_ROAD_M} m", f"points at most {OUTLINE_M} m apart"),
    needs="lanes in the log",
)
