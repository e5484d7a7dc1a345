"""Changes of a planner's input: hypotheses about what a planner is fed, as rows of one table.

    change = parse("delay agents 11")
    frames = changed(frames, [change])             # a planner that gets these acts on old agents

A change is a name of `CHANGES`, a value in the unit of its row, and, where the row says so, the
kinds of road users that it is about: "shift agents left 1.5 of pedestrian, bicycle". Left and ahead
are those of the ego at the frame. Changed agents keep their names; a change of agents holds for
their predictions, too, unless the row says otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import cos, inf, nan, sin
from types import MappingProxyType
from typing import Any

import numpy as np

from replan.core.arrays import BoolArray, FloatArray
from replan.core.errors import ConfigError, unknown_name
from replan.logs.agents import AgentKind
from replan.logs.frame import Frame, PlannerContext, Predictions
from replan.logs.past import Snapshot
from replan.logs.road import Road
from replan.logs.rules import RED, Colour

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


def _shifted(given: ChangedInput, ahead: float = 0.0, left: float = 0.0) -> Frame:
    """The agents moved by the value times (ahead, left), in the ego's frame."""
    c, s = given.value * cos(given.frame.ego.yaw), given.value * sin(given.frame.ego.yaw)
    return given.move(c * ahead - s * left, s * ahead + c * left)


def _shifted_in_world(given: ChangedInput, x: float = 0.0, y: float = 0.0) -> Frame:
    """The agents moved by the value times (x, y), in the world."""
    return given.move(given.value * x, given.value * y)


def _moved_along_agents(given: ChangedInput) -> Frame:
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


def _beside(given: ChangedInput) -> FloatArray:
    """How far each agent is to the side of the ego, m."""
    return np.abs(given.in_ego_frame[1])


def _away(given: ChangedInput) -> FloatArray:
    """How far each agent is from the ego's rear axle, m."""
    ahead, left = given.in_ego_frame
    return np.hypot(ahead, left)


def _within(given: ChangedInput, measure: Measure) -> Frame:
    """Only the agents whose measure is at most the value."""
    return given.keep(measure(given) <= given.value)


def _beyond(given: ChangedInput, measure: Measure) -> Frame:
    """Only the agents whose measure is above the value."""
    return given.keep(measure(given) > given.value)


def _kept(given: ChangedInput, mask: Callable[[ChangedInput], BoolArray]) -> Frame:
    """Only the agents of a mask."""
    return given.keep(mask(given))


def _is_ahead(given: ChangedInput) -> BoolArray:
    return given.in_ego_frame[0] >= 0.0


def _is_left(given: ChangedInput) -> BoolArray:
    return given.in_ego_frame[1] >= 0.0


def _is_right(given: ChangedInput) -> BoolArray:
    return given.in_ego_frame[1] <= 0.0


def _moves(given: ChangedInput) -> BoolArray:
    return given.frame.agents.speed > MOVES_MPS


def _stands(given: ChangedInput) -> BoolArray:
    return given.frame.agents.speed <= MOVES_MPS


def _no_agent(given: ChangedInput) -> BoolArray:
    return np.zeros(len(given.agents), np.bool_)


def _nearest(given: ChangedInput) -> Frame:
    """Only the `value` nearest of the agents."""
    ahead, left = given.in_ego_frame
    distance = np.where(given.agents, np.hypot(ahead, left), inf)
    rank = np.argsort(np.argsort(distance, kind="stable"), kind="stable")
    return given.keep(rank < round(given.value))


def _sized(given: ChangedInput) -> Frame:
    agents = given.frame.agents
    factor = np.where(given.agents, given.value, 1.0)
    boxes = replace(agents, length=factor * agents.length, width=factor * agents.width)
    return replace(given.frame, agents=boxes)


def _turned(given: ChangedInput) -> Frame:
    agents, predictions = given.frame.agents, given.frame.predictions
    return replace(
        given.frame,
        agents=replace(agents, yaw=agents.yaw + given.value * given.agents),
        predictions=replace(
            predictions, yaw=predictions.yaw + given.value * given.predicted[:, None]
        ),
    )


def _slower_agents(given: ChangedInput) -> Frame:
    agents = given.frame.agents
    factor = np.where(given.agents, given.value, 1.0)
    slow = replace(agents, vx=factor * agents.vx, vy=factor * agents.vy)
    return replace(given.frame, agents=slow, predictions=given.scale_predictions(given.value))


def _old_agents(given: ChangedInput) -> Frame:
    old = given.earlier(round(given.value))
    return replace(given.frame, agents=old.agents, predictions=old.predictions)


def _restamped_agents(given: ChangedInput) -> Frame:
    """Old agents and predictions, with the times of the frame."""
    old = _old_agents(given)
    predictions = replace(old.predictions, t=old.predictions.t - old.predictions.t[0] + old.t)
    return replace(old, predictions=predictions)


def _old_predictions(given: ChangedInput) -> Frame:
    """Predictions of an earlier frame, for the agents that it had."""
    old = given.earlier(round(given.value))
    row = {name: i for i, name in enumerate(given.frame.agents.ids)}
    new_row = np.array([row.get(name, -1) for name in old.agents.ids], dtype=np.int64)
    rows = np.flatnonzero(new_row[old.predictions.agent] >= 0)
    return replace(given.frame, predictions=_rows_of(old.predictions, rows, new_row))


def _straight(given: ChangedInput) -> Frame:
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


def _likeliest(given: ChangedInput) -> Frame:
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


def _short(given: ChangedInput) -> Frame:
    predictions = given.frame.predictions
    samples = int(np.searchsorted(predictions.t, given.frame.t + given.value + 1e-6, "right"))
    columns = {name: getattr(predictions, name)[:, :samples] for name in ("x", "y", "yaw")}
    return replace(
        given.frame, predictions=replace(predictions, t=predictions.t[:samples], **columns)
    )


def _scaled_predictions(given: ChangedInput) -> Frame:
    return replace(given.frame, predictions=given.scale_predictions(given.value))


def _lights(given: ChangedInput, colours: Mapping[Colour, Colour]) -> Frame:
    """Lights of some colours with another one."""
    lights = given.frame.lights
    shown = {name: colours.get(colour, colour) for name, colour in lights.items()}
    return replace(given.frame, lights=shown)


def _old_lights(given: ChangedInput) -> Frame:
    return replace(given.frame, lights=given.earlier(round(given.value)).lights)


def _no_lights(given: ChangedInput) -> Frame:
    return replace(given.frame, lights={})


def _other_lights(given: ChangedInput) -> Frame:
    """Each light with the colour of the next one, in the order of their numbers."""
    names = sorted(given.frame.lights)
    following = dict(zip(names, [*names[1:], *names[:1]], strict=True))
    lights = {name: given.frame.lights[following[name]] for name in names}
    return replace(given.frame, lights=lights)


def _no_previous(given: ChangedInput) -> Frame:
    return replace(given.frame, previous=None)


def _ego(given: ChangedInput, **columns: float) -> Frame:
    return replace(given.frame, ego=replace(given.frame.ego, **columns))


def _slower_ego(given: ChangedInput) -> Frame:
    return _ego(given, v=given.value * given.frame.ego.v)


def _steady_ego(given: ChangedInput) -> Frame:
    return _ego(given, a=0.0)


def _turned_ego(given: ChangedInput) -> Frame:
    return _ego(given, yaw=given.frame.ego.yaw + given.value)


def _old_ego(given: ChangedInput) -> Frame:
    old = given.earlier(round(given.value)).ego
    return replace(given.frame, ego=replace(old, t=given.frame.ego.t))


def _shifted_ego(given: ChangedInput, ahead: float = 0.0, left: float = 0.0) -> Frame:
    """The ego moved by the value times (ahead, left), in its own frame."""
    ego = given.frame.ego
    c, s = given.value * cos(ego.yaw), given.value * sin(ego.yaw)
    return _ego(given, x=ego.x + c * ahead - s * left, y=ego.y + s * ahead + c * left)


def _without_goal(context: PlannerContext, value: float) -> PlannerContext:
    return replace(context, goal=None)


def _limited(context: PlannerContext, value: float) -> PlannerContext:
    road: Road = context.road
    lanes = {
        name: replace(lane, speed_limit=value * lane.speed_limit)
        for name, lane in road.lanes.items()
    }
    default = value * road.default_speed_limit
    return replace(context, road=replace(road, lanes=lanes, default_speed_limit=default))


def _wider(context: PlannerContext, value: float) -> PlannerContext:
    return replace(context, vehicle=replace(context.vehicle, width=value * context.vehicle.width))


SHARES = (0.0, 0.3, 0.6, 0.85, 1.2, 1.6)
OFFSETS_M = (-2.5, -1.0, -0.4, 0.4, 1.0, 2.5)
FRAMES = (1.0, 3.0, 6.0, 10.0, 15.0, 22.0)
RANGES_M = (2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 15.0, 20.0, 25.0, 30.0, 40.0, 50.0, 70.0)
TURNS_RAD = (-0.4, -0.1, 0.1, 0.4)
NOTHING = (1.0,)
"""The only value of a change without one."""


@dataclass(frozen=True)
class ChangeRow:
    """A row of `CHANGES`.

    Attributes:
        words: What a planner acts on, with {value} and {who}: completes "The planner acts as if".
        tries: The values that a search begins with.
        edit: Returns the changed frame; None: the change is of the context.
        unit: Unit of the value: "m", "rad", "s", "frames", "" for a share or no value.
        of_kinds: Whether it may be about some kinds of road users only.
        cause: "input", or "prediction" for a change of the predictions only.
        of_context: Returns the changed context.
        measure: Of each agent, what the value is a limit of, m; None: it is no limit.
    """

    words: str
    tries: tuple[float, ...]
    edit: Callable[[ChangedInput], Frame] | None
    unit: str = ""
    of_kinds: bool = False
    cause: str = "input"
    of_context: Callable[[PlannerContext, float], PlannerContext] | None = None
    measure: Measure | None = None

    @property
    def has_value(self) -> bool:
        """Whether the change has a value."""
        return self.tries != NOTHING

    @property
    def is_whole(self) -> bool:
        """Whether its values are whole numbers."""
        return self.unit in ("frames", "agents")


CHANGES: Mapping[str, ChangeRow] = MappingProxyType(
    {
        "delay agents": ChangeRow(
            "{who} and their predictions were {value} old", FRAMES, _old_agents, "frames"
        ),
        "delay agents restamped": ChangeRow(
            "{who} and their predictions were {value} old, stamped as new",
            FRAMES,
            _restamped_agents,
            "frames",
        ),
        "delay predictions": ChangeRow(
            "the predictions were {value} old",
            FRAMES,
            _old_predictions,
            "frames",
            cause="prediction",
        ),
        "delay ego": ChangeRow("its own state were {value} old", FRAMES, _old_ego, "frames"),
        "delay lights": ChangeRow(
            "the traffic lights were {value} old",
            FRAMES,
            _old_lights,
            "frames",
        ),
        "shift agents left": ChangeRow(
            "{who} were {value} farther to the ego's left",
            OFFSETS_M,
            partial(_shifted, left=1.0),
            "m",
            of_kinds=True,
        ),
        "shift agents ahead": ChangeRow(
            "{who} were {value} farther ahead of the ego",
            OFFSETS_M,
            partial(_shifted, ahead=1.0),
            "m",
            of_kinds=True,
        ),
        "shift agents along": ChangeRow(
            "{who} were {value} farther along their own heading",
            OFFSETS_M,
            _moved_along_agents,
            "m",
            of_kinds=True,
        ),
        "shift agents x": ChangeRow(
            "{who} were {value} farther along the world's x axis",
            OFFSETS_M,
            partial(_shifted_in_world, x=1.0),
            "m",
            of_kinds=True,
        ),
        "shift agents y": ChangeRow(
            "{who} were {value} farther along the world's y axis",
            OFFSETS_M,
            partial(_shifted_in_world, y=1.0),
            "m",
            of_kinds=True,
        ),
        "scale predictions": ChangeRow(
            "{who} were predicted to move {value} times as far",
            SHARES,
            _scaled_predictions,
            of_kinds=True,
            cause="prediction",
        ),
        "scale agents' speed": ChangeRow(
            "{who} were {value} times as fast", SHARES, _slower_agents, of_kinds=True
        ),
        "scale agents' size": ChangeRow(
            "{who} were {value} times as large", SHARES[1:], _sized, of_kinds=True
        ),
        "turn agents": ChangeRow(
            "{who} were turned by {value}", TURNS_RAD, _turned, "rad", of_kinds=True
        ),
        "drop agents beside": ChangeRow(
            "{who} more than {value} to the side of the ego were not there",
            RANGES_M,
            partial(_within, measure=_beside),
            "m",
            of_kinds=True,
            measure=_beside,
        ),
        "drop agents beyond": ChangeRow(
            "{who} farther than {value} away were not there",
            RANGES_M,
            partial(_within, measure=_away),
            "m",
            of_kinds=True,
            measure=_away,
        ),
        "drop agents near": ChangeRow(
            "{who} nearer than {value} were not there",
            RANGES_M,
            partial(_beyond, measure=_away),
            "m",
            of_kinds=True,
            measure=_away,
        ),
        "drop agents behind": ChangeRow(
            "{who} behind the ego were not there",
            NOTHING,
            partial(_kept, mask=_is_ahead),
            of_kinds=True,
        ),
        "drop agents on the left": ChangeRow(
            "{who} on the ego's left were not there",
            NOTHING,
            partial(_kept, mask=_is_right),
            of_kinds=True,
        ),
        "drop agents on the right": ChangeRow(
            "{who} on the ego's right were not there",
            NOTHING,
            partial(_kept, mask=_is_left),
            of_kinds=True,
        ),
        "drop agents that stand": ChangeRow(
            "{who} that stand were not there",
            NOTHING,
            partial(_kept, mask=_moves),
            of_kinds=True,
        ),
        "drop agents that move": ChangeRow(
            "{who} that move were not there",
            NOTHING,
            partial(_kept, mask=_stands),
            of_kinds=True,
        ),
        "drop agents": ChangeRow(
            "{who} were not there",
            NOTHING,
            partial(_kept, mask=_no_agent),
            of_kinds=True,
        ),
        "only the nearest agents": ChangeRow(
            "only the nearest {value} were there",
            (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 15.0, 20.0),
            _nearest,
            "agents",
        ),
        "straight predictions": ChangeRow(
            "all road users were predicted straight on at the present velocity",
            NOTHING,
            _straight,
            cause="prediction",
        ),
        "likeliest predictions": ChangeRow(
            "only the likeliest prediction of each road user were there",
            NOTHING,
            _likeliest,
            cause="prediction",
        ),
        "cut predictions": ChangeRow(
            "the predictions ended {value} ahead",
            (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0),
            _short,
            "s",
            cause="prediction",
        ),
        "lights green": ChangeRow(
            "every traffic light were green",
            NOTHING,
            partial(_lights, colours=dict.fromkeys(Colour, Colour.GREEN)),
        ),
        "yellow lights green": ChangeRow(
            "yellow lights were green",
            NOTHING,
            partial(_lights, colours={Colour.YELLOW: Colour.GREEN}),
        ),
        "red lights green": ChangeRow(
            "red lights were green",
            NOTHING,
            partial(_lights, colours=dict.fromkeys(RED, Colour.GREEN)),
        ),
        "lights red": ChangeRow(
            "every traffic light were red",
            NOTHING,
            partial(_lights, colours=dict.fromkeys(Colour, Colour.RED)),
        ),
        "lights gone": ChangeRow(
            "there were no traffic lights",
            NOTHING,
            _no_lights,
        ),
        "lights of others": ChangeRow(
            "each traffic light had the colour of the one with the next number",
            NOTHING,
            _other_lights,
        ),
        "scale own speed": ChangeRow(
            "its own speed were {value} times as high",
            SHARES,
            _slower_ego,
        ),
        "no own acceleration": ChangeRow("its own acceleration were 0", NOTHING, _steady_ego),
        "shift ego left": ChangeRow(
            "it were {value} farther to the left",
            OFFSETS_M,
            partial(_shifted_ego, left=1.0),
            "m",
        ),
        "shift ego ahead": ChangeRow(
            "it were {value} farther ahead",
            OFFSETS_M,
            partial(_shifted_ego, ahead=1.0),
            "m",
        ),
        "turn ego": ChangeRow(
            "it were turned by {value}",
            TURNS_RAD,
            _turned_ego,
            "rad",
        ),
        "no previous plan": ChangeRow(
            "there were no previous plan",
            NOTHING,
            _no_previous,
        ),
        "no goal": ChangeRow(
            "there were no goal",
            NOTHING,
            None,
            of_context=_without_goal,
        ),
        "scale speed limits": ChangeRow(
            "the speed limits were {value} times as high", SHARES[1:], None, of_context=_limited
        ),
        "scale own width": ChangeRow(
            "it were {value} times as wide", SHARES[1:], None, of_context=_wider
        ),
    }
)
"""All changes by name. A minus in a value is the other side: right, back."""

EVERYBODY: frozenset[AgentKind] = frozenset()


@dataclass(frozen=True)
class InputChange:
    """One change: its name in `CHANGES`, its value, and the kinds that it is about; none: all."""

    name: str
    value: float = 1.0
    kinds: frozenset[AgentKind] = EVERYBODY

    @property
    def row(self) -> ChangeRow:
        """Its row of the table."""
        return CHANGES[self.name]

    def __str__(self) -> str:
        """The text that `parse` reads."""
        value = f" {self.value:g}" if self.row.has_value else ""
        kinds = ", ".join(kind.value for kind in AgentKind if kind in self.kinds)
        return f"{self.name}{value}" + (f" of {kinds}" if kinds else "")

    def sentence(self, period_s: float = 0.1) -> str:
        """What the planner acts on; `period_s`: time between two frames, s."""
        value = f"{self.value:g}" + (f" {self.row.unit}" if self.row.unit else "")
        if self.row.unit == "frames":
            count = round(self.value)
            value = f"{count} frame{'s' * (count != 1)} ({period_s * count:.3g} s)"
        kinds = [f"each {kind.value}" for kind in AgentKind if kind in self.kinds]
        return self.row.words.format(value=value, who=" and ".join(kinds) or "all road users")


def parse(text: str) -> InputChange:
    """A change from its text; ConfigError if it is none."""
    head, _, kinds = text.strip().partition(" of ")
    if head in CHANGES or text.strip() in CHANGES:  # "lights of others"
        name, value = (text.strip(), "") if text.strip() in CHANGES else (head, "")
        kinds = "" if name == text.strip() else kinds
    else:
        name, _, value = head.rpartition(" ")
    if name not in CHANGES:
        raise unknown_name("change of the input", name or head, list(CHANGES))
    row = CHANGES[name]
    try:
        number = float(value) if value else 1.0
    except ValueError:
        raise ConfigError(f"change of the input '{text}': '{value}' is no number") from None
    names = [kind.strip() for kind in kinds.split(",") if kind.strip()]
    unknown = [name for name in names if name not in {kind.value for kind in AgentKind}]
    if unknown:
        raise unknown_name("kind of road users", unknown[0], [kind.value for kind in AgentKind])
    chosen = frozenset(map(AgentKind, names))
    if bool(value) is not row.has_value:
        example = f"{name} {row.tries[0]:g}" if row.has_value else name
        raise ConfigError(f"change of the input '{text}': write it as '{example}'")
    if chosen and not row.of_kinds:
        raise ConfigError(f"change of the input '{text}': it is about all road users")
    return InputChange(name, number, chosen)


class ChangedFrames(Sequence[Frame]):
    """The frames of a drive with a change; each is made when it is asked for."""

    def __init__(self, frames: Sequence[Frame], change: InputChange) -> None:
        self._frames, self._change = frames, change
        self._made: dict[int, Frame] = {}

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> Frame:  # type: ignore[override]
        if index not in self._made:
            self._made[index] = self._make(index)
        return self._made[index]

    def _make(self, index: int) -> Frame:
        edit = self._change.row.edit
        if edit is None:
            return self._frames[index]
        frame = edit(self.input_at(index))
        snapshots = ChangedSnapshots(self, index, frame.earlier.snapshots)
        return replace(frame, earlier=replace(frame.earlier, snapshots=snapshots))

    def input_at(self, index: int) -> ChangedInput:
        """What the edit of a frame gets."""
        frame, kinds = self._frames[index], self._change.kinds
        about = [not kinds or kind in kinds for kind in frame.agents.kinds]
        return ChangedInput(
            frame,
            lambda count: self._frames[max(0, index - count)],
            self._change.value,
            np.array(about, dtype=np.bool_),
        )


class ChangedSnapshots(Sequence[Snapshot]):
    """What was shown before a changed frame, changed likewise, if a planner asks for its past.

    Args:
        frames: The changed frames.
        index: The frame.
        given: What was shown before it, unchanged; the last ones are those of the frames before.
    """

    def __init__(self, frames: ChangedFrames, index: int, given: Sequence[Snapshot]) -> None:
        self._frames, self._given = frames, given
        self._first = index - len(given)

    def __len__(self) -> int:
        return len(self._given)

    def __getitem__(self, index: int) -> Snapshot:  # type: ignore[override]
        place = self._first + range(len(self))[index]
        return self._frames[place].snapshot if place >= 0 else self._given[index]


def limits_that_fit(drives: Sequence[Sequence[Frame]], change: InputChange) -> tuple[float, float]:
    """The interval of values that change the frames of some drives as the value of `change` does,
    m; NaN if its value is no limit.
    """
    measure = change.row.measure
    if measure is None:
        return nan, nan
    low, high = 0.0, inf
    for frames in drives:
        inputs = ChangedFrames(frames, change)
        for index in range(len(frames)):
            of_frame = inputs.input_at(index)
            values = measure(of_frame)[of_frame.agents]
            low = max(low, float(values[values <= change.value].max(initial=0.0)))
            high = min(high, float(values[values > change.value].min(initial=inf)))
    return low, high


def changed(frames: Sequence[Frame], changes: Sequence[InputChange]) -> Sequence[Frame]:
    """The frames of a drive, in order of time, with changes, one after the other."""
    for change in changes:
        frames = ChangedFrames(frames, change)
    return frames


def changed_context(context: PlannerContext, changes: Sequence[InputChange]) -> PlannerContext:
    """The context with the changes that are of the context."""
    for change in changes:
        if change.row.of_context is not None:
            context = change.row.of_context(context, change.value)
    return context
