"""Events of who drives: take-overs by a person, and times at which the stack drives again."""

from __future__ import annotations

from collections.abc import Iterable

from replan.logs.driving import EPISODE_S, LASTS_S, STOOD_S, Takeover, TakeoverKind, takeovers
from replan.metrics.metric import Unavailable
from replan.mine.driven_log import DrivenLog, Event, EventKind

UNSAID = Unavailable("the log does not say who drove")


def _found(log: DrivenLog) -> list[Takeover] | Unavailable:
    scenario = log.scenario
    if scenario.driving is None:
        return UNSAID
    return takeovers(scenario.driving, scenario.ego, scenario.controls)[0]


def _takeover(log: DrivenLog) -> Iterable[Event] | Unavailable:
    events = _found(log)
    if isinstance(events, Unavailable):
        return events
    ego = log.scenario.ego
    return [
        Event(event.t, event.changed, float(ego.at(event.t).v), what=_described(event))
        for event in events
    ]


def _handback(log: DrivenLog) -> Iterable[Event] | Unavailable:
    events = _found(log)
    if isinstance(events, Unavailable):
        return events
    ego = log.scenario.ego
    return [
        Event(event.until, event.until, float(ego.at(event.until).v))
        for event in events
        if event.until < ego.t[-1]
    ]


def _described(event: Takeover) -> str:
    axis = "" if event.axis == "both" else f", {event.axis} only"
    pressed = f", {event.input}" if event.input else ""
    kind = "" if event.kind is TakeoverKind.DRIVER else f"{event.kind.value}, "
    return f"{kind}episode {event.episode}{axis}{pressed}"


HANDOVERS = (
    EventKind(
        name="takeover",
        find=_takeover,
        meaning=(
            f"A person drives an axis that the stack drove, for {LASTS_S} s or more. From the "
            "driver's first input within 1 s before the mode's change, else from the change less "
            f"the source's latency, to the change; `what` says if it is planned (the car stood for "
            f"{STOOD_S:g} s before) or the stack gave up, the episode (take-overs within "
            f"{EPISODE_S:g} s are one), the axis, and the pedal."
        ),
        measures="speed",
        unit="m/s",
    ),
    EventKind(
        name="handback",
        find=_handback,
        meaning="The stack drives an axis again that a person had taken over.",
        measures="speed",
        unit="m/s",
    ),
)
