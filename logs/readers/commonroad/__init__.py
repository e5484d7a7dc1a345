"""CommonRoad scenarios, XML of 2018b and 2020a: `document` parses the file, this module makes the
Scenario.

The ego is one of these:

(1) `ego="ID"`: that vehicle of the traffic; its goal is where its log ends.
(2) A planning problem whose recorded driver is in the file: an obstacle that is at the problem's
    start position at its start step; or, as the MONA files number them, obstacle `problem - 90000`
    whose log begins at the start position with the start speed (some of these files give the step
    as 0: then the obstacle's own step counts).
(3) Else a problem of which only the start is known.

t = 0 is the ego's first sample. The log lasts to the last moment at which the goal may be reached,
without such a time to the traffic's last sample, and never less than the ego's log. Traffic may end
earlier (`Scenario.traffic`).
"""

from __future__ import annotations

from dataclasses import replace
from math import cos, isnan, sin
from pathlib import Path
from typing import NamedTuple

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.errors import LogError
from replan.logs.agents import AgentKind
from replan.logs.kind_words import kind_of_word
from replan.logs.observed import Spans, inferred
from replan.logs.readers.base import Reader
from replan.logs.readers.commonroad.document import parse
from replan.logs.readers.commonroad.document_records import Document, Obstacle, PlanningProblem
from replan.logs.readers.commonroad.lanelet_stop_lines import lights_of
from replan.logs.readers.commonroad.lanelets import road_of, with_rules
from replan.logs.readers.commonroad.tracks import (
    ego_log,
    sized,
    tracks_of,
    trimmed,
    turned,
    velocities,
)
from replan.logs.road import Goal, Road
from replan.logs.scenario import CENTRE, EGO_POSE, Scenario
from replan.logs.states import Trajectory
from replan.logs.vehicle import VehicleParameters

SAME_PLACE_M = 0.05
MONA_PROBLEM_OFFSET = 90_000
SHORT_S = 3.0
"""If the recorded drive is shorter, a note names the other planning problems, s."""
LAST_PLACE_M = 4.0
"""Half the length of the rectangle about the ego's last box centre that stands for a goal, and its
whole width.
"""
_CANNOT_DRIVE = (AgentKind.PEDESTRIAN, AgentKind.OBJECT)
_SOURCES = (
    ("ngsim", "recorded", ("ngsim", "next generation simulation")),
    ("mona", "recorded", ("mona",)),
    ("highd", "recorded", ("highd", "ind dataset", "round", "exid")),
    ("interaction", "recorded", ("interaction dataset",)),
    ("sumo", "synthetic", ("sumo", "scenario factory", "ots")),
    ("synthesised", "synthetic", ("specification-based", "synthesis")),
    ("hand_made", "synthetic", ("hand-crafted", "bing maps", "scenario designer", "xosc")),
)


class _Ego(NamedTuple):
    """The ego: its obstacle (None: only the start is known), its problem (None: the user chose an
    obstacle).
    """

    obstacle: Obstacle | None
    problem: PlanningProblem | None
    notes: tuple[str, ...] = ()


def read_commonroad(
    path: str | Path, *, problem: int | None = None, ego: str | None = None
) -> Scenario:
    """Read a CommonRoad scenario (module docstring); LogError if there is none, or no such problem
    or vehicle.

    `problem` is the id of the planning problem, or its place in the file, from 1 (default: the
    first); `ego` the id of the obstacle to take as ego instead.
    """
    path = Path(path)
    document, headings = turned(parse(path))
    try:
        if ego is None:
            chosen = _by_problem(document, problem)
        else:  # (1)
            can = [o for o in document.obstacles if not o.static and len(o.states) > 1]
            can = [
                o for o in can if (kind_of_word(o.type) or AgentKind.OBJECT) not in _CANNOT_DRIVE
            ]
            obstacle = next((o for o in can if str(o.id) == ego), None)
            if obstacle is None:
                longest = sorted(can, key=lambda o: -len(o.states))[:8]
                remedy = f"longest drives: {', '.join(str(o.id) for o in longest) or 'none'}"
                text = f"no vehicle {ego} with a trajectory in the file"
                raise LogError(text, topic=f"obstacle {ego}", remedy=remedy)
            note = "the ego was taken from the traffic: its goal is the place where its log ends"
            chosen = _Ego(obstacle, None, (note,))
        scenario = _scenario(document, chosen)
    except (LogError, ValueError) as error:
        raise (error if isinstance(error, LogError) else LogError(str(error))).at(path) from error
    notes, lasts = [*document.notes, *headings, *scenario.notes], scenario.ego.t[-1]
    if problem is None and ego is None and len(scenario.ego) > 1 and lasts < SHORT_S:
        others = [(p.id, _by_problem(document, p.id).obstacle) for p in document.problems[1:]]
        longer = [
            f"{i} ({len(o.states) * document.dt:.1f} s)"
            for i, o in others
            if o is not None and len(o.states) > 1
        ]
        if longer:
            notes.append(
                f"the recorded drive lasts {lasts:.1f} s only; other planning problems: "
                f"{', '.join(longer)}"
            )
    name = path.name.removesuffix(".xml") + (f"_ego{ego}" if ego is not None else "")
    if problem is not None and chosen.problem is not None:
        name += f"_problem{chosen.problem.id}"
    return replace(scenario, name=name, notes=tuple(notes))


def _by_problem(document: Document, number: int | None) -> _Ego:
    problems = document.problems
    if not problems:
        raise LogError(
            "no planning problem",
            topic="planningProblem",
            remedy="name a vehicle of the traffic as ego",
        )
    by_id = {p.id: p for p in reversed(problems)}
    by_place = dict(enumerate(problems, start=1))
    if number is not None and number not in by_id and number not in by_place:
        ids = ", ".join(str(p.id) for p in problems)
        raise LogError(
            f"no planning problem {number}", topic="planningProblem", remedy=f"the file has {ids}"
        )
    problem = problems[0] if number is None else by_id.get(number) or by_place[number]
    step, x, y = problem.start[:3]
    for o in document.obstacles:
        rows = np.flatnonzero(np.abs(o.states[:, 0] - step) < 0.5)
        if (
            not o.static
            and len(rows)
            and len(o.states) - rows[0] > 1
            and _is_near(o.states[rows[0]], x, y)
        ):
            return _Ego(replace(o, states=o.states[rows[0] :]), problem)
    for o in document.obstacles:
        first = o.states[0]
        same = o.id == problem.id - MONA_PROBLEM_OFFSET and abs(first[4] - problem.start[4]) < 0.1
        if same and _is_near(first, x, y) and not o.static and len(o.states) > 1:
            late = (first[0] - step) * document.dt
            note = (
                f"the problem starts at step {step:g}, its recorded driver {late:.1f} s later: "
                "taken"
            )
            return _Ego(o, problem, (note,))
    if any(not o.static and _is_near(o.states[0], x, y) for o in document.obstacles):
        return _Ego(None, problem, ("a vehicle of the traffic appears later where the ego starts",))
    return _Ego(None, problem)


def _is_near(state: FloatArray, x: float, y: float) -> bool:
    return bool(np.hypot(state[1] - x, state[2] - y) <= SAME_PLACE_M)


def _scenario(document: Document, chosen: _Ego) -> Scenario:
    """Everything but name and the file's own notes."""
    notes = list(chosen.notes)
    obstacle, vehicle = chosen.obstacle, VehicleParameters()
    if obstacle is not None:
        obstacle, cut = trimmed(obstacle, document.dt)
        vehicle, first = sized(obstacle), obstacle.states[0]
        notes += cut
    else:
        assert chosen.problem is not None
        first = chosen.problem.start
    start, origin = float(first[0]), (float(round(first[1])), float(round(first[2])))
    velocity, rule = velocities(document)
    without = None if obstacle is None else obstacle.id
    known = [o.states[o.states[:, 0] <= start] for o in document.obstacles if not o.static]
    driven_before = np.array([states[-1, [1, 2, 4]] for states in known if len(states)]).reshape(
        -1, 3
    )
    driven_before = driven_before[np.isfinite(driven_before).all(axis=1)]
    tracks = tracks_of(document, velocity, without, start, origin)
    road, assumed = road_of(document, origin, driven_before, chosen.problem)
    road, chains, ruled = with_rules(document, road, origin)
    driven, how = _drive(chosen, obstacle, document.dt, vehicle, origin)
    goal, unknown = _goal(chosen.problem, road, start, document.dt, origin)
    if goal is None and len(driven) > 1:
        unknown = tuple(f"{note}: the end of the recorded drive is taken" for note in unknown)
        last, half = driven.state(len(driven) - 1), LAST_PLACE_M
        along, left = (
            np.array([cos(last.yaw), sin(last.yaw)]),
            np.array([-sin(last.yaw), cos(last.yaw)]),
        )
        center = np.array([last.x, last.y]) + vehicle.axle_to_center * along
        ends = ((1, 1), (-1, 1), (-1, -1), (1, -1))
        goal = Goal(
            (np.array([center + i * half * along + j * 0.5 * half * left for i, j in ends]),)
        )
    notes += [*how, *unknown, *assumed, *ruled, *rule]
    drive, end = float(driven.t[-1]), float(tracks.t.max(initial=0.0))
    duration = max(drive, end if goal is None or goal.t is None else goal.t[1])
    moving = len(tracks) and not tracks.static.all()
    if goal is not None and goal.t is not None and moving and duration > end + 1.0:
        notes.append(
            f"the traffic ends at {end:.1f} s, the goal may be reached until {duration:.1f} s"
        )
    if start:
        notes.append(f"the log begins {start * document.dt:.1f} s after the file's first step")
    traffic: Spans = tuple(
        (0.0, end) for _, end in inferred(tracks.offsets, tracks.static, tracks.t)
    )
    if all(obstacle.static or obstacle.id == without for obstacle in document.obstacles):
        traffic = ((0.0, duration),)
    tags, metadata = _labels(document, chosen)
    return Scenario(
        name="",
        ego=driven,
        tracks=tracks,
        road=road,
        duration=duration,
        goal=goal,
        vehicle=vehicle,
        tags=tags,
        source=f"CommonRoad {document.benchmark} ({document.source or 'source not named'})",
        licence="see the file's publisher",
        origin=origin,
        start_ns=round(start * document.dt * 1e9),
        metadata=metadata,
        notes=tuple(notes),
        lights=lights_of(document, chains, start, duration),
        traffic=traffic,
    )


def _drive(
    chosen: _Ego,
    obstacle: Obstacle | None,
    dt: float,
    vehicle: VehicleParameters,
    origin: tuple[float, float],
) -> tuple[Trajectory, tuple[str, ...]]:
    """The ego log at the rear axle, or its only known state; `obstacle` is that of `chosen`,
    trimmed.
    """
    if obstacle is not None:
        driven, notes = ego_log(obstacle, dt, vehicle, origin)
        size = f"{vehicle.length:.2f} x {vehicle.width:.2f} m"
        return driven, (
            f"the ego is obstacle {obstacle.id} ({size}, axles in proportion to the length)",
            *notes,
        )
    problem = chosen.problem
    assert problem is not None
    _, x, y, yaw, v, a = (float(value) for value in problem.start)
    x, y = (
        x - origin[0] - vehicle.axle_to_center * cos(yaw),
        y - origin[1] - vehicle.axle_to_center * sin(yaw),
    )
    kappa = problem.yaw_rate / v if v > 1.0 and not isnan(problem.yaw_rate) else 0.0
    kappa = min(max(kappa, -vehicle.max_kappa), vehicle.max_kappa)
    columns = (0.0, x, y, yaw, v, 0.0 if isnan(a) else a, kappa)
    note = (
        f"only the start of the ego is known (planning problem {problem.id}): no drive to "
        "compare with"
    )
    return Trajectory(*(np.array([value]) for value in columns)), (note,)


def _goal(
    problem: PlanningProblem | None,
    road: Road,
    start: float,
    dt: float,
    origin: tuple[float, float],
) -> tuple[Goal | None, tuple[str, ...]]:
    """The problem's goal: any of its goal states, each with its own bounds."""
    if problem is None:
        return None, ()
    if not problem.goals:
        return None, ("the planning problem names no goal",)
    lost = [i for goal in problem.goals for i in goal.lanelets if i not in road.lanes]
    notes = [f"goal lanelets {', '.join(map(str, lost))} are not in the road"] if lost else []
    goals = []
    for state in problem.goals:
        regions = [region - origin for region in state.regions]
        regions += [road.lanes[i].polygon for i in state.lanelets if i in road.lanes]
        t = (
            None
            if state.step is None
            else ((state.step[0] - start) * dt, (state.step[1] - start) * dt)
        )
        if regions or not state.lanelets:
            goals.append(Goal(tuple(regions), t, state.v, state.yaw))
    if not goals:
        return None, tuple(notes)
    if len(problem.goals) > 1:
        notes.append(
            f"the problem has {len(problem.goals)} goals: any of them counts, each with its own "
            "bounds"
        )
    return Goal.any_of(goals), tuple(notes)


def _labels(document: Document, chosen: _Ego) -> tuple[tuple[str, ...], dict[str, str]]:
    """The tags: "commonroad", the kind of source where it is known, and the file's own.

    And the metadata.
    """
    text = f"{document.source} {document.benchmark}".lower()
    simulated = ("synthetic",) if "simulated" in document.tags else ()
    words = next(
        ((how, name) for name, how, signs in _SOURCES if any(sign in text for sign in signs)),
        simulated,
    )
    metadata = {
        "format": f"CommonRoad {document.version}",
        "benchmark": document.benchmark,
        "dataset": "CommonRoad",
        "family": document.benchmark.partition("_T-")[0].rpartition("_")[0] or document.benchmark,
        "author": document.author,
        "affiliation": document.affiliation,
        "time_step_s": f"{document.dt:g}",
        EGO_POSE: CENTRE,
    }
    if chosen.problem is not None:
        metadata["planning_problem"] = str(chosen.problem.id)
    if chosen.obstacle is not None:
        metadata["ego_obstacle"] = str(chosen.obstacle.id)
    return tuple(dict.fromkeys(("commonroad", *words, *document.tags))), metadata


def _claims(path: Path) -> bool:
    if path.suffix.lower() != ".xml" or not path.is_file():
        return False
    try:
        with path.open("rb") as stream:
            return b"<commonRoad" in stream.read(4096)
    except OSError:
        return True  # reading it says why it cannot be read


READER = Reader(
    "commonroad",
    "CommonRoad scenarios, 2018b and 2020a",
    "CommonRoad *.xml",
    (".xml",),
    _claims,
    lambda path, settings: read_commonroad(
        path, ego=settings.ego or None, problem=settings.problem or None
    ),
    settings=("ego", "problem"),
)
