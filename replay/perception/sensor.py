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
        self._made: deque[Measurement] = deque()
        self._since: dict[str, float] | None = None
        self._boxes_around = NearbyTracks()

    def see(self, world: World) -> tuple[Agents, Visibility]:
        """Return the agents as they reach the planner at the world's time, and the ground visible
        to the sensor.
        """
        now = world.ego.t
        self._made.append(self._measure(world))
        due = now - self._config.latency_s + 1e-9
        arrived = [made for made in self._made if made.t <= due] or [self._made[0]]
        oldest = arrived[-1].t - self._config.coast_s - 1e-9
        while self._made[0].t < oldest:
            self._made.popleft()
        newest: dict[str, tuple[Measurement, int]] = {}
        for made in arrived:
            if made.t >= oldest:
                newest.update({name: (made, i) for i, name in enumerate(made.agents.ids)})
        # ages count from the first measurement since an agent was last lost; unknown for those in
        # the first frame
        first, known = self._since is None, self._since or {}
        self._since = {
            name: known.get(name, nan if first else m.t) for name, (m, _) in newest.items()
        }
        age = np.minimum(now - np.array(list(self._since.values())), OLDEST_S)
        unseen = np.array([now - m.t for m, _ in newest.values()])
        rows = np.array(
            [[getattr(m.agents, name)[i] for name in NUMBERS] for m, i in newest.values()], float
        )
        kinds = tuple(m.agents.kinds[i] for m, i in newest.values())
        seen = Agents.of_rows(
            tuple(newest), kinds, rows.reshape(-1, len(NUMBERS)).T, codes_of(kinds)
        )
        # Extrapolated with its velocity
        x, y = seen.x + unseen * seen.vx, seen.y + unseen * seen.vy
        return replace(seen, x=x, y=y, age=age, unseen=unseen), arrived[-1].visibility

    def _measure(self, world: World) -> Measurement:
        t, config = world.ego.t, self._config
        agents = self._boxes_around.of(world.tracks, t, t).perceived(t)
        x, y = box_center(world.ego, self._vehicle)
        boxes = np.column_stack([agents.x, agents.y, agents.yaw, agents.length, agents.width])
        hiding = np.array(
            [config.occlusion and not kind.is_vulnerable for kind in agents.kinds], bool
        )
        hiding &= ~_boxes_around(boxes, x, y)
        view = np.array([x, y, world.ego.yaw, config.range_m, radians(config.field_of_view_deg)])
        seen = _seen_shares(boxes, hiding, view) >= VISIBLE
        if config.dropout > 0.0:  # (2)
            for i, name in enumerate(agents.ids):
                slot = int(
                    (t + self._draws(name, "phase").uniform(0.0, config.dropout_s))
                    // config.dropout_s
                )
                seen[i] &= self._draws(name, f"slot {slot}").uniform() >= config.dropout
        visibility = Visibility(
            x, y, world.ego.yaw, config.range_m, view[4], _shadows(boxes[hiding], view)
        )
        agents, stamp = agents.some(np.flatnonzero(seen)), f"noise {round(t * 1e9)}"
        draws = np.array(
            [self._draws(name, stamp).standard_normal(5) for name in agents.ids]
        ).reshape(-1, 5)
        spread = np.array([config.position_noise_m] * 2 + [radians(config.yaw_noise_deg)])
        ahead, left, turn = (draws[:, :3] * spread).T  # (1)
        faster, aside = (draws[:, 3:] * config.velocity_noise_mps).T
        c, s = np.cos(agents.yaw), np.sin(agents.yaw)
        noisy = replace(
            agents,
            x=agents.x + ahead * c - left * s,
            y=agents.y + ahead * s + left * c,
            yaw=agents.yaw + turn,
            vx=agents.vx + faster * c - aside * s,
            vy=agents.vy + faster * s + aside * c,
            velocity_sigma=np.full(len(agents), config.velocity_noise_mps),
        )
        return Measurement(t, noisy, visibility)

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
    c, s = cos(box[2]), sin(box[2])
    px, py = (ax - box[0]) * c + (ay - box[1]) * s, (ay - box[1]) * c - (ax - box[0]) * s
    dx, dy = (bx - ax) * c + (by - ay) * s, (by - ay) * c - (bx - ax) * s
    first, last = 0.0, 1.0
    for p, d, half in ((px, dx, 0.5 * box[3]), (py, dy, 0.5 * box[4])):
        if abs(d) < 1e-12:
            if abs(p) > half:
                return False
            continue
        one, two = (-half - p) / d, (half - p) / d
        first, last = max(first, min(one, two)), min(last, max(one, two))
    return first <= last


@kernel
def _boxes_around(boxes: FloatArray, x: float, y: float) -> BoolArray:
    """Return which boxes contain the sensor: such an agent is a collision and does not occlude."""
    out = np.zeros(len(boxes), np.bool_)
    for i in range(len(boxes)):
        out[i] = _crosses(x, y, x, y, boxes[i])
    return out


@kernel
def _seen_shares(boxes: FloatArray, hiding: BoolArray, view: FloatArray) -> FloatArray:
    """Return the share of each box's points that a sensor (x, y, yaw, range, field of view) sees
    `(n,)`.
    """
    n = len(boxes)
    out, points = np.zeros(n), np.empty((POINTS, 2))
    for i in range(n):
        points[:4] = corners(boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3], boxes[i, 4])
        for k in range(4):
            points[4 + k] = 0.5 * (points[k] + points[(k + 1) % 4])
        points[8] = boxes[i, :2]
        reach = hypot(boxes[i, 0] - view[0], boxes[i, 1] - view[1])
        for p in range(POINTS):
            dx, dy = points[p, 0] - view[0], points[p, 1] - view[1]
            if hypot(dx, dy) > view[3] or abs(wrap(atan2(dy, dx) - view[2])) > 0.5 * view[4]:
                continue
            free = True
            for j in range(n):
                away = hypot(boxes[j, 0] - view[0], boxes[j, 1] - view[1])
                between = j != i and hiding[j] and away < reach + boxes[i, 3]
                if between and _crosses(view[0], view[1], points[p, 0], points[p, 1], boxes[j]):
                    free = False
                    break
            out[i] += 1.0 / POINTS if free else 0.0
    return out


@kernel
def _shadows(boxes: FloatArray, view: FloatArray) -> FloatArray:
    """Return the ground hidden behind boxes within range `(k, 4, 2)`: near right, far right, far
    left, near left.
    """
    out, count = np.empty((len(boxes), 4, 2)), 0
    for i in range(len(boxes)):
        dx, dy = boxes[i, 0] - view[0], boxes[i, 1] - view[1]
        if hypot(dx, dy) - 0.5 * hypot(boxes[i, 3], boxes[i, 4]) > view[3]:
            continue
        middle = atan2(dy, dx)
        outline = corners(boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3], boxes[i, 4])
        right, left = pi, -pi
        for k in range(4):
            angle = wrap(atan2(outline[k, 1] - view[1], outline[k, 0] - view[0]) - middle)
            if angle < right:
                right, out[count, 0] = angle, outline[k]
            if angle > left:
                left, out[count, 3] = angle, outline[k]
        half = min(0.5 * (left - right), WIDEST_RAD)
        far = 1.01 * view[3] / cos(half)
        for k, angle in ((1, -half), (2, half)):
            out[count, k, 0] = view[0] + far * cos(middle + 0.5 * (left + right) + angle)
            out[count, k, 1] = view[1] + far * sin(middle + 0.5 * (left + right) + angle)
        count += 1
    return out[:count]
