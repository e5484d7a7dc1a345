"""Changes of a planner's input: hypotheses about what a planner is fed, as rows of one table.

    change = parse("delay agents 11")
    frames = changed(frames, [change])             # a planner that gets these acts on old agents

A change is a name of `CHANGES`, a value in the unit of its row, and, where the row says so, the
kinds of road users that it is about: "shift agents left 1.5 of pedestrian, bicycle". The edits are
those of `input_edits`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType

from replan.core.errors import ConfigError, unknown_name
from replan.explain import input_edits as edits
from replan.explain.input_edits import ChangedInput, Measure
from replan.logs.agents import AgentKind
from replan.logs.frame import Frame, PlannerContext
from replan.logs.rules import RED, Colour

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
            "{who} and their predictions were {value} old", FRAMES, edits.old_agents, "frames"
        ),
        "delay agents restamped": ChangeRow(
            "{who} and their predictions were {value} old, stamped as new",
            FRAMES,
            edits.restamped_agents,
            "frames",
        ),
        "delay predictions": ChangeRow(
            "the predictions were {value} old",
            FRAMES,
            edits.old_predictions,
            "frames",
            cause="prediction",
        ),
        "delay ego": ChangeRow("its own state were {value} old", FRAMES, edits.old_ego, "frames"),
        "delay lights": ChangeRow(
            "the traffic lights were {value} old",
            FRAMES,
            edits.old_lights,
            "frames",
        ),
        "shift agents left": ChangeRow(
            "{who} were {value} farther to the ego's left",
            OFFSETS_M,
            partial(edits.shifted, left=1.0),
            "m",
            of_kinds=True,
        ),
        "shift agents ahead": ChangeRow(
            "{who} were {value} farther ahead of the ego",
            OFFSETS_M,
            partial(edits.shifted, ahead=1.0),
            "m",
            of_kinds=True,
        ),
        "shift agents along": ChangeRow(
            "{who} were {value} farther along their own heading",
            OFFSETS_M,
            edits.moved_along_agents,
            "m",
            of_kinds=True,
        ),
        "shift agents x": ChangeRow(
            "{who} were {value} farther along the world's x axis",
            OFFSETS_M,
            partial(edits.shifted_in_world, x=1.0),
            "m",
            of_kinds=True,
        ),
        "shift agents y": ChangeRow(
            "{who} were {value} farther along the world's y axis",
            OFFSETS_M,
            partial(edits.shifted_in_world, y=1.0),
            "m",
            of_kinds=True,
        ),
        "scale predictions": ChangeRow(
            "{who} were predicted to move {value} times as far",
            SHARES,
            edits.scaled_predictions,
            of_kinds=True,
            cause="prediction",
        ),
        "scale agents' speed": ChangeRow(
            "{who} were {value} times as fast", SHARES, edits.slower_agents, of_kinds=True
        ),
        "scale agents' size": ChangeRow(
            "{who} were {value} times as large", SHARES[1:], edits.sized, of_kinds=True
        ),
        "turn agents": ChangeRow(
            "{who} were turned by {value}", TURNS_RAD, edits.turned, "rad", of_kinds=True
        ),
        "drop agents beside": ChangeRow(
            "{who} more than {value} to the side of the ego were not there",
            RANGES_M,
            partial(edits.within, measure=edits.beside),
            "m",
            of_kinds=True,
            measure=edits.beside,
        ),
        "drop agents beyond": ChangeRow(
            "{who} farther than {value} away were not there",
            RANGES_M,
            partial(edits.within, measure=edits.away),
            "m",
            of_kinds=True,
            measure=edits.away,
        ),
        "drop agents near": ChangeRow(
            "{who} nearer than {value} were not there",
            RANGES_M,
            partial(edits.beyond, measure=edits.away),
            "m",
            of_kinds=True,
            measure=edits.away,
        ),
        "drop agents behind": ChangeRow(
            "{who} behind the ego were not there",
            NOTHING,
            partial(edits.kept, mask=edits.is_ahead),
            of_kinds=True,
        ),
        "drop agents on the left": ChangeRow(
            "{who} on the ego's left were not there",
            NOTHING,
            partial(edits.kept, mask=edits.is_right),
            of_kinds=True,
        ),
        "drop agents on the right": ChangeRow(
            "{who} on the ego's right were not there",
            NOTHING,
            partial(edits.kept, mask=edits.is_left),
            of_kinds=True,
        ),
        "drop agents that stand": ChangeRow(
            "{who} that stand were not there",
            NOTHING,
            partial(edits.kept, mask=edits.moves),
            of_kinds=True,
        ),
        "drop agents that move": ChangeRow(
            "{who} that move were not there",
            NOTHING,
            partial(edits.kept, mask=edits.stands),
            of_kinds=True,
        ),
        "drop agents": ChangeRow(
            "{who} were not there",
            NOTHING,
            partial(edits.kept, mask=edits.no_agent),
            of_kinds=True,
        ),
        "only the nearest agents": ChangeRow(
            "only the nearest {value} were there",
            (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 15.0, 20.0),
            edits.only_nearest,
            "agents",
        ),
        "straight predictions": ChangeRow(
            "all road users were predicted straight on at the present velocity",
            NOTHING,
            edits.straight_on,
            cause="prediction",
        ),
        "likeliest predictions": ChangeRow(
            "only the likeliest prediction of each road user were there",
            NOTHING,
            edits.only_likeliest,
            cause="prediction",
        ),
        "cut predictions": ChangeRow(
            "the predictions ended {value} ahead",
            (0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0),
            edits.short,
            "s",
            cause="prediction",
        ),
        "lights green": ChangeRow(
            "every traffic light were green",
            NOTHING,
            partial(edits.recoloured_lights, colours=dict.fromkeys(Colour, Colour.GREEN)),
        ),
        "yellow lights green": ChangeRow(
            "yellow lights were green",
            NOTHING,
            partial(edits.recoloured_lights, colours={Colour.YELLOW: Colour.GREEN}),
        ),
        "red lights green": ChangeRow(
            "red lights were green",
            NOTHING,
            partial(edits.recoloured_lights, colours=dict.fromkeys(RED, Colour.GREEN)),
        ),
        "lights red": ChangeRow(
            "every traffic light were red",
            NOTHING,
            partial(edits.recoloured_lights, colours=dict.fromkeys(Colour, Colour.RED)),
        ),
        "lights gone": ChangeRow(
            "there were no traffic lights",
            NOTHING,
            edits.no_lights,
        ),
        "lights of others": ChangeRow(
            "each traffic light had the colour of the one with the next number",
            NOTHING,
            edits.other_lights,
        ),
        "scale own speed": ChangeRow(
            "its own speed were {value} times as high",
            SHARES,
            edits.slower_ego,
        ),
        "no own acceleration": ChangeRow("its own acceleration were 0", NOTHING, edits.steady_ego),
        "shift ego left": ChangeRow(
            "it were {value} farther to the left",
            OFFSETS_M,
            partial(edits.shifted_ego, left=1.0),
            "m",
        ),
        "shift ego ahead": ChangeRow(
            "it were {value} farther ahead",
            OFFSETS_M,
            partial(edits.shifted_ego, ahead=1.0),
            "m",
        ),
        "turn ego": ChangeRow(
            "it were turned by {value}",
            TURNS_RAD,
            edits.turned_ego,
            "rad",
        ),
        "no previous plan": ChangeRow(
            "there were no previous plan",
            NOTHING,
            edits.no_previous,
        ),
        "no goal": ChangeRow(
            "there were no goal",
            NOTHING,
            None,
            of_context=edits.without_goal,
        ),
        "scale speed limits": ChangeRow(
            "the speed limits were {value} times as high",
            SHARES[1:],
            None,
            of_context=edits.limited,
        ),
        "scale own width": ChangeRow(
            "it were {value} times as wide", SHARES[1:], None, of_context=edits.wider
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
