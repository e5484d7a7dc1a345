"""A scenario with everything in it, and the same one repaired."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from replan.logs.agents import AgentKind
from replan.logs.repair.detections import Detections, Repair, TrackChange
from replan.logs.road import Goal, Lane, Road
from replan.logs.rules import Colour, Crosswalk, StopLine, TrafficLight
from replan.logs.scenario import Scenario
from replan.logs.states import Controls, Trajectory
from replan.logs.tracks import Tracks
from replan.logs.vehicle import VehicleParameters

START_NS = 1_700_000_000_123_456_789


def seconds(ns: Iterable[int]) -> np.ndarray:
    return np.array(list(ns), dtype=np.int64) / 1e9


def rich_scenario(n: int = 30) -> Scenario:
    """Everything that a log can hold: ragged tracks on their own clocks, an obstacle, lanes, rules,
    goal, controls.
    """
    t = seconds(100_000_000 * k for k in range(n))
    ego = Trajectory(
        t=t,
        x=8.0 * t,
        y=np.sin(t),
        yaw=0.1 * np.cos(t),
        v=8.0 + 0.1 * t,
        a=np.full(n, 0.1),
        kappa=0.01 * np.sin(t),
    )
    own = seconds(33_333_333 * k + 7 for k in range(2 * n))
    zero, own_unknown = np.zeros(n), np.full(2 * n, np.nan)
    tracks = Tracks(
        ids=("car 1", "post", "walker"),
        kinds=(AgentKind.CAR, AgentKind.OBJECT, AgentKind.PEDESTRIAN),
        length=np.array([4.5, 0.3, 0.5]),
        width=np.array([1.8, 0.3, 0.6]),
        static=np.array([False, True, False]),
        offsets=np.array([0, n, n + 1, 3 * n + 1]),
        t=np.r_[t, 0.0, own],
        x=np.r_[20.0 + 5.0 * t, 40.0, np.full(2 * n, 30.0)],
        y=np.r_[zero, -4.0, own - 3.0],
        yaw=np.r_[zero, 0.3, np.full(2 * n, 1.5)],
        vx=np.r_[np.full(n, 5.0), 0.0, own_unknown],
        vy=np.r_[zero, 0.0, own_unknown],
    )
    x = np.linspace(-20.0, 200.0, 12)
    one = Lane(
        id=3,
        left=np.c_[x, 0 * x + 1.75],
        right=np.c_[x, 0 * x - 1.75],
        successors=(5,),
        left_neighbour=4,
        right_neighbour=None,
        left_opposite=True,
        speed_limit=13.9,
        left_crossable=False,
        kind="urban",
    )
    two = Lane(
        id=5,
        left=np.c_[x + 220, 0 * x + 2],
        right=np.c_[x + 220, 0 * x - 2],
        right_neighbour=9,
        drivable=False,
        yields_to=(3, 8),
    )
    stop = StopLine(
        id=1, lane=3, points=np.array([[200.0, 1.75], [200.0, -1.75]]), light=12, towards=(5,)
    )
    signed = StopLine(id=2, lane=5, points=np.array([[400.0, 2.0], [400.0, -2.0]]), must_stop=True)
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
        regions=(np.array([[100.0, -2.0], [110.0, -2.0], [110.0, 2.0]]),),
        t=(1.0, 20.0),
        v=(0.0, 9.0),
        yaw=(-0.1, 0.1),
    )
    controls = Controls(t=t, steer=0.02 * t, throttle=np.where(t > 1.0, np.nan, 0.2), brake=0.0 * t)
    return Scenario(
        name="paper/rich",
        ego=ego,
        tracks=tracks,
        road=road,
        duration=float(t[-1]) + 0.3,
        goal=goal,
        vehicle=VehicleParameters(length=4.9, width=1.9),
        controls=controls,
        tags=("urban", "recorded"),
        source="somewhere",
        licence="CC-BY-4.0",
        origin=(691000.5, 5336000.25),
        start_ns=START_NS,
        metadata={"seed": "7"},
        notes=("A note.",),
        lights=lights,
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
        t=t,
        frames=frames,
        ids=tuple(str(k % 2) for k in range(len(t))),
        codes=np.arange(len(t)) % 7,
        x=20.0 + 5.0 * t,
        y=0.01 * t,
        yaw=0.1 * t,
        length=4.0 + half,
        width=1.8 + half,
        vx=unknown,
        vy=unknown,
        score=half + 0.1,
    )
    removed = Tracks(
        ids=("x9",),
        kinds=(AgentKind.OBJECT,),
        length=np.ones(1),
        width=np.ones(1),
        static=np.zeros(1, np.bool_),
        offsets=np.array([0, 2]),
        t=frames[3:5],
        x=np.array([1.0, 2.0]),
        y=np.zeros(2),
        yaw=np.zeros(2),
        vx=np.full(2, np.nan),
        vy=np.full(2, np.nan),
    )
    extended = np.zeros(len(scenario.tracks.t), np.bool_)
    extended[:4] = True
    changes = (
        TrackChange(
            what="joined",
            agent="car 1",
            begin=0.0,
            end=2.0,
            samples=21,
            why="One car.",
            sources=("0", "1"),
        ),
        TrackChange(
            what="removed",
            agent="x9",
            begin=0.1,
            end=0.2,
            samples=2,
            why="It was seen for 0.1 s only.",
        ),
    )
    return replace(
        scenario,
        repair=Repair(
            detections=found,
            removed=removed,
            extended=extended,
            changes=changes,
            tracks=scenario.tracks,
        ),
    )
