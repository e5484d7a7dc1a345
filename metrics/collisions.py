"""Contacts of the ego with road users and objects: which kind, and whose fault. Closed loop.

Compares the ego's box along its drive with the others' boxes as they moved. `proposals` judges
plans by the same rules, in both loops.

Collision: two boxes touch or overlap; each agent counts once. The kind is the first that applies,
in nuPlan's order (FROM_START and CUT_IN are additions of replan):

    FROM_START      they touch when the drive begins or the other first appears: not at fault
    STOPPED_EGO     the ego stands (<= 0.05 m/s): not at fault
    STOPPED_TRACK   the other stands or is an object, and did not come from behind: at fault
    CUT_IN          as ACTIVE_REAR, within reach of the lane entry of the ego before it
                    (`cut_in`): at fault
    ACTIVE_REAR     the other's centre is behind, more than 150 degrees off the heading, seen from
                    the rear axle: not at fault
    ACTIVE_FRONT    the ego's front bumper touches: at fault
    LATERAL         any other: at fault unless the ego keeps its lane (`lanes.keeps_lane`)

The other came from behind if its centre is behind, as in ACTIVE_REAR, and the boxes would not touch
if it had stayed where it was one step before. Objects without a kind may be following vehicles, and
an ego that moves away from a slow road user does not drive into it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from math import cos, hypot, inf, sin

import numpy as np

from replan.core.arrays import FloatArray, IntArray
from replan.core.kernel import kernel
from replan.core.once import once
from replan.logs.agents import AgentKind
from replan.logs.scenario import Scenario
from replan.logs.shapes import corners, overlap
from replan.logs.states import Trajectory
from replan.logs.trace import Trace
from replan.logs.tracks import Tracks
from replan.metrics.boxes import (
    STANDING_MPS,
    EgoOutline,
    OtherBoxes,
    car_of,
    distance_bound,
    ego_boxes,
    is_behind,
    name_of,
    pieces,
    some_at,
    touches,
)
from replan.metrics.cut_in import BRAKE_MPS2, REACT_S, forces_hit
from replan.metrics.lanes import keeps_lane
from replan.metrics.metric import Measured, Series, counted, metric
from replan.metrics.reductions import COUNT


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
    for steps, present, others in pieces(agents, drive.t):
        touched = _first_contacts(ego[:, steps], car, others)
        for row in np.flatnonzero(touched >= 0).tolist():
            first.setdefault(int(present[row]), steps.start + int(touched[row]))
    collisions = []
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
        collisions.append(Contact(step, agent, kind, fault))
    return tuple(collisions)


STOPPED_EGO = KINDS.index(ContactKind.STOPPED_EGO)
STOPPED_TRACK = KINDS.index(ContactKind.STOPPED_TRACK)
ACTIVE_REAR = KINDS.index(ContactKind.ACTIVE_REAR)
ACTIVE_FRONT = KINDS.index(ContactKind.ACTIVE_FRONT)
LATERAL = KINDS.index(ContactKind.LATERAL)


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
    x, y, yaw = rear[0], rear[1], rear[2]
    v, u = abs(rear[-1]), hypot(pose[-2], pose[-1])
    length, width = size[0], size[1]
    if v <= STANDING_MPS:
        return STOPPED_EGO
    behind = is_behind(x, y, yaw, pose[0], pose[1])
    if is_object or u <= STANDING_MPS:
        mid_x, mid_y = x + car.axle * cos(yaw), y + car.axle * sin(yaw)
        from_behind = behind and not overlap(
            mid_x,
            mid_y,
            yaw,
            car.length,
            car.width,
            before[0],
            before[1],
            before[2],
            length,
            width,
        )
        if not from_behind:
            return STOPPED_TRACK
    if behind:
        return ACTIVE_REAR
    nose_x, nose_y = x + car.front * cos(yaw), y + car.front * sin(yaw)
    with_front = overlap(
        nose_x, nose_y, yaw, 0.0, car.width, pose[0], pose[1], pose[2], length, width
    )
    return ACTIVE_FRONT if with_front else LATERAL


@kernel
def _first_contacts(ego: FloatArray, car: EgoOutline, others: OtherBoxes) -> IntArray:
    """Return for each agent the first step at which the boxes touch; -1 if they never do."""
    steps = np.full(len(others.size), -1, np.int64)
    for i in range(len(steps)):
        for k in range(others.there.shape[1]):
            x, y, yaw = ego[0, k], ego[1, k], ego[2, k]
            if not others.there[i, k] or distance_bound(x, y, car, others, i, k) > 0.0:
                continue
            if touches(x, y, yaw, car, others, i, k):
                steps[i] = k
                break
    return steps


def label(contact: Contact, trace: Trace) -> str:
    """Return road user, kind and fault as text: "car 12: from behind, not at fault"."""
    fault = "at fault" if contact.at_fault else "not at fault"
    return f"{name_of(trace.agents, contact.agent)}: {contact.kind.value}, {fault}"


def impact_speed(contact: Contact, trace: Trace, scenario: Scenario) -> float:
    """Return the length of the difference of the velocity vectors at the first touch, m/s."""
    other = some_at(
        trace.agents, np.array([contact.agent]), trace.ego.t[contact.step : contact.step + 1]
    )
    _, _, _, vx, vy = ego_boxes(trace.ego, scenario)[:, contact.step]
    _, _, _, other_vx, other_vy = other.pose[:, 0, 0]
    return float(np.hypot(other_vx - vx, other_vy - vy))


def _counted(collisions: Iterable[Contact], trace: Trace, scenario: Scenario) -> Series:
    """Count contacts at their steps, with the impact speed in the label."""
    return counted(
        trace.ego.t,
        (
            (
                contact.step,
                f"{label(contact, trace)}, {impact_speed(contact, trace, scenario):.1f} m/s",
            )
            for contact in collisions
        ),
    )


_NUPLAN = "nuPlan devkit e9241677, no_ego_at_fault_collisions"


@metric(unit="count", better="lower", reductions=(COUNT,), source=_NUPLAN)
def collision(trace: Trace, scenario: Scenario) -> Measured:
    """Road users that the ego's box touched, each once.

    Formula: sum over the others of 1 where the boxes touch at some step
    """
    return _counted(contacts(trace, scenario), trace, scenario)


@metric(
    unit="count",
    better="lower",
    reductions=(COUNT,),
    source=_NUPLAN,
    parameters=(
        f"standing {STANDING_MPS} m/s",
        "behind: more than 150 degrees off the heading",
        f"cannot brake: by {BRAKE_MPS2:g} m/s2 after {REACT_S:g} s",
    ),
)
def collision_at_fault(trace: Trace, scenario: Scenario) -> Measured:
    """Collisions into a standing road user, with the front, with the side while not keeping a lane,
    or by a follower that cannot brake for the ego's change into its lane.

    Formula: as collision; kinds and fault in nuPlan's order
    """
    at_fault = (contact for contact in contacts(trace, scenario) if contact.at_fault)
    return _counted(at_fault, trace, scenario)
