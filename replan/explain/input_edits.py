"""The edits that changes of a planner's input make: of a frame, or of the context.

Left and ahead are those of the ego at the frame. Changed agents keep their names; an edit of agents
holds for their predictions, too, unless it says otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import cos, inf, sin
from typing import Any

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.logs.frame import Frame, PlannerContext, Predictions
from replan.logs.road import Road
from replan.logs.rules import Colour

MOVES_MPS = 0.5
"""Agents that are faster than this move."""


@dataclass(frozen=True)
class ChangedInput:
    """What an edit gets.

    Attributes:
        frame: The frame to change.
        earlier: The frame `n` frames before it, or the first one of the drive.
        value: The value of the change.
        agents: Which of the agents the change is about, `(n,)`.
    """

    frame: Frame
    earlier: Callable[[int], Frame]
    value: float
    agents: BoolArray

    @property
    def predicted(self) -> BoolArray:
        """Which predictions are of these agents, `(k,)`."""
        return self.agents[self.frame.predictions.agent]

    @property
    def in_ego_frame(self) -> tuple[FloatArray, FloatArray]:
        """How far ahead and how far to the left of the ego's rear axle each agent is, m."""
        return self.frame.ego.offset_of(self.frame.agents.x, self.frame.agents.y)

    def keep(self, mask: BoolArray) -> Frame:
        """The frame without those of the agents that the mask leaves out."""
        stays = mask | ~self.agents
        agents, predictions = self.frame.agents, self.frame.predictions
        new_row = np.cumsum(stays) - 1
        rows = np.flatnonzero(stays[predictions.agent])
        return replace(
            self.frame,
            agents=agents.some(np.flatnonzero(stays)),
            predictions=_rows_of(predictions, rows, new_row),
        )

    def move(self, dx: float, dy: float) -> Frame:
        """The frame with the agents and their predictions moved in the world, m."""
        agents, predictions = self.frame.agents, self.frame.predictions
        selected, rows = 1.0 * self.agents, 1.0 * self.predicted[:, None]
        return replace(
            self.frame,
            agents=replace(agents, x=agents.x + dx * selected, y=agents.y + dy * selected),
            predictions=replace(
                predictions, x=predictions.x + dx * rows, y=predictions.y + dy * rows
            ),
        )

    def scale_predictions(self, share: float) -> Predictions:
        """The predictions with their displacements from the first sample times `share`."""
        predictions = self.frame.predictions
        rows = self.predicted[:, None]
        x, y = predictions.x, predictions.y
        return replace(
            predictions,
            x=np.where(rows, x[:, :1] + share * (x - x[:, :1]), x),
            y=np.where(rows, y[:, :1] + share * (y - y[:, :1]), y),
        )


Measure = Callable[[ChangedInput], FloatArray]
"""A distance of each agent, m."""


def _rows_of(predictions: Predictions, rows: Any, new_row: Any) -> Predictions:
    """Some of the predictions; agent i becomes agent `new_row[i]`."""
    columns = {name: getattr(predictions, name)[rows] for name in ("probability", "x", "y", "yaw")}
    return replace(predictions, agent=new_row[predictions.agent[rows]], **columns)


def shifted(given: ChangedInput, ahead: float = 0.0, left: float = 0.0) -> Frame:
    """The agents moved by the value times (ahead, left), in the ego's frame."""
    c, s = given.value * cos(given.frame.ego.yaw), given.value * sin(given.frame.ego.yaw)
    return given.move(c * ahead - s * left, s * ahead + c * left)


def shifted_in_world(given: ChangedInput, x: float = 0.0, y: float = 0.0) -> Frame:
    """The agents moved by the value times (x, y), in the world."""
    return given.move(given.value * x, given.value * y)


def moved_along_agents(given: ChangedInput) -> Frame:
    """Each agent moved along its own heading at the frame."""
    agents, predictions = given.frame.agents, given.frame.predictions
    dx = given.value * np.cos(agents.yaw) * given.agents
    dy = given.value * np.sin(agents.yaw) * given.agents
    x, y = predictions.x + dx[predictions.agent, None], predictions.y + dy[predictions.agent, None]
    return replace(
        given.frame,
        agents=replace(agents, x=agents.x + dx, y=agents.y + dy),
        predictions=replace(predictions, x=x, y=y),
    )


def beside(given: ChangedInput) -> FloatArray:
    """How far each agent is to the side of the ego, m."""
    return np.abs(given.in_ego_frame[1])


def away(given: ChangedInput) -> FloatArray:
    """How far each agent is from the ego's rear axle, m."""
    ahead, left = given.in_ego_frame
    return np.hypot(ahead, left)


def within(given: ChangedInput, measure: Measure) -> Frame:
    """Only the agents whose measure is at most the value."""
    return given.keep(measure(given) <= given.value)


def beyond(given: ChangedInput, measure: Measure) -> Frame:
    """Only the agents whose measure is above the value."""
    return given.keep(measure(given) > given.value)


def kept(given: ChangedInput, mask: Callable[[ChangedInput], BoolArray]) -> Frame:
    """Only the agents of a mask."""
    return given.keep(mask(given))


def is_ahead(given: ChangedInput) -> BoolArray:
    """Agents that are not behind the ego's rear axle."""
    return given.in_ego_frame[0] >= 0.0


def is_left(given: ChangedInput) -> BoolArray:
    """Agents to the left of the ego."""
    return given.in_ego_frame[1] >= 0.0


def is_right(given: ChangedInput) -> BoolArray:
    """Agents to the right of the ego."""
    return given.in_ego_frame[1] <= 0.0


def moves(given: ChangedInput) -> BoolArray:
    """Agents that move."""
    return given.frame.agents.speed > MOVES_MPS


def stands(given: ChangedInput) -> BoolArray:
    """Agents that stand."""
    return given.frame.agents.speed <= MOVES_MPS


def no_agent(given: ChangedInput) -> BoolArray:
    """None of the agents."""
    return np.zeros(len(given.agents), np.bool_)


def only_nearest(given: ChangedInput) -> Frame:
    """Only the `value` nearest of the agents."""
    ahead, left = given.in_ego_frame
    distance = np.where(given.agents, np.hypot(ahead, left), inf)
    rank = np.argsort(np.argsort(distance, kind="stable"), kind="stable")
    return given.keep(rank < round(given.value))


def sized(given: ChangedInput) -> Frame:
    """The agents are larger by a factor."""
    agents = given.frame.agents
    factor = np.where(given.agents, given.value, 1.0)
    boxes = replace(agents, length=factor * agents.length, width=factor * agents.width)
    return replace(given.frame, agents=boxes)


def turned(given: ChangedInput) -> Frame:
    """The agents and their predictions are turned about their centres, rad."""
    agents, predictions = given.frame.agents, given.frame.predictions
    return replace(
        given.frame,
        agents=replace(agents, yaw=agents.yaw + given.value * given.agents),
        predictions=replace(
            predictions, yaw=predictions.yaw + given.value * given.predicted[:, None]
        ),
    )


def slower_agents(given: ChangedInput) -> Frame:
    """The agents are faster by a factor, and predicted to move farther by it."""
    agents = given.frame.agents
    factor = np.where(given.agents, given.value, 1.0)
    slow = replace(agents, vx=factor * agents.vx, vy=factor * agents.vy)
    return replace(given.frame, agents=slow, predictions=given.scale_predictions(given.value))


def old_agents(given: ChangedInput) -> Frame:
    """Agents and predictions of some frames before."""
    old = given.earlier(round(given.value))
    return replace(given.frame, agents=old.agents, predictions=old.predictions)


def restamped_agents(given: ChangedInput) -> Frame:
    """Old agents and predictions, with the times of the frame."""
    old = old_agents(given)
    predictions = replace(old.predictions, t=old.predictions.t - old.predictions.t[0] + old.t)
    return replace(old, predictions=predictions)


def old_predictions(given: ChangedInput) -> Frame:
    """Predictions of an earlier frame, for the agents that it had."""
    old = given.earlier(round(given.value))
    row = {name: i for i, name in enumerate(given.frame.agents.ids)}
    new_row = np.array([row.get(name, -1) for name in old.agents.ids], dtype=np.int64)
    rows = np.flatnonzero(new_row[old.predictions.agent] >= 0)
    return replace(given.frame, predictions=_rows_of(old.predictions, rows, new_row))


def straight_on(given: ChangedInput) -> Frame:
    """Each agent predicted once, straight on at its velocity."""
    agents, t = given.frame.agents, given.frame.predictions.t
    after = t - t[0]
    n = len(agents)
    return replace(
        given.frame,
        predictions=replace(
            given.frame.predictions,
            agent=np.arange(n),
            probability=np.ones(n),
            x=agents.x[:, None] + agents.vx[:, None] * after,
            y=agents.y[:, None] + agents.vy[:, None] * after,
            yaw=np.repeat(agents.yaw[:, None], len(t), axis=1),
        ),
    )


def only_likeliest(given: ChangedInput) -> Frame:
    """Only the likeliest prediction of each agent, the first of equal ones."""
    predictions = given.frame.predictions
    best: dict[int, int] = {}
    for row, agent in enumerate(predictions.agent):
        if agent not in best or predictions.probability[row] > predictions.probability[best[agent]]:
            best[int(agent)] = row
    rows = np.array(sorted(best.values()), dtype=np.int64)
    return replace(
        given.frame, predictions=_rows_of(predictions, rows, np.arange(len(given.agents)))
    )


def short(given: ChangedInput) -> Frame:
    """The predictions end after some seconds."""
    predictions = given.frame.predictions
    samples = int(np.searchsorted(predictions.t, given.frame.t + given.value + 1e-6, "right"))
    columns = {name: getattr(predictions, name)[:, :samples] for name in ("x", "y", "yaw")}
    return replace(
        given.frame, predictions=replace(predictions, t=predictions.t[:samples], **columns)
    )


def scaled_predictions(given: ChangedInput) -> Frame:
    """The agents are predicted to move farther by a factor."""
    return replace(given.frame, predictions=given.scale_predictions(given.value))


def recoloured_lights(given: ChangedInput, colours: Mapping[Colour, Colour]) -> Frame:
    """Lights of some colours with another one."""
    lights = given.frame.lights
    shown = {name: colours.get(colour, colour) for name, colour in lights.items()}
    return replace(given.frame, lights=shown)


def old_lights(given: ChangedInput) -> Frame:
    """The lights of some frames before."""
    return replace(given.frame, lights=given.earlier(round(given.value)).lights)


def no_lights(given: ChangedInput) -> Frame:
    """There are no lights."""
    return replace(given.frame, lights={})


def other_lights(given: ChangedInput) -> Frame:
    """Each light with the colour of the next one, in the order of their numbers."""
    names = sorted(given.frame.lights)
    following = dict(zip(names, [*names[1:], *names[:1]], strict=True))
    lights = {name: given.frame.lights[following[name]] for name in names}
    return replace(given.frame, lights=lights)


def no_previous(given: ChangedInput) -> Frame:
    """There is no previous plan."""
    return replace(given.frame, previous=None)


def _ego(given: ChangedInput, **columns: float) -> Frame:
    return replace(given.frame, ego=replace(given.frame.ego, **columns))


def slower_ego(given: ChangedInput) -> Frame:
    """The ego is faster by a factor."""
    return _ego(given, v=given.value * given.frame.ego.v)


def steady_ego(given: ChangedInput) -> Frame:
    """The ego does not accelerate."""
    return _ego(given, a=0.0)


def turned_ego(given: ChangedInput) -> Frame:
    """The ego is turned, rad."""
    return _ego(given, yaw=given.frame.ego.yaw + given.value)


def old_ego(given: ChangedInput) -> Frame:
    """The ego's state of some frames before, as of now."""
    old = given.earlier(round(given.value)).ego
    return replace(given.frame, ego=replace(old, t=given.frame.ego.t))


def shifted_ego(given: ChangedInput, ahead: float = 0.0, left: float = 0.0) -> Frame:
    """The ego moved by the value times (ahead, left), in its own frame."""
    ego = given.frame.ego
    c, s = given.value * cos(ego.yaw), given.value * sin(ego.yaw)
    return _ego(given, x=ego.x + c * ahead - s * left, y=ego.y + s * ahead + c * left)


def without_goal(context: PlannerContext, value: float) -> PlannerContext:
    """There is no goal."""
    return replace(context, goal=None)


def limited(context: PlannerContext, value: float) -> PlannerContext:
    """The speed limits are higher by a factor."""
    road: Road = context.road
    lanes = {
        name: replace(lane, speed_limit=value * lane.speed_limit)
        for name, lane in road.lanes.items()
    }
    default = value * road.default_speed_limit
    return replace(context, road=replace(road, lanes=lanes, default_speed_limit=default))


def wider(context: PlannerContext, value: float) -> PlannerContext:
    """The ego is wider by a factor."""
    return replace(context, vehicle=replace(context.vehicle, width=value * context.vehicle.width))
