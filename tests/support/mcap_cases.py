"""Scenarios for the tests of logs in MCAP: one with everything in it, random ones, and files
written by hand.
"""

import json
from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer

from replan.logs.agents import AgentKind
from replan.logs.repair.detections import Detections, Repair, TrackChange
from replan.logs.road import Goal, Lane, Road
from replan.logs.rules import Colour, Crosswalk, StopLine, TrafficLight
from replan.logs.scenario import Scenario
from replan.logs.states import Controls, Trajectory
from replan.logs.tracks import Tracks
from replan.logs.vehicle import VehicleParameters

START_NS = 1_700_000_000_123_456_789
RECORD = {"replan.scenario": {"format_version": "1", "name": "by hand"}}
STATE = {"x_m": 1.0, "y_m": 2.0, "yaw_rad": 0.1, "v_mps": 3.0, "a_mps2": 0.0, "kappa_per_m": 0.0}
TABLE = {"id": ["a"], "kind": ["car"], "length_m": [4.0], "width_m": [2.0], "static": [False]}


def seconds(ns: Iterable[int]) -> np.ndarray:
    return np.array(list(ns), dtype=np.int64) / 1e9


def rich_scenario(n: int = 30) -> Scenario:
    """Everything that a log can hold: ragged tracks on their own clocks, an obstacle, lanes, rules,
    goal, controls.
    """
    t = seconds(100_000_000 * k for k in range(n))
    ego = Trajectory(
        t, 8.0 * t, np.sin(t), 0.1 * np.cos(t), 8.0 + 0.1 * t, 0.1 + 0.0 * t, 0.01 * np.sin(t)
    )
    own = seconds(33_333_333 * k + 7 for k in range(2 * n))
    tracks = Tracks(
        ("car 1", "post", "walker"),
        (AgentKind.CAR, AgentKind.OBJECT, AgentKind.PEDESTRIAN),
        np.array([4.5, 0.3, 0.5]),
        np.array([1.8, 0.3, 0.6]),
        np.array([False, True, False]),
        np.array([0, n, n + 1, 3 * n + 1]),
        np.r_[t, 0.0, own],
        np.r_[20.0 + 5.0 * t, 40.0, 30.0 + 0.0 * own],
        np.r_[0.0 * t, -4.0, own - 3.0],
        np.r_[0.0 * t, 0.3, 1.5 + 0.0 * own],
        np.r_[5.0 + 0.0 * t, 0.0, np.nan + 0.0 * own],
        np.r_[0.0 * t, 0.0, np.nan + 0.0 * own],
    )
    x = np.linspace(-20.0, 200.0, 12)
    one = Lane(
        3,
        np.c_[x, 0 * x + 1.75],
        np.c_[x, 0 * x - 1.75],
        (5,),
        4,
        None,
        True,
        13.9,
        left_crossable=False,
        kind="urban",
    )
    two = Lane(
        5,
        np.c_[x + 220, 0 * x + 2],
        np.c_[x + 220, 0 * x - 2],
        right_neighbour=9,
        drivable=False,
        yields_to=(3, 8),
    )
    stop = StopLine(1, 3, np.array([[200.0, 1.75], [200.0, -1.75]]), light=12, towards=(5,))
    signed = StopLine(2, 5, np.array([[400.0, 2.0], [400.0, -2.0]]), must_stop=True)
    zebra = Crosswalk(7, np.array([[202.0, -2.0], [205.0, -2.0], [205.0, 2.0], [202.0, 2.0]]))
    late = TrafficLight(4, np.array([0.1]), (Colour.OFF,))
    lights = (
        late,
        TrafficLight(12, np.array([-0.1, 0.1, 0.2]), (Colour.GREEN, Colour.YELLOW, Colour.RED)),
    )
    road = Road(
        {3: one, 5: two},
        default_speed_limit=11.0,
        drives_on_right=False,
        stop_lines=(stop, signed),
        crosswalks=(zebra,),
    )
    goal = Goal(
        (np.array([[100.0, -2.0], [110.0, -2.0], [110.0, 2.0]]),),
        (1.0, 20.0),
        (0.0, 9.0),
        (-0.1, 0.1),
    )
    controls = Controls(t, 0.02 * t, np.where(t > 1.0, np.nan, 0.2), 0.0 * t)
    return Scenario(
        "paper/rich",
        ego,
        tracks,
        road,
        float(t[-1]) + 0.3,
        goal,
        VehicleParameters(length=4.9, width=1.9),
        controls,
        ("urban", "recorded"),
        "somewhere",
        "CC-BY-4.0",
        (691000.5, 5336000.25),
        START_NS,
        {"seed": "7"},
        ("A note.",),
        lights,
    )


def repaired_scenario() -> Scenario:
    """The rich one, as if its tracks were made of detections: frames without boxes, a removed
    track, marks, changes.
    """
    scenario = rich_scenario()
    n = len(scenario.ego)
    frames = seconds(100_000_000 * k - 300_000_000 for k in range(n + 3))
    t = np.repeat(frames[2:-1], 2)
    unknown = np.full(len(t), np.nan)
    half = np.where(np.arange(len(t)) % 2 == 0, 0.2, np.nan)
    found = Detections(
        t,
        frames,
        tuple(str(k % 2) for k in range(len(t))),
        np.arange(len(t)) % 7,
        20.0 + 5.0 * t,
        0.01 * t,
        0.1 * t,
        4.0 + half,
        1.8 + half,
        unknown,
        unknown,
        half + 0.1,
    )
    removed = Tracks(
        ("x9",),
        (AgentKind.OBJECT,),
        np.ones(1),
        np.ones(1),
        np.zeros(1, np.bool_),
        np.array([0, 2]),
        frames[3:5],
        np.array([1.0, 2.0]),
        np.zeros(2),
        np.zeros(2),
        np.full(2, np.nan),
        np.full(2, np.nan),
    )
    extended = np.zeros(len(scenario.tracks.t), np.bool_)
    extended[:4] = True
    changes = (
        TrackChange("joined", "car 1", 0.0, 2.0, 21, "One car.", ("0", "1")),
        TrackChange("removed", "x9", 0.1, 0.2, 2, "It was seen for 0.1 s only."),
    )
    return replace(scenario, repair=Repair(found, removed, extended, changes, scenario.tracks))


def differences(one: object, two: object, where: str = "scenario") -> list[str]:
    """Where two nouns differ, to the bit; NaN equals NaN."""
    if isinstance(one, np.ndarray):
        same = isinstance(two, np.ndarray) and (one.dtype, one.shape, one.tobytes()) == (
            two.dtype,
            two.shape,
            two.tobytes(),
        )
        return [] if same else [where]
    if isinstance(one, Mapping):
        if not isinstance(two, Mapping) or list(one) != list(two):
            return [where]
        return [d for key in one for d in differences(one[key], two[key], f"{where}[{key!r}]")]
    if isinstance(one, tuple):
        if not isinstance(two, tuple) or len(one) != len(two):
            return [where]
        return [
            d
            for i, (a, b) in enumerate(zip(one, two, strict=True))
            for d in differences(a, b, f"{where}[{i}]")
        ]
    if hasattr(one, "__dataclass_fields__"):
        if type(one) is not type(two):
            return [where]
        names = [f.name for f in fields(one)]  # type: ignore[arg-type]
        return [
            d for n in names for d in differences(getattr(one, n), getattr(two, n), f"{where}.{n}")
        ]
    return [] if one == two or (one != one and two != two) else [where]


def write_by_hand(
    path: Path,
    messages: Iterable[tuple[str, int, Any]],
    records: Mapping[str, Mapping[str, str]] = RECORD,
    compression: CompressionType = CompressionType.ZSTD,
) -> Path:
    """A log as somebody else would write it: (topic, log time, JSON value or raw bytes)."""
    with path.open("wb") as file:
        writer: Any = Writer(file, compression=compression)
        writer.start()
        for name, record in records.items():
            writer.add_metadata(name, dict(record))
        channels: dict[str, int] = {}
        for topic, time, value in messages:
            if topic not in channels:
                schema = writer.register_schema(
                    f"by.hand{topic}", "jsonschema", b'{"type":"object"}'
                )
                channels[topic] = writer.register_channel(topic, "json", schema)
            payload = value if isinstance(value, bytes) else json.dumps(value).encode()
            writer.add_message(channels[topic], time, payload, time)
        writer.finish()
    return path


def ego_states(n: int = 5, **changes: Any) -> list[tuple[str, int, Any]]:
    return [("/ego", 100_000_000 * k, {**STATE, "x_m": 3.0 * k, **changes}) for k in range(n)]


# Random scenarios

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
        tuple(draw(st.lists(words, min_size=n, max_size=n, unique=True))),
        tuple(draw(st.lists(st.sampled_from(AgentKind), min_size=n, max_size=n))),
        columns(draw, n, positive),
        columns(draw, n, positive),
        np.array(draw(st.lists(st.booleans(), min_size=n, max_size=n))),
        np.r_[0, np.cumsum(counts)],
        np.concatenate([draw(times(count)) for count in counts]),
        columns(draw, m, number),
        columns(draw, m, number),
        columns(draw, m, st.floats(-3.0, 3.0)),
        columns(draw, m, velocity),
        columns(draw, m, velocity),
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
    return Repair(draw(detections()), draw(all_tracks()), marks, made, tracks)


@st.composite
def lanes(draw: st.DrawFn, ident: int) -> Lane:
    n = draw(st.integers(2, 4))
    link = st.one_of(st.none(), st.integers(-5, 5))
    return Lane(
        ident,
        columns(draw, 2 * n, number).reshape(n, 2),
        columns(draw, 2 * n, number).reshape(n, 2),
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
        draw(st.integers(-(2**40), 2**40)),
        draw(st.sampled_from(across)),
        columns(draw, 4, number).reshape(2, 2),
        draw(st.sampled_from([None, *obeyed])),
        draw(st.booleans()),
        tuple(draw(st.lists(st.integers(-5, 5), max_size=2))),
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
        draw(words),
        ego,
        tracks,
        draw(roads([light.id for light in shown])),
        float(ego.t[-1]) + draw(st.floats(0.0, 10.0)),
        draw(st.one_of(st.none(), goal)),
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
