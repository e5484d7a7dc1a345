"""Random scenarios, and all that they consist of."""

from typing import Any

import numpy as np
from hypothesis import strategies as st
from rich_scenario import START_NS, seconds

from replan.logs.agents import AgentKind
from replan.logs.repair.detections import Detections, Repair, TrackChange
from replan.logs.road import Goal, Lane, Road
from replan.logs.rules import Colour, Crosswalk, StopLine, TrafficLight
from replan.logs.scenario import Scenario
from replan.logs.states import Controls, Trajectory
from replan.logs.tracks import Tracks

number = st.floats(-1e6, 1e6)
positive = st.floats(0.01, 100.0)
words = st.text(st.characters(codec="utf-8"), max_size=12)


@st.composite
def times(draw: st.DrawFn, count: int) -> np.ndarray:
    steps = draw(st.lists(st.integers(1, 2_000_000_000), min_size=count, max_size=count))
    return seconds(np.cumsum(steps) - steps[0])


def columns(draw: st.DrawFn, count: int, elements: st.SearchStrategy[float]) -> np.ndarray:
    return np.array(draw(st.lists(elements, min_size=count, max_size=count)), dtype=np.float64)


@st.composite
def all_tracks(draw: st.DrawFn) -> Tracks:
    counts = draw(st.lists(st.integers(1, 4), max_size=4))
    if not counts:
        return Tracks.empty()
    n, m = len(counts), sum(counts)
    velocity = st.one_of(number, st.just(float("nan")))
    return Tracks(
        ids=tuple(draw(st.lists(words, min_size=n, max_size=n, unique=True))),
        kinds=tuple(draw(st.lists(st.sampled_from(AgentKind), min_size=n, max_size=n))),
        length=columns(draw, n, positive),
        width=columns(draw, n, positive),
        static=np.array(draw(st.lists(st.booleans(), min_size=n, max_size=n))),
        offsets=np.r_[0, np.cumsum(counts)],
        t=np.concatenate([draw(times(count)) for count in counts]),
        x=columns(draw, m, number),
        y=columns(draw, m, number),
        yaw=columns(draw, m, st.floats(-3.0, 3.0)),
        vx=columns(draw, m, velocity),
        vy=columns(draw, m, velocity),
    )


@st.composite
def detections(draw: st.DrawFn) -> Detections:
    frames = draw(times(draw(st.integers(1, 4))))
    counts = draw(st.lists(st.integers(0, 3), min_size=len(frames), max_size=len(frames)))
    m, unknown = sum(counts), st.just(float("nan"))
    measured = [
        columns(draw, m, st.one_of(each, unknown))
        for each in (positive, positive, number, number, positive)
    ]
    return Detections(
        np.repeat(frames, counts),
        frames,
        tuple(draw(st.lists(words, min_size=m, max_size=m))),
        columns(draw, m, st.integers(0, 6)).astype(np.int64),
        columns(draw, m, number),
        columns(draw, m, number),
        columns(draw, m, st.floats(-3.0, 3.0)),
        *measured,
    )


@st.composite
def repairs(draw: st.DrawFn, tracks: Tracks) -> Repair:
    text, when = st.text("abc.", max_size=5), st.floats(-10.0, 10.0)
    change = st.builds(
        TrackChange,
        text,
        text,
        when,
        when,
        st.integers(0, 9),
        text,
        st.lists(words, max_size=2).map(tuple),
    )
    marks = np.array(
        draw(st.lists(st.booleans(), min_size=len(tracks.t), max_size=len(tracks.t))), np.bool_
    )
    made = tuple(draw(st.lists(change, max_size=3)))
    return Repair(
        detections=draw(detections()),
        removed=draw(all_tracks()),
        extended=marks,
        changes=made,
        tracks=tracks,
    )


@st.composite
def lanes(draw: st.DrawFn, ident: int) -> Lane:
    n = draw(st.integers(2, 4))
    link = st.one_of(st.none(), st.integers(-5, 5))
    return Lane(
        id=ident,
        left=columns(draw, 2 * n, number).reshape(n, 2),
        right=columns(draw, 2 * n, number).reshape(n, 2),
        successors=tuple(draw(st.lists(st.integers(-5, 5), max_size=3))),
        left_neighbour=draw(link),
        right_neighbour=draw(link),
        left_opposite=draw(st.booleans()),
        right_opposite=draw(st.booleans()),
        speed_limit=draw(st.one_of(st.just(float("nan")), positive)),
        drivable=draw(st.booleans()),
        left_crossable=draw(st.booleans()),
        right_crossable=draw(st.booleans()),
        kind=draw(words),
        yields_to=tuple(draw(st.lists(st.integers(-5, 5), max_size=3))),
    )


@st.composite
def lights(draw: st.DrawFn) -> TrafficLight:
    t = draw(times(draw(st.integers(1, 4))))
    colours = draw(st.lists(st.sampled_from(Colour), min_size=len(t), max_size=len(t)))
    # On a nanosecond, as the times of logs are
    later = np.rint(1e9 * (t + draw(st.integers(0, 3)))) / 1e9
    return TrafficLight(draw(st.integers(-(2**40), 2**40)), later, tuple(colours))


@st.composite
def stop_lines(draw: st.DrawFn, across: list[int], obeyed: list[int]) -> StopLine:
    return StopLine(
        id=draw(st.integers(-(2**40), 2**40)),
        lane=draw(st.sampled_from(across)),
        points=columns(draw, 4, number).reshape(2, 2),
        light=draw(st.sampled_from([None, *obeyed])),
        must_stop=draw(st.booleans()),
        towards=tuple(draw(st.lists(st.integers(-5, 5), max_size=2))),
    )


@st.composite
def crosswalks(draw: st.DrawFn) -> Crosswalk:
    corners = draw(st.integers(3, 5))
    return Crosswalk(
        draw(st.integers(-(2**40), 2**40)), columns(draw, 2 * corners, number).reshape(corners, 2)
    )


def distinct(elements: st.SearchStrategy[Any]) -> st.SearchStrategy[tuple[Any, ...]]:
    return st.lists(elements, max_size=3, unique_by=lambda item: item.id).map(tuple)


@st.composite
def roads(draw: st.DrawFn, obeyed: list[int]) -> Road:
    ids = draw(st.lists(st.integers(-(2**40), 2**40), min_size=1, max_size=3, unique=True))
    return Road(
        {i: draw(lanes(i)) for i in ids},
        default_speed_limit=draw(positive),
        drives_on_right=draw(st.booleans()),
        stop_lines=draw(distinct(stop_lines(ids, obeyed))),
        crosswalks=draw(distinct(crosswalks())),
    )


@st.composite
def scenarios(draw: st.DrawFn) -> Scenario:
    n = draw(st.integers(1, 5))
    ego = Trajectory(
        draw(times(n)),
        *(columns(draw, n, number) for _ in range(2)),
        columns(draw, n, st.floats(-3, 3)),
        *(columns(draw, n, number) for _ in range(3)),
    )
    interval = st.one_of(st.none(), st.tuples(number, number))
    triangle = st.builds(
        lambda values: np.array(values).reshape(3, 2), st.lists(number, min_size=6, max_size=6)
    )
    goal = st.builds(Goal, st.lists(triangle, max_size=2).map(tuple), interval, interval, interval)
    goal = st.one_of(
        goal, st.builds(Goal, alternatives=st.lists(goal, min_size=1, max_size=3).map(tuple))
    )
    pedal = st.one_of(st.just(float("nan")), st.floats(0, 1))
    k = draw(st.integers(1, 3))
    controls = Controls(draw(times(k)), *(columns(draw, k, pedal) for _ in range(3)))
    shown = draw(distinct(lights()))
    tracks = draw(all_tracks())
    raw, repair = draw(st.sampled_from(((False, False), (True, False), (False, True))))
    return Scenario(
        name=draw(words),
        ego=ego,
        tracks=tracks,
        road=draw(roads([light.id for light in shown])),
        duration=float(ego.t[-1]) + draw(st.floats(0.0, 10.0)),
        goal=draw(st.one_of(st.none(), goal)),
        controls=draw(st.sampled_from((None, controls))),
        tags=tuple(draw(st.lists(words, max_size=2))),
        origin=(draw(number), draw(number)),
        start_ns=draw(st.sampled_from((0, START_NS))),
        metadata=draw(st.dictionaries(words, words, max_size=2)),
        notes=tuple(draw(st.lists(words, max_size=2))),
        lights=shown,
        detections=draw(detections()) if raw else None,
        repair=draw(repairs(tracks)) if repair else None,
    )
