"""Events with another road user, as it moves in the frame of the ego's path (`DrivenLog`).

A road user that follows, overtakes or cuts in moves along the path: its heading is within 45
degrees of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import partial

import numpy as np

from replan.core.arrays import BoolArray
from replan.logs.agents import AgentKind
from replan.logs.polylines import points_inside
from replan.metrics.metric import Unavailable
from replan.mine.driven_log import (
    FELT_S,
    JUMPS,
    MOTOR_MPS2,
    TYRES_MPS2,
    DrivenLog,
    Event,
    EventKind,
    Neighbour,
    runs,
    steps,
)

ALONG = float(np.cos(np.pi / 4.0))
MOVES_MPS, WALKS_MPS = 1.0, 0.3
HOLE_S = 0.5
"""Longest interruption of one event."""
AROUND_S = 1.0
"""Time for which a cut-in is out of the band before and in it afterwards.

For cut-outs the other way round.
"""
HEADWAY_S, HEADWAY_M = 3.0, 10.0
"""Largest distance ahead of a moving ego of a cut-in or cut-out: as a time, or in m at low
speed.
"""
BRAKES_MPS2, BRAKES_S = 3.0, 0.3
SLOWS_MPS2, SLOWS_S = 0.5, 1.0
SLOWED_MPS, SLOWED = 1.0, 0.3
"""Least decrease of the ego's speed behind a lead: absolute, m/s, and as a share of its speed
before.
"""
LEAD_S, LEAD_M = 4.0, 15.0
QUEUE, QUEUE_MPS, QUEUE_S = 3, 0.5, 2.0
QUEUE_GAP_M, QUEUE_AHEAD_M = 15.0, 60.0
ONCOMING_AHEAD_M, ONCOMING_S, HEAD_ON = 60.0, 1.0, float(np.cos(np.pi / 9.0))
CYCLIST_BESIDE_M, CYCLIST_AHEAD_M, CYCLIST_S = 2.0, 30.0, 1.0
PASS_MPS, PASS_M, PASS_VULNERABLE_M = 3.0, 0.5, 1.5
CROSSING_S, CROSSING_AHEAD_M, WAITS_MPS = 8.0, 15.0, 2.0
"""A crossing concerns the ego if it gets there within CROSSING_S, or waits within CROSSING_AHEAD_M
before it.
"""
BESIDE_CROSSWALK_M = 2.0

_VEHICLES = (AgentKind.CAR, AgentKind.TRUCK, AgentKind.BUS, AgentKind.MOTORCYCLE)


def _changes(flags: BoolArray, user: Neighbour, before: int, after: int) -> Iterator[int]:
    """Places at which a mark begins, after `before` unmarked steps and with `after` marked ones,
    all consecutive.

    For a road user that is lost before `after` steps, half of them are enough.
    """
    ends = dict(runs(flags, user.k))
    for first, last in runs(~flags, user.k, before):
        start = last + 1
        if start not in ends or user.k[start] != user.k[last] + 1 or last - first + 1 < before:
            continue
        stay, lost = ends[start] - start + 1, ends[start] == len(user.k) - 1
        if stay >= after or (lost and 2 * stay >= after):
            yield start


def _near_ahead(log: DrivenLog, user: Neighbour, j: int) -> bool:
    """Whether a road user is near enough ahead of the moving ego that its change of lane concerns
    the ego.
    """
    gap, v = float(log.gap_to(user)[j]), float(log.ego.v[user.k[j]])
    return (
        0.0 < gap <= max(HEADWAY_S * v, HEADWAY_M)
        and v > MOVES_MPS
        and float(user.speed[j]) > MOVES_MPS
    )


def _moved_aside(user: Neighbour, j: int) -> bool:
    """Whether it was its own motion that changed its place in the band: more than half a metre
    across its heading.

    A change because the path bends away from a road user that goes straight on is ignored.
    """
    low, high = max(j - steps(2.0), 0), min(j + steps(1.0), len(user.k) - 1)
    yaw = np.unwrap(user.pose[2, low : high + 1])
    dx, dy = user.pose[0, high] - user.pose[0, low], user.pose[1, high] - user.pose[1, low]
    aside = abs(dy * np.cos(yaw[0]) - dx * np.sin(yaw[0]))
    return bool(
        abs(user.l[high] - user.l[low]) > 0.5 and (aside > 0.5 or abs(yaw[-1] - yaw[0]) > 0.1)
    )


def _cut_in(log: DrivenLog) -> Iterator[Event]:
    for user in log.neighbours:
        if user.kind not in (*_VEHICLES, AgentKind.BICYCLE):
            continue
        back = steps(AROUND_S)
        for j in _changes(user.reaches_into(log.half), user, back, back):
            turned = (user.along[j - back : j + 1] < ALONG).any()
            if not turned and _near_ahead(log, user, j) and _moved_aside(user, j):
                last = min(j + back, len(user.k) - 1)
                yield log.event(user, j, last, log.gap_to(user)[j])


def _cut_out(log: DrivenLog) -> Iterator[Event]:
    for user in log.neighbours:
        if user.kind not in _VEHICLES:
            continue
        back = steps(AROUND_S)
        for j in _changes(~user.reaches_into(log.half), user, back, back):
            was_lead = log.lead[0][user.k[j - 1]]
            is_lead = was_lead >= 0 and log.neighbours[was_lead] is user
            leaves = user.along[j] > 0.5 and _near_ahead(log, user, j) and _moved_aside(user, j)
            if is_lead and leaves:
                yield log.event(user, j - back, j, log.gap_to(user)[j])


def _lead_braking(log: DrivenLog) -> Iterator[Event]:
    leads, gap = log.lead
    for index in np.unique(leads[leads >= 0]).tolist():
        user = log.neighbours[index]
        near = gap[user.k] <= np.maximum(LEAD_S * log.ego.v[user.k], LEAD_M)
        possible = user.accel >= -TYRES_MPS2
        braking = (leads[user.k] == index) & near & (user.accel <= -BRAKES_MPS2)
        for first, last in runs(braking & possible, user.k, steps(BRAKES_S), steps(HOLE_S)):
            around = slice(max(first - steps(FELT_S), 0), last + steps(FELT_S) + 1)
            sound = (possible & (user.accel <= MOTOR_MPS2))[around].all()
            least = user.accel[first : last + 1][possible[first : last + 1]].min()
            yield log.event(user, first, last, least, doubt="" if sound else JUMPS)


def _ego_slows(log: DrivenLog) -> Iterator[Event]:
    leads, gap = log.lead
    near = (leads >= 0) & (gap <= np.maximum(LEAD_S * log.ego.v, LEAD_M))
    for first, last in runs(log.accel <= -SLOWS_MPS2, least=steps(SLOWS_S), hole=steps(HOLE_S)):
        begin = max(first - steps(FELT_S), 0)  # where the mean over `FELT_S` begins
        before, slower = float(log.ego.v[begin]), float(log.ego.v[begin] - log.ego.v[last])
        near_leads = leads[begin : last + 1][near[begin : last + 1]]
        if slower < max(SLOWED_MPS, SLOWED * before) or 2 * len(near_leads) < last - begin + 1:
            continue
        names, times = np.unique(near_leads, return_counts=True)
        yield log.event_at(log.neighbours[int(names[np.argmax(times)])], begin, last, slower)


def _standing_queue(log: DrivenLog) -> Iterator[Event]:
    standing: dict[int, list[tuple[float, float, str]]] = {}
    for user in log.neighbours:
        if user.kind not in _VEHICLES:
            continue
        gap = log.gap_to(user)
        stands = (gap > 0.0) & (gap < QUEUE_AHEAD_M) & (user.speed < QUEUE_MPS)
        stands &= user.reaches_into(log.half) & (user.along > ALONG)
        for j in np.flatnonzero(stands).tolist():
            rear = float(user.s[j] - user.half_s[j])
            standing.setdefault(int(user.k[j]), []).append(
                (rear, rear + 2.0 * float(user.half_s[j]), user.id)
            )
    members: list[tuple[str, ...]] = [()] * len(log.t)
    for k, row in standing.items():
        row.sort()
        close = [row[i + 1][0] - row[i][1] < QUEUE_GAP_M for i in range(len(row) - 1)]
        length = close.index(False) + 1 if False in close else len(row)
        if length >= QUEUE:
            members[k] = tuple(name for _, _, name in row[:length])
    for first, last in runs(np.array([bool(row) for row in members]), least=steps(QUEUE_S)):
        longest = max(members[first : last + 1], key=len)
        yield Event(float(log.t[first]), float(log.t[last]), float(len(longest)), longest)


def _oncoming(log: DrivenLog) -> Iterator[Event]:
    for user in log.neighbours:
        if user.kind in (AgentKind.PEDESTRIAN, AgentKind.OBJECT):
            continue
        gap = log.gap_to(user)
        coming = (
            (user.along < -HEAD_ON)
            & (user.speed > MOVES_MPS)
            & (gap > 0.0)
            & (gap < ONCOMING_AHEAD_M)
        )
        for first, last in runs(
            coming & user.reaches_into(log.half), user.k, steps(ONCOMING_S), steps(HOLE_S)
        ):
            yield log.event(user, first, last, gap[first : last + 1].min())


def _cyclist_along(log: DrivenLog) -> Iterator[Event]:
    for user in log.neighbours:
        if user.kind is not AgentKind.BICYCLE:
            continue
        gap = log.gap_to(user)
        beside = np.abs(user.l) - user.half_l - log.half < CYCLIST_BESIDE_M
        near = (gap > -log.car.length) & (gap < CYCLIST_AHEAD_M) & beside
        for first, last in runs(
            near & (user.along > ALONG) & (user.speed > MOVES_MPS),
            user.k,
            steps(CYCLIST_S),
            steps(HOLE_S),
        ):
            yield log.event(
                user, first, last, (np.abs(user.l) - user.half_l - log.half)[first : last + 1].min()
            )


def _close_pass(log: DrivenLog) -> Iterator[Event]:
    for user in log.neighbours:
        gaps = np.abs(user.l) - user.half_l - log.half
        bound = PASS_VULNERABLE_M if user.kind.is_vulnerable else PASS_M
        rear, front = user.s - user.half_s, user.s + user.half_s
        beside = (front > log.back[user.k]) & (rear < log.front[user.k])
        along = np.abs(user.along) > ALONG
        if user.kind in (AgentKind.PEDESTRIAN, AgentKind.OBJECT):
            # The heading of a pedestrian or object is not meaningful
            along = np.ones(len(user.k), np.bool_)
            along &= user.speed < MOVES_MPS if user.kind is AgentKind.OBJECT else user.speed < 3.0
        passed = beside & along & (gaps < bound) & (gaps >= 0.0) & (log.ego.v[user.k] > PASS_MPS)
        for first, last in runs(passed, user.k, hole=steps(HOLE_S)):
            yield log.event(user, first, last, gaps[first : last + 1].min())


def _crossing(
    log: DrivenLog, kind: AgentKind = AgentKind.PEDESTRIAN, *, off_crosswalks: bool = False
) -> Iterable[Event] | Unavailable:
    if off_crosswalks and not log.scenario.road.crosswalks:
        return Unavailable("the log's map has no crosswalk")
    if log.scenario.tracks.kinds and set(log.scenario.tracks.kinds) == {AgentKind.OBJECT}:
        return Unavailable("the log does not say what its road users are")
    events = []
    for user in log.neighbours:
        if user.kind is not kind:
            continue
        # The road user is in the band ahead of the ego
        for first, last in runs(user.reaches_into(log.half), user.k):
            low, high = max(first - steps(1.0), 0), min(last + steps(1.0), len(user.k) - 1)
            aside = abs(float(user.l[high] - user.l[low]))
            walked = aside > max(log.half, WALKS_MPS * 0.1 * (high - low))
            # Who rides along the path, and swerves, does not cross it
            if kind is not AgentKind.PEDESTRIAN:
                walked &= float(np.median(np.abs(user.along[low : high + 1]))) < ALONG
            comes = (
                log.reached(user.s[first : last + 1] - user.half_s[first : last + 1])
                - log.t[user.k[first : last + 1]]
            )
            gap = log.gap_to(user)[first : last + 1]
            waits = log.ego.v[user.k[first : last + 1]] < WAITS_MPS
            concerns = (np.abs(comes) <= CROSSING_S) | (
                (gap > 0.0) & (gap < CROSSING_AHEAD_M) & waits
            )
            if not (walked and (gap > 0.0).any() and concerns.any()):
                continue
            # A crosswalk, or within `BESIDE_CROSSWALK_M` of one
            on_crosswalk = np.zeros(last - first + 1, np.bool_)
            x, y = user.pose[0, first : last + 1], user.pose[1, first : last + 1]
            for crosswalk in log.scenario.road.crosswalks if off_crosswalks else ():
                center = crosswalk.polygon.mean(axis=0)
                away = np.hypot(*(crosswalk.polygon - center).T)[:, None]
                wider = center + (crosswalk.polygon - center) * (
                    1.0 + BESIDE_CROSSWALK_M / np.maximum(away, 1.0)
                )
                on_crosswalk |= points_inside(wider, x, y)
            if 2 * on_crosswalk.sum() < len(on_crosswalk):
                events.append(log.event(user, first, last, max(float(gap.min()), 0.0)))
    return events


_NEAR = f"within {HEADWAY_S:g} s or {HEADWAY_M:g} m"
ROAD_USERS = (
    EventKind(
        name="cut_in",
        find=_cut_in,
        meaning=(
            "A vehicle or cyclist that moves along the ego's path comes sideways into the ego's "
            f"band ahead of it, {_NEAR}, after {AROUND_S:g} s outside, and stays for {AROUND_S:g} "
            f"s. From then, for {AROUND_S:g} s."
        ),
        measures="gap when it comes in",
        unit="m",
        source="UN R157 (cutting-in vehicle); Waymo's scenario tags (cut-ins)",
    ),
    EventKind(
        name="cut_out",
        find=_cut_out,
        meaning=(
            f"The lead, {_NEAR} ahead, leaves the band sideways after {AROUND_S:g} s in it, and "
            f"stays out for {AROUND_S:g} s. From {AROUND_S:g} s before it is out."
        ),
        measures="gap when it is out",
        unit="m",
        source="UN R157 (cut-out)",
    ),
    EventKind(
        name="lead_braking",
        find=_lead_braking,
        meaning=(
            f"The lead, within {LEAD_S:g} s or {LEAD_M:g} m, brakes with {BRAKES_MPS2:g} m/s2 or "
            f"more for {BRAKES_S} s."
        ),
        measures="its least acceleration",
        unit="m/s2",
        source="UN R157 (braking lead); the bound is ours",
        doubted=JUMPS,
    ),
    EventKind(
        name="ego_slows",
        find=_ego_slows,
        meaning=(
            f"The ego slows down by {SLOWED_MPS:g} m/s and {SLOWED:.0%} or more, with "
            f"{SLOWS_MPS2:g} m/s2 for {SLOWS_S:g} s, behind a lead within {LEAD_S:g} s or "
            f"{LEAD_M:g} m for most of it."
        ),
        measures="decrease of its speed",
        unit="m/s",
    ),
    EventKind(
        name="standing_queue",
        find=_standing_queue,
        meaning=(
            f"{QUEUE} vehicles or more stand (below {QUEUE_MPS} m/s) one behind the other in the "
            f"band, less than {QUEUE_GAP_M:g} m apart, the first within {QUEUE_AHEAD_M:g} m ahead, "
            f"for {QUEUE_S:g} s."
        ),
        measures="how many",
        unit="1",
    ),
    EventKind(
        name="oncoming",
        find=_oncoming,
        meaning=(
            "A vehicle or cyclist comes towards the ego in its band, heading within 20 degrees of "
            f"the opposite direction, less than {ONCOMING_AHEAD_M:g} m ahead, for {ONCOMING_S:g} s."
        ),
        measures="least gap",
        unit="m",
    ),
    EventKind(
        name="cyclist_along",
        find=_cyclist_along,
        meaning=(
            f"A cyclist rides in the ego's direction, beside it or up to {CYCLIST_AHEAD_M:g} m "
            f"ahead, less than {CYCLIST_BESIDE_M:g} m beside the band, for {CYCLIST_S:g} s."
        ),
        measures="least room to the side",
        unit="m",
        source="nuPlan's scenario tags (behind_bike); Waymo's (cyclists)",
    ),
    EventKind(
        name="close_pass",
        find=_close_pass,
        meaning=(
            f"The ego passes, faster than {PASS_MPS:g} m/s, with less than {PASS_M} m of room to "
            f"the side, or less than {PASS_VULNERABLE_M} m to a pedestrian or rider."
        ),
        measures="least room",
        unit="m",
        source="StVO 5 (4): 1.5 m in towns beside pedestrians and cyclists; 0.5 m is ours",
    ),
    EventKind(
        name="pedestrian_crossing",
        find=_crossing,
        meaning=(
            "A pedestrian walks into the band ahead of the ego, which comes there within "
            f"{CROSSING_S:g} s, or waits (below {WAITS_MPS:g} m/s) less than {CROSSING_AHEAD_M:g} "
            "m before it. While they are in the band."
        ),
        measures="least gap",
        unit="m",
        source=(
            "nuPlan's scenario tags (near_pedestrian_on_crosswalk, waiting_for_pedestrian_to_cross)"
        ),
    ),
    EventKind(
        name="cyclist_crossing",
        find=partial(_crossing, kind=AgentKind.BICYCLE),
        meaning="The same of a cyclist, who moves across the ego's path, by 45 degrees or more.",
        measures="least gap",
        unit="m",
    ),
    EventKind(
        name="jaywalking",
        find=partial(_crossing, off_crosswalks=True),
        meaning=(
            f"A pedestrian crossing with the pedestrian more than {BESIDE_CROSSWALK_M:g} m from "
            "any crosswalk for most of it; asked where the map has crosswalks."
        ),
        measures="least gap",
        unit="m",
        source="RefAV (Argoverse 2 scenario mining: jaywalking)",
    ),
)
