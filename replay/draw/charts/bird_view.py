"""The scene from above at an instant, ahead to the right: road, ego, other road users, driven path and plan.

(1) p' = R(-yaw) (p - p_ego),  yaw and p_ego those of the ego's rear axle at the instant: x' ahead, y' to the left, m
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Protocol

import numpy as np

from logs.agents import AgentKind, Agents
from logs.arrays import FloatArray
from logs.scenario import Scenario
from logs.shapes import corners
from logs.states import EgoState
from logs.trace import PlannedFrame, Trace
from replay.draw.charts.axes import Plane
from replay.draw.charts.canvas import (
    LETTER_PX,
    Chart,
    area,
    areas,
    cut_line,
    cut_outline,
    dot,
    legend,
    polyline,
    polylines,
    shortened,
    text,
)
from replay.draw.charts.subject import Moment, Subject
from replay.draw.model import decided, plan_seconds
from replay.world import box_center

WIDTH_PX, HEIGHT_PX = 440.0, 226.0
BEHIND_M, AHEAD_M, AHEAD_S, MOST_M = 14.0, 46.0, 3.0, 130.0
"""The visible part: `BEHIND_M` behind the ego, and `AHEAD_S` times its speed ahead, from `AHEAD_M` to `MOST_M`."""
ARROW_S = 1.0
SLOW_MPS = 0.3
SMALL_PX = 3.2
"""An agent that would be smaller is drawn as a dot of this radius."""
MAX_NAMES = 6
NAME_M = 60.0
APART_S = 0.05
"""Instants that are nearer than this are drawn once."""


class SceneSubject(Protocol):
    """What a scene shows: a `Subject`, or a log at a moment (`replay.mine.event_page`)."""

    @property
    def trace(self) -> Trace: ...  # noqa: D102
    @property
    def scenario(self) -> Scenario: ...  # noqa: D102
    @property
    def moment(self) -> Moment: ...  # noqa: D102
    @property
    def frame(self) -> PlannedFrame | None: ...  # noqa: D102


def scene(subject: SceneSubject, t: float, word: str, about: Collection[str] = ()) -> Chart:
    """The scene at a time; `word` names that time ("start", "worst moment", "end"), `about` road users to point out."""
    ego = subject.trace.ego.at(t)
    ahead = min(max(AHEAD_M, AHEAD_S * abs(ego.v)), MOST_M)
    plane = Plane((-BEHIND_M, ahead), (-1.0, 1.0), WIDTH_PX, HEIGHT_PX)
    half = 0.5 * plane.inner[1] * (ahead + BEHIND_M) / plane.inner[0]
    plane = Plane(plane.x, (-half, half), WIDTH_PX, HEIGHT_PX)
    view = _View(plane, ego)
    planned = abs(t - subject.moment.t) < 1e-9
    agents = subject.trace.agents.truth(t)
    driven, frame, car = subject.trace.ego, subject.frame, subject.scenario.vehicle
    inside = _road(view, subject) + polylines(view.lines([np.column_stack([driven.x, driven.y])]), "driven")
    if frame is not None and planned:  # the plan with a dot per second, and the predictions of other road users
        plan, futures = frame.plan.trajectory, frame.predictions
        if futures is not None:
            paths = map(np.column_stack, zip(futures.x, futures.y, strict=True))
            inside += polylines(view.lines(paths), "foreseen")
        inside += polylines(view.lines([np.column_stack([plan.x, plan.y])]), "planned")
        inside += "".join(dot(x, y, 2.4, "second") for x, y in view.of(plan_seconds(frame.plan)).tolist())
    inside += "".join(_other(view, agents, i, pointed=agents.ids[i] in about) for i in range(len(agents)))
    x, y = box_center(ego, car)
    box = view.of(corners(x, y, ego.yaw, car.length, car.width))
    front = box[np.argsort(box[:, 0])[2:]]
    nose = np.vstack([front[0], view.of(np.array([[x, y]]))[0], front[1]])
    inside += area(box[:, 0], box[:, 1], "ego") + polyline(nose[:, 0], nose[:, 1], "nose")
    title = f"{word[:1].upper()}{word[1:]}: {t:.2f} s, {ego.v:.1f} m/s"
    names = _names(view, agents, subject, about, planned=planned)
    drawn = plane.drawn(inside, x_title="ahead of the rear axle [m]", over=names)
    head = text(2.0, 13.0, title, "title") + text(2.0, 33.0, "left [m]", "tick")
    entries = [("area", "ego", "ego"), ("area", "other", "moves"), ("area", "still", "stands")]
    entries += [("line", "driven", "driven")]
    entries += [("line", "planned", "plan, a dot a second")] if planned and subject.frame else []
    head += legend(60.0, 33.0, entries, WIDTH_PX - 70.0)
    says = f"Scene, {title}; no other road users"
    if len(agents):
        away = np.hypot(agents.x - ego.x, agents.y - ego.y)
        i = int(np.argmin(away))
        nearest = f"{subject.scenario.short_names(agents.ids[i])}, {away[i]:.0f} m away"
        says = f"Scene, {title}; {len(agents)} other road users, the nearest {nearest}"
    return Chart(f"scene_{word.replace(' ', '_')}", title, says, WIDTH_PX, HEIGHT_PX, drawn + head)


def scenes(subject: Subject) -> list[Chart]:
    """The scenes at the start, the moment and the end; instants that coincide are drawn once."""
    first, last = float(subject.trace.ego.t[0]), float(subject.trace.ego.t[-1])
    instants = [(subject.moment.t, "this moment" if subject.moment.why == "as asked" else "worst moment")]
    if place_of_moment(subject):
        instants.insert(0, (first, "start"))
    if last - subject.moment.t > APART_S:
        instants.append((last, "end"))
    return [scene(subject, t, word) for t, word in instants]


def place_of_moment(subject: Subject) -> int:
    """The index of the scene at the moment in `scenes`."""
    return int(subject.moment.t - float(subject.trace.ego.t[0]) > APART_S)


class _View:
    """Converts points of the world to pixels of the picture, (1)."""

    def __init__(self, plane: Plane, ego: EgoState) -> None:
        self.plane, self.ego = plane, ego
        self._turn = np.array([[np.cos(ego.yaw), -np.sin(ego.yaw)], [np.sin(ego.yaw), np.cos(ego.yaw)]])

    def of(self, points: FloatArray) -> FloatArray:
        """Pixels `(n, 2)` in the plot area of world points `(n, 2)`."""
        local = (np.asarray(points, np.float64).reshape(-1, 2) - [self.ego.x, self.ego.y]) @ self._turn
        return np.column_stack([self.plane.at_x(local[:, 0]), self.plane.at_y(local[:, 1])])

    def sees(self, pixels: FloatArray) -> bool:
        """Whether the bounding box of points `(n, 2)` overlaps the plot area."""
        wide, high = self.plane.inner
        low, top = pixels.min(axis=0), pixels.max(axis=0)
        return bool(low[0] <= wide and top[0] >= 0.0 and low[1] <= high and top[1] >= 0.0)

    def outlines(self, rings: Iterable[FloatArray]) -> list[FloatArray]:
        """Outlines of the world as pixels: the parts in and around the plot area."""
        shown = (self.of(ring) for ring in rings)
        return [cut_outline(ring, *self.plane.inner) for ring in shown if self.sees(ring)]

    def lines(self, some: Iterable[FloatArray]) -> list[FloatArray]:
        """Lines of the world as pixels: the parts in and around the plot area."""
        shown = (self.of(line) for line in some)
        return [piece for line in shown if self.sees(line) for piece in cut_line(line, *self.plane.inner)]


def _road(view: _View, subject: SceneSubject) -> str:
    """Lanes, crosswalks, the goal, and stop lines with the colour of their light as a word."""
    road, goal = subject.scenario.road, subject.scenario.goal
    lanes = list(road.lanes.values())
    drawn = areas(view.outlines(lane.polygon for lane in lanes if not lane.drivable), "walk")
    drawn += areas(view.outlines(lane.polygon for lane in lanes if lane.drivable), "road")
    drawn += polylines(view.lines(side for lane in lanes for side in (lane.left, lane.right)), "lane")
    drawn += areas(view.outlines(walk.polygon for walk in road.crosswalks), "zebra")
    drawn += areas(view.outlines(() if goal is None else goal.regions), "goal")
    lights = {light.id: light for light in subject.scenario.lights}
    for stop in road.stop_lines:
        ends = view.of(stop.points)
        if view.sees(ends):
            drawn += polyline(ends[:, 0], ends[:, 1], "stop")
            if stop.light in lights:
                word = lights[stop.light].at(view.ego.t).value
                drawn += text(float(ends[:, 0].max()) + 4.0, float(ends[:, 1].mean()) + 3.5, word, "small")
    return drawn


def _other(view: _View, agents: Agents, i: int, *, pointed: bool) -> str:
    """A box, or a dot for pedestrians and small boxes; a moving agent has a line to its position in one second."""
    box = view.of(corners(*(float(c[i]) for c in (agents.x, agents.y, agents.yaw, agents.length, agents.width))))
    if not view.sees(box):
        return ""
    moving = float(np.nan_to_num(agents.speed[i])) > SLOW_MPS
    kind = "wrong" if pointed else "other" if moving else "still"
    here, velocity = np.array([agents.x[i], agents.y[i]]), np.array([agents.vx[i], agents.vy[i]])
    ends = view.of(np.array([here, here + ARROW_S * velocity]))
    arrow = polyline(ends[:, 0], ends[:, 1], "heading") if moving else ""
    small = max(float(np.ptp(box[:, 0])), float(np.ptp(box[:, 1]))) < 2.0 * SMALL_PX
    if small or agents.kinds[i] is AgentKind.PEDESTRIAN:
        return arrow + dot(float(ends[0, 0]), float(ends[0, 1]), SMALL_PX, kind)
    return arrow + area(box[:, 0], box[:, 1], kind)


def _names(view: _View, agents: Agents, subject: SceneSubject, pointed: Collection[str], *, planned: bool) -> str:
    """Ids of agents, those with a decision first, then the nearest; names that would overlap another are omitted."""
    wide, high = view.plane.inner
    about = decided(subject.frame.plan) if planned and subject.frame is not None else {}
    first = pointed or about
    at = view.of(np.column_stack([agents.x, agents.y]))
    away = np.hypot(agents.x - view.ego.x, agents.y - view.ego.y)
    order = sorted(range(len(agents)), key=lambda i: (agents.ids[i] not in first, float(away[i])))
    placed: list[tuple[float, float, float]] = []
    out = []
    for i in order:
        x, y = at[i].tolist()
        inside = 0.0 <= x <= wide and 0.0 <= y <= high and away[i] <= max(NAME_M, view.plane.x[1])
        if not inside or len(placed) >= MAX_NAMES:
            continue
        decision = f": {about[agents.ids[i]].kind.value}" if agents.ids[i] in about else ""
        words = shortened(subject.scenario.short_names(agents.ids[i]), 110.0) + decision
        half = 0.5 * LETTER_PX * len(words)
        below = y < 20.0 or (y > 0.5 * high and high - y > 20.0)
        x, y = min(max(x, half), wide - half), y + 18.0 if below else y - 9.0
        if all(abs(y - other_y) > 11.0 or abs(x - other_x) > half + other for other_x, other_y, other in placed):
            placed.append((x, y, half))
            out.append(text(x, y, words, "name mid"))
    return "".join(out)
