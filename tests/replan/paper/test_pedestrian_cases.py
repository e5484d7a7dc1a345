"""The nine cases of pedestrians who cross, in closed loop with constant-velocity prediction: what
must hold of each.

Every scenario is a family of the catalogue with other parameters; of the log only the first ego
state is taken, since a careful driver cannot avoid every one. A walker is IN THE WAY while his box
is within the ego's width and `MARGIN_M` on each side, and the rear bumper has not passed him. A
CONFLICT lasts while somebody is in the way or walks towards it, and `RELEASE_S` longer, but not
into the next; those who are in the way together are one conflict. The laws:

contact         a collision that a point mass avoids by keeping its speed or by braking hard: (1)
                and (2) of `pedestrian_grid`, with no time to react; by the case's parameters, and
                in a later conflict from the state in which it began
creep           while somebody stands on the lane ahead: once the ego rests it does not move by more
                than `CREEP_M`, and below `SLOW_MPS` it covers no more than `ROLL_M`, a stop with
                0.25 m/s2
oscillation     the acceleration that the pedals command, where it is beyond +-`DEAD_BAND_MPS2`,
                changes its sign no more than `CHANGES` times per conflict: braking and driving on
                again are two changes if the ego was accelerating before. The brake that holds a
                standstill counts as braking
late release    the brake that was pressed while somebody was in the way is still pressed
                `RELEASE_S` after the last is out of it for good, as in `pedestrian_grid`
both pedals     throttle and brake are pressed together
no goal         the drive ends neither at its goal nor in a collision
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest

from replan.logs.agents import AgentKind
from replan.logs.catalogue import CATALOGUE
from replan.logs.catalogue.family_parts import HALF_LANE
from replan.logs.scenario import Scenario
from replan.logs.trace import EndReason, Trace
from replan.paper.pedestrian_grid import RELEASE_S, GridCrossing, braked, braking_intervals
from replan.planners.dp_qp.speed.qp import SpeedQpConfig
from replan.planners.frenet.st_boundaries import StGraphConfig
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop_config import LoopConfig

LOOP = LoopConfig(prediction="constant_velocity", traffic="time")
TOUCHED = (EndReason.COLLISION, EndReason.REPLAY_CONTACT)
PAPER = "paper/crossing_pedestrian"
MARGIN_M = StGraphConfig().vulnerable_margin_m
STANDING_MPS, MOVING_MPS = 0.05, 1e-3
RESTING_MPS, SLOW_MPS = 0.01, 0.5
CREEP_M, ROLL_M = 0.1, 0.5
DEAD_BAND_MPS2 = 0.3
CHANGES = 2


@dataclass(frozen=True)
class Case:
    """One drive: the row of the table, the family, what it changes of it."""

    row: str
    family: str
    changed: tuple[tuple[str, float], ...] = ()

    @property
    def scenario(self) -> Scenario:
        """Its log holds the first ego state only."""
        family = CATALOGUE[self.family]
        built = family.build({**family.parameters, **dict(self.changed)})
        return replace(
            built, name=str(self), ego=built.ego.between(0.0, 0.0), tags=("synthetic", *family.tags)
        )

    def __str__(self) -> str:
        return " ".join([self.row, *(f"{name}={value:.3g}" for name, value in self.changed)])


def varied(row: str, family: str, **values: tuple[float, ...]) -> list[Case]:
    """All combinations of parameter values."""
    return [
        Case(row, family, tuple(zip(values, one, strict=True))) for one in product(*values.values())
    ]


def crossings(
    row: str, ego_kmh: tuple[float, ...], walker: tuple[float, ...], late: tuple[float, ...]
) -> list[Case]:
    """The paper's crossing by when the walker is in the middle of the lane, as in
    `pedestrian_grid`.
    """
    cells = (GridCrossing(*one) for one in product(ego_kmh, walker, late))
    return [Case(row, PAPER, tuple(cell.parameters.items())) for cell in cells]


@dataclass(frozen=True, eq=False)
class Walk:
    """A walker at times `(n,)`: box centre, half extents along and across the lane, speed, velocity
    across.
    """

    x: np.ndarray
    y: np.ndarray
    half_x: np.ndarray
    half_y: np.ndarray
    speed: np.ndarray
    vy: np.ndarray

    def within(self, half_width: float) -> np.ndarray:
        """Where the box reaches into the strip of this half width around the middle of the lane."""
        return np.asarray(np.abs(self.y) - self.half_y < half_width)


def walks(scenario: Scenario, t: np.ndarray) -> list[Walk]:
    """The walkers of a scenario as they were."""
    found, tracks = [], scenario.tracks
    for i in range(len(tracks)):
        if tracks.kinds[i] is AgentKind.PEDESTRIAN:
            own, length, width = tracks.samples(i), tracks.length[i], tracks.width[i]
            x, y, yaw, vx, vy = (
                np.interp(t, tracks.t[own], column[own])
                for column in (tracks.x, tracks.y, tracks.yaw, tracks.vx, tracks.vy)
            )
            c, s = np.abs(np.cos(yaw)), np.abs(np.sin(yaw))
            half_x, half_y = 0.5 * (length * c + width * s), 0.5 * (length * s + width * c)
            found.append(Walk(x, y, half_x, half_y, np.hypot(vx, vy), vy))
    return found


def meets_nobody(scenario: Scenario, t: np.ndarray, rear_axle: np.ndarray) -> bool:
    """Whether an ego with its rear axle at these stations of the lane `(n,)` at times `(n,)`
    overlaps no walker.
    """
    front, rear = (
        rear_axle + scenario.vehicle.axle_to_front,
        rear_axle - scenario.vehicle.rear_overhang,
    )
    return not any(
        (
            one.within(0.5 * scenario.vehicle.width)
            & (front > one.x - one.half_x)
            & (rear < one.x + one.half_x)
        ).any()
        for one in walks(scenario, t)
    )


def sets_off(scenario: Scenario) -> float:
    """When the first walker sets off onto the lane, s."""
    told = scenario.metadata.get("pedestrian_sets_off_s")
    return float(told) if told is not None else CATALOGUE[PAPER].parameters["walk_start_s"]


def helps(scenario: Scenario, t: float, x: float, v: float) -> bool:
    """Whether keeping the speed `v`, or hard braking from `t` on, meets nobody.

    The rear axle is at `x`.
    """
    car, u = scenario.vehicle, np.arange(0.0, scenario.duration - t, 0.02)
    dead = car.brake_delay + car.brake_lag
    slowed = [
        v * min(one, dead) + braked(max(one - dead, 0.0), v, SpeedQpConfig().emergency) for one in u
    ]
    return any(meets_nobody(scenario, t + u, x + np.asarray(way)) for way in (v * u, slowed))


@dataclass(frozen=True, eq=False)
class Judged:
    """A drive and what the laws are about."""

    scenario: Scenario
    trace: Trace

    @property
    def t(self) -> np.ndarray:
        return self.trace.ego.t

    def ahead(self) -> list[tuple[Walk, np.ndarray]]:
        """Each walker, and where the ego's rear bumper has not passed him."""
        rear = self.trace.ego.x - self.scenario.vehicle.rear_overhang
        return [(one, rear < one.x + one.half_x) for one in walks(self.scenario, self.t)]

    def in_the_way(self) -> np.ndarray:
        """Where somebody is in the way."""
        strip = 0.5 * self.scenario.vehicle.width + MARGIN_M
        return np.any([one.within(strip) & there for one, there in self.ahead()], axis=0)

    def conflicts(self) -> list[tuple[int, int]]:
        """First and one-past-last index of each conflict."""
        strip, came = 0.5 * self.scenario.vehicle.width + MARGIN_M, []
        for one, there in self.ahead():
            inside = one.within(strip)
            for first, end in runs(
                there & (inside | ((one.y * one.vy < 0.0) & (one.speed > MOVING_MPS)))
            ):
                came.append((first, first + int(np.argmax(inside[first:end])), end))
        joined: list[tuple[int, int]] = []
        for first, enters, end in sorted(came):
            if joined and enters < joined[-1][1]:
                joined[-1] = joined[-1][0], max(joined[-1][1], end)
            else:
                joined.append((first, end))
        after = [*(first for first, _ in joined), len(self.t)][1:]
        ends = [int(np.searchsorted(self.t, self.t[end - 1] + RELEASE_S)) for _, end in joined]
        return [
            (first, min(end, last))
            for (first, _), end, last in zip(joined, ends, after, strict=True)
        ]

    def avoidable(self) -> bool:
        """Whether keeping the speed or braking hard helps, in the last conflict.

        In a first one by the parameters: an ego that kept its speed until he set off. In a later
        one, of which nobody knew, from the state in which it began.
        """
        ego, off, conflicts = self.scenario.ego.state(0), sets_off(self.scenario), self.conflicts()
        if len(conflicts) == 1:
            return helps(self.scenario, off, ego.x + ego.v * off, ego.v)
        began = conflicts[-1][0]
        return helps(
            self.scenario, *(float(v[began]) for v in (self.t, self.trace.ego.x, self.trace.ego.v))
        )

    def changes(self) -> tuple[int, int]:
        """How often the commanded acceleration changes its sign during conflicts, and how often it
        may.
        """
        commands, car, v = self.trace.commands, self.scenario.vehicle, self.trace.ego.v
        assert commands is not None
        asked = (
            commands.throttle * car.max_accel
            - commands.brake * car.max_decel
            - car.rolling
            - car.drag * v**2
        )
        plain = np.flatnonzero(np.abs(asked) > DEAD_BAND_MPS2)
        changed = plain[1:][np.sign(asked[plain[1:]]) != np.sign(asked[plain[:-1]])]
        conflicts = self.conflicts()
        within = sum(int(((changed >= first) & (changed < end)).sum()) for first, end in conflicts)
        return within, CHANGES * len(conflicts)

    def stands(self) -> list[tuple[int, int]]:
        """Begins and ends of the times in which somebody stands on the lane before the ego."""
        front = self.trace.ego.x + self.scenario.vehicle.axle_to_front
        each = [
            one.within(HALF_LANE) & (one.speed < STANDING_MPS) & (front < one.x + one.half_x)
            for one in walks(self.scenario, self.t)
        ]
        return runs(np.any(each, axis=0))

    def crept(self) -> tuple[float, float]:
        """The farthest that the ego moved after it rested, and that it moved slowly, while somebody
        stood, m.
        """
        ego, farthest, slowly = self.trace.ego, 0.0, 0.0
        for first, end in self.stands():
            x, v = ego.x[first:end], ego.v[first:end]
            rests = np.flatnonzero(v < RESTING_MPS)
            farthest = max(farthest, float(x[-1] - x[rests[0]]) if len(rests) else 0.0)
            slowly = max(slowly, float(np.diff(x)[v[1:] < SLOW_MPS].sum()))
        return farthest, slowly

    def rested(self) -> bool:
        """Whether the ego rested while somebody stood on the lane."""
        return any(
            (self.trace.ego.v[first:end] < RESTING_MPS).any() for first, end in self.stands()
        )

    def released(self) -> float:
        """How long after the way was clear the brake was released, s.

        Not positive where it was not pressed then.
        """
        taken = np.flatnonzero(self.in_the_way())
        if not len(taken):
            return 0.0
        clear = float(self.t[min(taken[-1] + 1, len(self.t) - 1)])
        before = [end for begin, end in braking_intervals(self.trace) if begin < clear]
        return max(before, default=clear) - clear


def runs(on: np.ndarray) -> list[tuple[int, int]]:
    """First and one-past-last index of each run of True."""
    edges = np.flatnonzero(np.diff(np.r_[False, on, False].astype(int)))
    return [(int(first), int(end)) for first, end in zip(edges[::2], edges[1::2], strict=True)]


def judged(case: Case, loop: LoopConfig = LOOP, planner: str = "dp_qp") -> Judged:
    """The closed loop of a case."""
    scenario = case.scenario
    return Judged(scenario, run_closed_loop(scenario, planner, config=loop).trace)


def broken(drive: Judged) -> list[str]:
    """The laws of the module docstring that a drive breaks."""
    commands, end = drive.trace.commands, drive.trace.end
    assert commands is not None
    farthest, slowly = drive.crept()
    changes, allowed = drive.changes()
    laws = {
        "contact": end in TOUCHED and drive.avoidable(),
        "creep": farthest > CREEP_M or slowly > ROLL_M,
        "oscillation": changes > allowed,
        "late release": drive.released() > RELEASE_S,
        "both pedals": bool((np.minimum(commands.throttle, commands.brake) > 0.0).any()),
        "no goal": end not in (EndReason.GOAL, *TOUCHED),
    }
    return [law for law, is_broken in laws.items() if is_broken]


EGO = (36.0,)
TURNS_BACK, HESITATES, RUNS_OUT, JAYWALKER, GROUP, ALONG, BOTH_SIDES = (
    f"pedestrian/{name}"
    for name in ("turns_back", "hesitates", "runs_out", "jaywalker", "group", "along", "both_sides")
)
NINE = (
    *crossings("PD-1", EGO, (0.8, 1.4, 2.2), (-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0)),
    *varied(
        "PD-2", PAPER, ego_speed_mps=(8.33, 10.0, 11.1), pedestrian_speed_mps=(0.75, 0.85, 1.0)
    ),
    *varied(
        "PD-3",
        TURNS_BACK,
        distance_m=(16.0, 33.0),
        dwell_s=(1.0, 2.5, 4.0),
        stop_lateral_m=(-0.5, 0.0, 0.5),
        return_speed_mps=(1.2, 1.8),
    ),
    *varied(
        "PD-4",
        HESITATES,
        ego_speed_mps=(8.3, 10.0),
        distance_m=(5.0, 15.0, 20.0, 25.0, 30.0),
        dwell_s=(1.0, 2.0, 3.0),
    ),
    *varied(
        "PD-5",
        RUNS_OUT,
        ego_speed_mps=(5.6, 8.3, 11.1, 13.9),
        distance_m=(10.0, 15.0, 20.0, 25.6, 30.0, 40.0),
    ),
    *varied(
        "PD-6",
        JAYWALKER,
        angle_deg=(30.0, 45.0, 60.0, 120.0, 135.0, 150.0),
        distance_m=(15.0, 20.0, 25.0, 30.0, 40.0),
    ),
    *varied(
        "PD-7", GROUP, pedestrian_speed_mps=(0.8, 1.2, 1.6), distance_m=(15.0, 20.0, 25.0, 31.0)
    ),
    *varied(
        "PD-8", ALONG, ego_speed_mps=(5.6, 10.0, 13.9), lateral_m=(-0.4, 0.0), leave_s=(7.0, 13.0)
    ),
    *varied(
        "PD-9",
        BOTH_SIDES,
        left_start_s=(1.5, 3.0, 4.5, 6.0, 8.0),
        distance_m=(15.0, 20.0, 25.0, 31.0, 40.0),
    ),
)
"""The rows of the table; PD-1 and PD-2 are the paper's crossing."""
FAST = (
    *crossings("PD-1", EGO, (1.4,), (-1.0, 1.0)),
    *varied("PD-2", PAPER, ego_speed_mps=(10.0,), pedestrian_speed_mps=(0.85, 1.0)),
    *varied(
        "PD-3",
        TURNS_BACK,
        distance_m=(16.0, 33.0),
        dwell_s=(4.0,),
        stop_lateral_m=(0.5,),
        return_speed_mps=(1.2,),
    ),
    *varied("PD-4", HESITATES, ego_speed_mps=(10.0,), distance_m=(5.0,), dwell_s=(2.0,)),
    *varied("PD-5", RUNS_OUT, ego_speed_mps=(8.3,), distance_m=(15.0, 25.6)),
    *varied("PD-6", JAYWALKER, angle_deg=(45.0, 135.0), distance_m=(30.0,)),
    *varied("PD-7", GROUP, pedestrian_speed_mps=(1.2,), distance_m=(31.0,)),
    *varied("PD-8", ALONG, ego_speed_mps=(10.0,), lateral_m=(0.0,), leave_s=(7.0,)),
    *varied("PD-9", BOTH_SIDES, left_start_s=(3.0, 4.5), distance_m=(31.0,)),
)


@pytest.mark.parametrize("case", FAST, ids=str)
def test_the_laws_hold(case: Case) -> None:
    assert broken(judged(case)) == []


@pytest.mark.slow
@pytest.mark.parametrize("case", [case for case in NINE if case not in FAST], ids=str)
def test_the_laws_hold_over_the_table(case: Case) -> None:
    assert broken(judged(case)) == []


# the laws can fail, and find what they are about


STANDS = Case("PD-3", "pedestrian/turns_back", (("distance_m", 16.0), ("dwell_s", 4.0)))


@pytest.fixture(scope="module")
def waited() -> Judged:
    return judged(STANDS)


def test_the_ego_waits_for_a_pedestrian_who_turns_back(waited: Judged) -> None:
    """The ego rests while he stands, and so the law of creeping says something."""
    ((first, end),) = waited.stands()
    assert waited.t[end] - waited.t[first] == pytest.approx(4.0, abs=0.3)
    assert (waited.trace.ego.v[first:end] < RESTING_MPS).sum() > 100
    assert len(waited.conflicts()) == 1 and broken(waited) == []


def test_creeping_is_found(waited: Judged) -> None:
    ((first, end),) = waited.stands()
    rests = waited.t[first + int(np.argmax(waited.trace.ego.v[first:end] < RESTING_MPS))]
    crept = waited.trace.ego.x + 0.05 * np.clip(waited.t - rests, 0.0, 4.0)
    assert broken(
        replace(waited, trace=replace(waited.trace, ego=replace(waited.trace.ego, x=crept)))
    ) == ["creep"]


def test_oscillating_both_pedals_and_a_late_release_are_found(waited: Judged) -> None:
    commands, t = waited.trace.commands, waited.t
    assert commands is not None
    first, end = waited.conflicts()[0]
    now = (t >= t[first] + 1.0) & (t < t[first] + 3.0)
    brake = np.where(now, 0.2 * (np.sin(2.0 * np.pi * t) > 0.0), commands.brake)
    throttle = np.where(now, 0.4 * (np.sin(2.0 * np.pi * t) <= 0.0), commands.throttle)

    def found(**changed: np.ndarray) -> list[str]:
        return broken(
            replace(waited, trace=replace(waited.trace, commands=replace(commands, **changed)))
        )

    assert found(brake=brake, throttle=throttle) == ["oscillation"]
    assert found(throttle=np.maximum(commands.throttle, 0.01 * (commands.brake > 0.0))) == [
        "both pedals"
    ]
    long = t < t[end - 1] + 0.2  # conflicts last RELEASE_S longer than somebody is in the way
    held = np.where(long, np.maximum(commands.brake, 0.01 * (t > t[first])), commands.brake)
    assert "late release" in found(brake=held, throttle=np.where(long, 0.0, commands.throttle))


def test_an_ego_that_does_not_brake_meets_the_walker() -> None:
    for family in (name for name in CATALOGUE if name.startswith("pedestrian/")):
        drive = judged(Case("", family), planner="constant_speed")
        assert broken(drive) == ["contact"], family


def test_conflicts_are_counted() -> None:
    """He who comes to the kerb is one, and he who then crosses another; a group is one."""
    for case, count in (
        (Case("PD-4", "pedestrian/hesitates"), 2),
        (Case("PD-7", "pedestrian/group"), 1),
        (Case("PD-9", "pedestrian/both_sides", (("left_start_s", 8.0),)), 2),
    ):
        assert len(judged(case, planner="idm").conflicts()) == count, str(case)


@pytest.mark.parametrize("walker", [0.85, 1.0])
def test_the_papers_crossing_is_comfortable(walker: float) -> None:
    """Row PD-2: about 4 s of braking with at most 3 m/s2, and 2 m from who is before the ego."""
    drive = judged(Case("PD-2", PAPER, (("pedestrian_speed_mps", walker),)))
    ego, car = drive.trace.ego, drive.scenario.vehicle
    ((one, there),) = drive.ahead()
    gap = one.x - one.half_x - ego.x - car.axle_to_front
    assert gap[one.within(0.5 * car.width) & there].min() >= 2.0
    assert ego.a.min() >= -3.1
    assert 3.0 <= sum(end - begin for begin, end in braking_intervals(drive.trace)) <= 5.0


@pytest.mark.parametrize("changed", [{}, {"distance_m": 15.0}])
def test_with_a_sensor_the_child_is_not_seen_before_it_runs_out(changed: dict[str, float]) -> None:
    """It is behind the small car until 4.5 s.

    The ego has slowed down before, and nobody is touched.
    """
    drive = judged(
        Case("PD-5", "pedestrian/runs_out", tuple(changed.items())),
        replace(LOOP, perception="sensor"),
    )
    seen = next(frame.t for frame in drive.trace.frames if "child" in frame.agents)
    assert seen > 4.0
    assert np.interp(seen, drive.t, drive.trace.ego.v) < 0.8 * drive.trace.ego.v[0]
    assert drive.trace.end is EndReason.GOAL
