"""A sensor on the ego's roof: range, field of view, occlusion by others, noise, drop-outs, latency.

At each frame it measures the other road users. An agent is measured if enough of `POINTS` points of
its box (corners, middles of the sides, centre) are within range and field of view and not behind
another's box (`VISIBLE`); pedestrians and riders occlude no others. Then, per agent:

(1) x + n_1 e_along + n_2 e_left,  yaw + n_3,  v + n_4 e_along + n_5 e_left        n_i normal, in
                                   the agent's own axes
(2) not measured in slots of `dropout_s`, each with probability `dropout`; each agent's slots have a
    phase of their own

and it reaches the planner `latency_s` later, extrapolated with the measured velocity. An agent that
is no longer measured is extrapolated from its last measurement for `coast_s`, as by a tracker. The
first measurement is available at once, as if the sensor had run before the log began.

Every random draw is a pure function of scenario, seed, agent and time, independent of other agents
and their order.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from hashlib import blake2b
from math import atan2, cos, hypot, nan, pi, radians, sin
from typing import NamedTuple

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.core.kernel import inner_kernel, kernel
from replan.logs.agents import NUMBERS, OLDEST_S, Agents, codes_of
from replan.logs.frame import Visibility
from replan.logs.nearby_tracks import NearbyTracks
from replan.logs.scenario import Scenario
from replan.logs.shapes import corners
from replan.logs.states import wrap
from replan.replay.loop_config import SensorConfig
from replan.replay.world import World, box_center

POINTS = 9
VISIBLE = 0.25
"""Share of an agent's points that must be visible."""
WIDEST_RAD = radians(88.0)
"""Greatest half angle of a shadow: an agent so near hides half of the surroundings."""


X, Y, YAW, LENGTH, WIDTH = range(5)
"""Columns of boxes."""
NEAR_RIGHT, FAR_RIGHT, FAR_LEFT, NEAR_LEFT = range(4)
"""Corners of a shadow."""


class View(NamedTuple):
    """Where the sensor is and how much it covers: m, rad."""

    x: float
    y: float
    yaw: float
    range: float
    field_of_view: float


@dataclass(frozen=True, eq=False, slots=True)
class Measurement:
    """The measured agents and the visible ground at the time `t`, s."""

    t: float
    agents: Agents
    visibility: Visibility


class Sensor:
    """The sensor of one drive; it remembers measurements that are delayed or coasted.

    Args:
        scenario: Its name seeds the draws; the ego's size places the sensor.
        config: Abilities of the sensor.
    """

    def __init__(self, scenario: Scenario, config: SensorConfig) -> None:
        self._name, self._vehicle, self._config = scenario.name, scenario.vehicle, config
        self._measurements: deque[Measurement] = deque()
        self._since: dict[str, float] | None = None
        self._boxes_around = NearbyTracks()

    def see(self, world: World) -> tuple[Agents, Visibility]:
        """Return the agents as they reach the planner at the world's time, and the ground visible
        to the sensor.
        """
        now = world.ego.t
        self._measurements.append(self._measure(world))
        due = now - self._config.latency_s + 1e-9
        arrived = [measurement for measurement in self._measurements if measurement.t <= due] or [
            self._measurements[0]
        ]
        oldest = arrived[-1].t - self._config.coast_s - 1e-9
        while self._measurements[0].t < oldest:
            self._measurements.popleft()
        newest: dict[str, tuple[Measurement, int]] = {}
        for measurement in arrived:
            if measurement.t >= oldest:
                newest.update(
                    {name: (measurement, i) for i, name in enumerate(measurement.agents.ids)}
                )
        # ages count from the first measurement since an agent was last lost; unknown for those in
        # the first frame
        is_first, known = self._since is None, self._since or {}
        self._since = {
            name: known.get(name, nan if is_first else measurement.t)
            for name, (measurement, _) in newest.items()
        }
        age = np.minimum(now - np.array(list(self._since.values())), OLDEST_S)
        unseen = np.array([now - measurement.t for measurement, _ in newest.values()])
        rows = np.array(
            [
                [getattr(measurement.agents, name)[i] for name in NUMBERS]
                for measurement, i in newest.values()
            ],
            float,
        )
        kinds = tuple(measurement.agents.kinds[i] for measurement, i in newest.values())
        seen = Agents.of_rows(
            tuple(newest), kinds, rows.reshape(-1, len(NUMBERS)).T, codes_of(kinds)
        )
        # Extrapolated with its velocity
        x, y = seen.x + unseen * seen.vx, seen.y + unseen * seen.vy
        return replace(seen, x=x, y=y, age=age, unseen=unseen), arrived[-1].visibility

    def _measure(self, world: World) -> Measurement:
        ego, config = world.ego, self._config
        agents = self._boxes_around.of(world.tracks, ego.t, ego.t).perceived(ego.t)
        x, y = box_center(ego, self._vehicle)
        field_of_view = radians(config.field_of_view_deg)
        view = View(float(x), float(y), float(ego.yaw), float(config.range_m), field_of_view)
        boxes = np.column_stack([agents.x, agents.y, agents.yaw, agents.length, agents.width])
        hiding = np.array(
            [config.occlusion and not kind.is_vulnerable for kind in agents.kinds], bool
        )
        hiding &= ~_boxes_around(boxes, x, y)
        seen = _seen_shares(boxes, hiding, view) >= VISIBLE
        if config.dropout > 0.0:  # (2)
            for i, name in enumerate(agents.ids):
                phase = self._draws(name, "phase").uniform(0.0, config.dropout_s)
                slot = int((ego.t + phase) // config.dropout_s)
                seen[i] &= self._draws(name, f"slot {slot}").uniform() >= config.dropout
        visibility = Visibility(
            x, y, ego.yaw, config.range_m, field_of_view, _shadows(boxes[hiding], view)
        )
        return Measurement(ego.t, self._noisy(agents.some(np.flatnonzero(seen)), ego.t), visibility)

    def _noisy(self, agents: Agents, t: float) -> Agents:
        """The agents as measured at `t`, with noise (1)."""
        config, stamp = self._config, f"noise {round(t * 1e9)}"
        draws = np.array(
            [self._draws(name, stamp).standard_normal(5) for name in agents.ids]
        ).reshape(-1, 5)
        spread = np.array([config.position_noise_m] * 2 + [radians(config.yaw_noise_deg)])
        ahead, left, turn = (draws[:, :3] * spread).T
        faster, aside = (draws[:, 3:] * config.velocity_noise_mps).T
        c, s = np.cos(agents.yaw), np.sin(agents.yaw)
        return replace(
            agents,
            x=agents.x + ahead * c - left * s,
            y=agents.y + ahead * s + left * c,
            yaw=agents.yaw + turn,
            vx=agents.vx + faster * c - aside * s,
            vy=agents.vy + faster * s + aside * c,
            velocity_sigma=np.full(len(agents), config.velocity_noise_mps),
        )

    def _draws(self, agent: str, what: str) -> np.random.Generator:
        """The generator of one agent's draws for one purpose."""
        key = "\x1f".join((self._name, str(self._config.seed), agent, what)).encode()
        return np.random.Generator(
            np.random.PCG64(int.from_bytes(blake2b(key, digest_size=16).digest(), "little"))
        )


@inner_kernel
def _crosses(ax: float, ay: float, bx: float, by: float, box: FloatArray) -> bool:
    """Return whether the segment from a to b touches a box (x, y, yaw, length, width): slabs in the
    box's axes.
    """
    x, y = box[X], box[Y]
    c, s = cos(box[YAW]), sin(box[YAW])
    px, py = (ax - x) * c + (ay - y) * s, (ay - y) * c - (ax - x) * s
    dx, dy = (bx - ax) * c + (by - ay) * s, (by - ay) * c - (bx - ax) * s
    first, last = 0.0, 1.0
    for p, d, half in ((px, dx, 0.5 * box[LENGTH]), (py, dy, 0.5 * box[WIDTH])):
        if abs(d) < 1e-12:
            if abs(p) > half:
                return False
            continue
        low, high = (-half - p) / d, (half - p) / d
        first, last = max(first, min(low, high)), min(last, max(low, high))
    return first <= last


@kernel
def _boxes_around(boxes: FloatArray, x: float, y: float) -> BoolArray:
    """Return which boxes contain the sensor: such an agent is a collision and does not occlude."""
    contains = np.zeros(len(boxes), np.bool_)
    for i in range(len(boxes)):
        contains[i] = _crosses(x, y, x, y, boxes[i])
    return contains


@inner_kernel
def _points_of(box: FloatArray) -> FloatArray:
    """Corners, middles of the sides and centre of a box, `(POINTS, 2)`."""
    points = np.empty((POINTS, 2))
    points[:4] = corners(box[X], box[Y], box[YAW], box[LENGTH], box[WIDTH])
    for k in range(4):
        points[4 + k] = 0.5 * (points[k] + points[(k + 1) % 4])
    points[POINTS - 1] = box[:YAW]
    return points


@kernel
def _seen_shares(boxes: FloatArray, hiding: BoolArray, view: View) -> FloatArray:
    """Return the share of each box's points that a sensor sees `(n,)`."""
    n = len(boxes)
    shares, away = np.zeros(n), np.empty(n)
    for i in range(n):
        away[i] = hypot(boxes[i, X] - view.x, boxes[i, Y] - view.y)
    for i in range(n):
        points = _points_of(boxes[i])
        for p in range(POINTS):
            px, py = points[p]
            dx, dy = px - view.x, py - view.y
            aside = abs(wrap(atan2(dy, dx) - view.yaw))
            if hypot(dx, dy) > view.range or aside > 0.5 * view.field_of_view:
                continue
            free = True
            for j in range(n):
                is_nearer = away[j] < away[i] + boxes[i, LENGTH]
                between = j != i and hiding[j] and is_nearer
                if between and _crosses(view.x, view.y, px, py, boxes[j]):
                    free = False
                    break
            shares[i] += 1.0 / POINTS if free else 0.0
    return shares


@kernel
def _shadows(boxes: FloatArray, view: View) -> FloatArray:
    """Return the ground hidden behind boxes within range `(k, 4, 2)`: near right, far right, far
    left, near left.
    """
    shadows, count = np.empty((len(boxes), 4, 2)), 0
    for box in boxes:
        dx, dy = box[X] - view.x, box[Y] - view.y
        if hypot(dx, dy) - 0.5 * hypot(box[LENGTH], box[WIDTH]) > view.range:
            continue
        shadow, middle = shadows[count], atan2(dy, dx)
        outline = corners(box[X], box[Y], box[YAW], box[LENGTH], box[WIDTH])
        right, left = pi, -pi
        for k in range(4):
            angle = wrap(atan2(outline[k, 1] - view.y, outline[k, 0] - view.x) - middle)
            if angle < right:
                right, shadow[NEAR_RIGHT] = angle, outline[k]
            if angle > left:
                left, shadow[NEAR_LEFT] = angle, outline[k]
        half = min(0.5 * (left - right), WIDEST_RAD)
        far = 1.01 * view.range / cos(half)
        for k, angle in ((FAR_RIGHT, -half), (FAR_LEFT, half)):
            shadow[k, 0] = view.x + far * cos(middle + 0.5 * (left + right) + angle)
            shadow[k, 1] = view.y + far * sin(middle + 0.5 * (left + right) + angle)
        count += 1
    return shadows[:count]
