"""The scene from above at an instant, ahead to the right: road, ego, other road users, driven path
and plan.

(1) p' = R(-yaw) (p - p_ego),
        yaw and p_ego those of the ego's rear axle at the instant: x' ahead, y' to the left, m
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from replan.core.arrays import FloatArray
from replan.draw.charts.axes import Plane
from replan.draw.charts.chart import Chart
from replan.draw.charts.legend import legend_words
from replan.draw.charts.simplify import cut_line, cut_outline
from replan.draw.charts.style import DRIVES
from replan.draw.charts.subject import ASKED, SceneSubject, Subject
from replan.draw.charts.svg import LETTER_PX, area, areas, dot, polyline, polylines, shortened, text
from replan.draw.drawn_scene import decided, path_of, plan_seconds
from replan.logs.agents import AgentKind, Agents
from replan.logs.scenario import Scenario
from replan.logs.shapes import corners
from replan.logs.states import EgoState
from replan.replay.world import box_center

WIDTH_PX, HEIGHT_PX = 440.0, 226.0
BEHIND_M, AHEAD_M, MOST_M = 14.0, 46.0, 130.0
AHEAD_S = 3.0
"""The visible part: `BEHIND_M` behind the ego, and `AHEAD_S` times its speed ahead, from `AHEAD_M`
to `MOST_M`.
"""
ARROW_S = 1.0
SLOW_MPS = 0.3
SMALL_PX = 3.2  # An agent that would be smaller is drawn as a dot of this radius
MAX_NAMES = 6
NAME_M = 60.0
NAME_PX = 110.0  # Largest width of a name
# Other egos are in view up to this distance, with so much ground around them
FAR_M, AROUND_M = 80.0, 8.0
APART_S = 0.05  # Instants that are nearer than this are drawn once


def scene(subject: SceneSubject, t: float, word: str, about: Collection[str] = ()) -> Chart:
    """The scene at a time; `word` names that time ("start", "worst moment", "end"), `about` road
    users to point out.

    Of several drives, the road users are those of the first; an ego whose drive has ended is where
    it ended.
    """
    drives = subject.drives
    states = [
        drive.trace.ego.at(float(np.clip(t, *drive.trace.ego.t[[0, -1]])))
        for drive in drives.values()
    ]
    ego, several = states[0], len(drives) > 1
    planned = abs(t - subject.moment.t) < 1e-9
    agents = subject.trace.agents.truth(t)
    named_agents = subject.named_agents.union(about) if planned else about
    is_named = np.array([name in named_agents for name in agents.ids], np.bool_)
    named_places = np.column_stack([agents.x, agents.y])[is_named]
    view = BirdView(_plane(ego, states, named_places), ego)
    paths, boxes = "", ""
    for drive, state, kind in zip(drives.values(), states, DRIVES, strict=False):
        path = _path(view, drive, kind if several else "planned", planned=planned)
        box = _box(view, drive, state)
        paths += f'<g class="{kind}">{path}</g>' if several else path
        boxes = (f'<g class="{kind}">{box}</g>' if several else box) + boxes  # the first on top
    inside = drawn_road(view, subject.scenario)
    inside += (_foreseen(view, subject) if planned else "") + paths
    for row, name in enumerate(agents.ids):
        inside += _other(view, agents, row, pointed=name in about)
    inside += boxes
    title, named = f"{word[:1].upper()}{word[1:]}: {t:.2f} s", {}
    if several:
        for (name, drive), state in zip(drives.items(), states, strict=True):
            does = "ended" if t > drive.trace.ego.t[-1] + 1e-6 else f"{state.v:.1f} m/s"
            named[f"{shortened(name, NAME_PX)}: {does}"] = state
    else:
        title += f", {ego.v:.1f} m/s"
    names = _names(view, agents, subject, named, about, planned=planned)
    entries, x_title = [("area", "ego", "ego")], "ahead of the rear axle [m]"
    if several:
        x_title = (
            f"ahead of the rear axle of {shortened(next(iter(drives)), NAME_PX)} [m]; road "
            "users as in its drive"
        )
        named_kinds = zip(DRIVES, legend_words(list(drives), WIDTH_PX - 190.0), strict=False)
        entries = [("line", kind, name) for kind, name in named_kinds]
    entries += [("area", "moving", "moves"), ("area", "standing", "stands")]
    if not several:
        entries += [("line", "driven", "driven")]
        if planned and subject.frame is not None:
            entries += [("line", "planned", "plan, dots: 1 s")]
            fan = bool(subject.frame.plan.alternatives)
            entries += [("line", "alternative", "alternatives")] if fan else []
    says = f"Scene, {title}; no other road users"
    if len(agents):
        distances_m = np.hypot(agents.x - ego.x, agents.y - ego.y)
        row = int(np.argmin(distances_m))
        name = subject.scenario.short_names(agents.ids[row])
        nearest = f"{name}, {distances_m[row]:.0f} m away"
        says = f"Scene, {title}; {len(agents)} other road users, the nearest {nearest}"
    name = f"scene_{word.replace(' ', '_')}"
    axes = dict[str, Any](x_title=x_title, y_title="left [m]", entries=entries, over=names)
    return view.plane.chart(name, title, inside, says=says, **axes)


def scenes(subject: Subject) -> list[Chart]:
    """The scenes at the start, the moment and the end; instants that coincide are drawn once."""
    first, last = float(subject.trace.ego.t[0]), float(subject.trace.ego.t[-1])
    instants = [
        (subject.moment.t, "this moment" if subject.moment.why == ASKED else "worst moment")
    ]
    if place_of_moment(subject):
        instants.insert(0, (first, "start"))
    if last - subject.moment.t > APART_S:
        instants.append((last, "end"))
    return [scene(subject, t, word) for t, word in instants]


def _local(ego: EgoState, points: FloatArray) -> FloatArray:
    """Points `(n, 2)` of the world relative to the ego, (1), m."""
    turn = np.array([[np.cos(ego.yaw), -np.sin(ego.yaw)], [np.sin(ego.yaw), np.cos(ego.yaw)]])
    return (np.asarray(points, np.float64).reshape(-1, 2) - [ego.x, ego.y]) @ turn


def _plane(ego: EgoState, shown: Sequence[EgoState], agents: FloatArray) -> Plane:
    """The visible part: around and ahead of the ego, and around other egos and agents `(n, 2)` that
    are nearer than `FAR_M`.
    """
    egos = np.array([(state.x, state.y) for state in shown])
    others = _local(ego, np.concatenate([egos, agents]))
    others = others[np.hypot(others[:, 0], others[:, 1]) < FAR_M]
    ahead = min(max(AHEAD_M, AHEAD_S * abs(ego.v)), MOST_M)
    low = min(-BEHIND_M, others[:, 0].min() - AROUND_M)
    high = max(ahead, others[:, 0].max() + AROUND_M)
    plane = Plane((low, high), (-1.0, 1.0), WIDTH_PX, HEIGHT_PX)
    ratio = 0.5 * plane.inner[1] / plane.inner[0]
    half = max(
        ratio * (high - low), np.abs(others[:, 1]).max() + AROUND_M if len(others) > 1 else 0.0
    )
    return Plane((low, low + half / ratio), (-half, half), WIDTH_PX, HEIGHT_PX)


def place_of_moment(subject: Subject) -> int:
    """The index of the scene at the moment in `scenes`."""
    return int(subject.moment.t - float(subject.trace.ego.t[0]) > APART_S)


class BirdView:
    """Converts points of the world to pixels of the picture, (1)."""

    def __init__(self, plane: Plane, ego: EgoState) -> None:
        self.plane, self.ego = plane, ego

    def of(self, points: FloatArray) -> FloatArray:
        """Pixels `(n, 2)` in the plot area of world points `(n, 2)`."""
        local = _local(self.ego, points)
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

    def lines(self, lines: Iterable[FloatArray]) -> list[FloatArray]:
        """Lines of the world as pixels: the parts in and around the plot area."""
        shown = [pixels for pixels in map(self.of, lines) if self.sees(pixels)]
        return [piece for pixels in shown for piece in cut_line(pixels, *self.plane.inner)]


def drawn_road(view: BirdView, scenario: Scenario) -> str:
    """Lanes, crosswalks, the goal, and stop lines with the colour of their light as a word."""
    road, goal = scenario.road, scenario.goal
    lanes = list(road.lanes.values())
    drawn = areas(view.outlines(lane.polygon for lane in lanes if not lane.drivable), "undrivable")
    drawn += areas(view.outlines(lane.polygon for lane in lanes if lane.drivable), "drivable")
    drawn += polylines(
        view.lines(side for lane in lanes for side in (lane.left, lane.right)), "lane_side"
    )
    drawn += areas(view.outlines(walk.polygon for walk in road.crosswalks), "crosswalk")
    drawn += areas(view.outlines(() if goal is None else goal.regions), "goal")
    lights = {light.id: light for light in scenario.lights}
    for stop in road.stop_lines:
        ends = view.of(stop.points)
        if view.sees(ends):
            drawn += polyline(ends[:, 0], ends[:, 1], "stop_line")
            if stop.light in lights:
                word = lights[stop.light].at(view.ego.t).value
                drawn += text(
                    float(ends[:, 0].max()) + 4.0, float(ends[:, 1].mean()) + 3.5, word, "small"
                )
    return drawn


def _foreseen(view: BirdView, subject: SceneSubject) -> str:
    """The predictions of other road users in the newest frame."""
    futures = None if subject.frame is None else subject.frame.predictions
    paths = () if futures is None else map(np.column_stack, zip(futures.x, futures.y, strict=True))
    return polylines(view.lines(paths), "predicted")


def _path(view: BirdView, subject: SceneSubject, kind: str, *, planned: bool) -> str:
    """The driven path, and the newest plan as a line of a kind with a dot per second."""
    driven = subject.trace.ego
    drawn = polylines(view.lines([np.column_stack([driven.x, driven.y])]), "driven")
    if planned and subject.frame is not None:
        plan = subject.frame.plan.trajectory
        fan = [path_of(alternative.trajectory) for alternative in subject.frame.plan.alternatives]
        drawn += polylines(view.lines(fan), "alternative")
        drawn += polylines(view.lines([np.column_stack([plan.x, plan.y])]), kind)
        drawn += "".join(
            dot(x, y, 2.4, "plan_second")
            for x, y in view.of(plan_seconds(subject.frame.plan)).tolist()
        )
    return drawn


def _box(view: BirdView, subject: SceneSubject, ego: EgoState) -> str:
    """The ego's box, with its front marked."""
    car = subject.scenario.vehicle
    x, y = box_center(ego, car)
    around = corners(x, y, ego.yaw, car.length, car.width)
    box = view.of(around)
    ahead = np.array([np.cos(ego.yaw), np.sin(ego.yaw)])
    front = box[np.argsort(around @ ahead)[2:]]
    nose = np.vstack([front[0], view.of(np.array([[x, y]]))[0], front[1]])
    return area(box[:, 0], box[:, 1], "ego") + polyline(nose[:, 0], nose[:, 1], "ego_front")


def _other(view: BirdView, agents: Agents, row: int, *, pointed: bool) -> str:
    """A box, or a dot for pedestrians and small boxes.

    A moving agent has a line to its position in one second.
    """
    columns = (agents.x, agents.y, agents.yaw, agents.length, agents.width)
    box = view.of(corners(*(float(column[row]) for column in columns)))
    if not view.sees(box):
        return ""
    moving = float(np.nan_to_num(agents.speed[row])) > SLOW_MPS
    kind = "moving" if moving else "standing"
    if pointed:
        kind = "pointed_out"
    center = np.array([agents.x[row], agents.y[row]])
    velocity = np.array([agents.vx[row], agents.vy[row]])
    ends = view.of(np.array([center, center + ARROW_S * velocity]))
    arrow = polyline(ends[:, 0], ends[:, 1], "velocity") if moving else ""
    small = max(float(np.ptp(box[:, 0])), float(np.ptp(box[:, 1]))) < 2.0 * SMALL_PX
    if small or agents.kinds[row] is AgentKind.PEDESTRIAN:
        return arrow + dot(float(ends[0, 0]), float(ends[0, 1]), SMALL_PX, kind)
    return arrow + area(box[:, 0], box[:, 1], kind)


def _names(
    view: BirdView,
    agents: Agents,
    subject: SceneSubject,
    egos: Mapping[str, EgoState],
    pointed: Collection[str],
    *,
    planned: bool,
) -> str:
    """Names of egos, then ids of agents: those with a decision, then the nearest.

    Without those that would overlap.
    """
    wide, high = view.plane.inner
    about = decided(subject.frame.plan) if planned and subject.frame is not None else {}
    first = pointed or about
    centers = view.of(np.column_stack([agents.x, agents.y]))
    distances_m = np.hypot(agents.x - view.ego.x, agents.y - view.ego.y)
    is_second = [name not in first for name in agents.ids]
    order = np.lexsort((distances_m, is_second))
    placed: list[tuple[float, float, float]] = []
    labels = []

    def place(x: float, y: float, words: str) -> bool:
        half = 0.5 * LETTER_PX * len(words)
        x = min(max(x, half), wide - half)
        free = all(
            abs(y - other_y) > 11.0 or abs(x - other_x) > half + other
            for other_x, other_y, other in placed
        )
        if free:
            placed.append((x, y, half))
            labels.append(text(x, y, words, "label middle"))
        return free

    for name, ego in egos.items():  # at the edge, with its distance, if it is out of view
        ((x, y),) = view.of(np.array([[ego.x, ego.y]])).tolist()
        inside = 0.0 <= x <= wide and 0.0 <= y <= high
        distance_m = np.hypot(ego.x - view.ego.x, ego.y - view.ego.y)
        words = name if inside else f"{name}, {distance_m:.0f} m away"
        x, y = min(max(x, 0.0), wide), min(max(y, 32.0), high - 32.0)
        any(place(x, y + up, words) for up in (-9.0, 18.0, -21.0, 30.0))
    most = len(placed) + MAX_NAMES
    farthest_m = max(NAME_M, view.plane.x[1])
    for row in order:
        name, (x, y) = agents.ids[row], centers[row].tolist()
        inside = 0.0 <= x <= wide and 0.0 <= y <= high and distances_m[row] <= farthest_m
        if inside and len(placed) < most:
            decision = f": {about[name].kind.value}" if name in about else ""
            below = y < 20.0 or (y > 0.5 * high and high - y > 20.0)
            words = shortened(subject.scenario.short_names(name), NAME_PX) + decision
            place(x, y + 18.0 if below else y - 9.0, words)
    return "".join(labels)
