"""Planners that a judge must catch, each bad in one way, and the table of which gate catches which.

They may be run as any planner: `replan evaluate -p adversaries:Park` from the folder of this file.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from drives import along, grid, moving, scenario, straight_road

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind
from replan.logs.catalogue import CATALOGUE
from replan.logs.frame import Frame, PlannerContext, Predictions
from replan.logs.plan import Plan
from replan.logs.reference_line import ReferenceLine
from replan.logs.road import Road
from replan.logs.rules import Colour, StopLine
from replan.logs.scenario import Scenario
from replan.logs.states import EgoState, Trajectory
from replan.planners.constant_speed import arc
from replan.planners.frenet.scene import RouteTracker
from replan.planners.idm import Idm, IdmConfig
from replan.replay.loop.plan_check import of_positions

STEPS = 0.1 * np.arange(81)


class Along:
    """Follows the reference line at a speed and an offset of its own and does not look."""

    accel, brake = 2.0, 2.5

    def __init__(self, context: PlannerContext) -> None:
        self._tracker, self._start = RouteTracker(context), context.start

    def speed(self, t: float) -> float:
        """The speed wished for at a time, m/s."""
        return self._start.v

    def offset(self, t: FloatArray) -> FloatArray:
        """The offset wished for, m."""
        return np.zeros(len(t))

    def plan(self, frame: Frame) -> Plan:
        scene, kind = self._tracker.scene(frame)
        start, s0, l0 = scene.start, scene.s, scene.l
        v = [start.v]
        for t in STEPS[1:]:
            change = float(
                np.clip(self.speed(frame.t + t) - v[-1], -0.1 * self.brake, 0.1 * self.accel)
            )
            v.append(max(0.0, v[-1] + change))
        s = s0 + np.r_[0.0, np.cumsum(0.05 * (np.array(v[1:]) + np.array(v[:-1])))]
        times = frame.t + STEPS
        path = beside(self._tracker.reference.line, s, l0, self.offset(times))
        return Plan(_driven(replace(start, t=frame.t), times, path, np.array(v)), start=kind)


def beside(line: ReferenceLine, s: FloatArray, l0: float, wish: FloatArray) -> FloatArray:
    """Points `(n, 2)` at stations, from the offset l0 over to the wished offsets within 20 m."""
    way = np.minimum((s - s[0]) / 20.0, 1.0)
    l = wish + (l0 - wish[0]) * (1.0 - way * way * (3.0 - 2.0 * way))
    return np.array([line.point(*each) for each in zip(s, l, strict=True)])


def _driven(start: EgoState, t: FloatArray, points: FloatArray, v: FloatArray) -> Trajectory:
    """The drive through points at speeds."""
    n = len(t)
    exact = of_positions(
        Trajectory(t, *points.T, np.full(n, start.yaw), v, np.zeros(n), np.zeros(n))
    )
    return replace(
        exact, yaw=np.r_[start.yaw, exact.yaw[1:]], kappa=np.r_[start.kappa, exact.kappa[1:]]
    )


class Park(Along):
    """Brakes to a stop and stays."""

    def speed(self, t: float) -> float:
        return 0.0


class Creep(Along):
    """Crawls at walking pace."""

    def speed(self, t: float) -> float:
        return 1.0


class Speeder(Along):
    """Half as fast again as it began, whatever the limit."""

    def speed(self, t: float) -> float:
        return 1.5 * max(self._start.v, 10.0)


class Blind(Along):
    """Drives 15 m/s and looks at no one."""

    def speed(self, t: float) -> float:
        return 15.0


class WrongWay(Along):
    """Drives a lane's width to the left."""

    def offset(self, t: FloatArray) -> FloatArray:
        return np.minimum((t - self._start.t) / 3.0, 1.0) * 3.5


class Swerver(Along):
    """Sways across its lane."""

    def offset(self, t: FloatArray) -> FloatArray:
        return 0.8 * np.sin(2.0 * np.pi * (t - self._start.t) / 2.5)


class CutIn(Along):
    """Changes to the lane on its left at 1 s and does not look who comes there."""

    def offset(self, t: FloatArray) -> FloatArray:
        return 3.5 * np.clip((t - self._start.t - 1.0) / 2.0, 0.0, 1.0)


class Stopper(Along):
    """Comes to a full stop at 6 s, for 8 s, and drives 10 m/s else."""

    def speed(self, t: float) -> float:
        return 0.0 if 6.0 < t - self._start.t < 14.0 else 10.0


class Weaver(Along):
    """Sways slowly within its lane."""

    def offset(self, t: FloatArray) -> FloatArray:
        return 0.4 * np.sin(2.0 * np.pi * (t - self._start.t) / 5.0)


class Straddler(Along):
    """Drives on the line at its left."""

    def offset(self, t: FloatArray) -> FloatArray:
        return np.minimum((t - self._start.t) / 3.0, 1.0) * 1.4


class Tailgate(Idm):
    """Keeps hardly any distance."""

    def __init__(self, context: PlannerContext) -> None:
        super().__init__(context, IdmConfig(time_gap_s=0.1, standstill_gap_m=0.3, decel_mps2=8.0))


class RedRunner(Idm):
    """Knows no lights, no signs, no crosswalks."""

    def __init__(self, context: PlannerContext) -> None:
        super().__init__(replace(context, road=replace(context.road, stop_lines=(), crosswalks=())))


class Capped(Idm):
    """Drives as it should, and no faster than it wishes."""

    def __init__(self, context: PlannerContext) -> None:
        super().__init__(context)
        self._free = self._tracker.reference

    def wish(self, t: float) -> float | FloatArray:
        """The greatest speed that it wishes for at a time, m/s.

        Or that at each station of the line.
        """
        raise NotImplementedError

    def plan(self, frame: Frame) -> Plan:
        self._tracker.reference = replace(
            self._free, limit=np.minimum(self._free.limit, self.wish(frame.t))
        )
        return super().plan(frame)


class NeedlessBraker(Capped):
    """Brakes from 10 to 4.7 m/s every 12 s."""

    def wish(self, t: float) -> float:
        return 4.7 if t % 12.0 > 6.0 else 10.0


class Dawdler(Capped):
    """Drives 60 % of the limit in towns."""

    def wish(self, t: float) -> float:
        return 0.6 * 13.89


class Hiccup(Capped):
    """Brakes by 2.5 m/s for nothing, every 8 s."""

    def wish(self, t: float) -> FloatArray:
        return self._free.limit - (2.5 if t % 8.0 > 6.5 else 0.0)


class Bent(Idm):
    """Drives as it should, with an offset from the line and a speed of its own on top."""

    def offset(self, t: FloatArray) -> FloatArray:
        """The offset wished for, m."""
        return np.zeros(len(t))

    def extra(self, t: FloatArray) -> FloatArray:
        """The speed on top, m/s."""
        return np.zeros(len(t))

    def plan(self, frame: Frame) -> Plan:
        plan, scene = super().plan(frame), self._tracker.scene(frame)[0]
        drive = plan.trajectory
        extra = self.extra(drive.t)
        v = drive.v + extra - extra[0]
        if v.min() < 2.0:  # it stands, or is about to
            return plan
        s = scene.s + np.r_[0.0, np.cumsum(0.5 * np.diff(drive.t) * (v[1:] + v[:-1]))]
        points = beside(scene.reference.line, s, scene.l, self.offset(drive.t))
        return replace(plan, trajectory=_driven(scene.start, drive.t, points, v))


class Swings(Bent):
    """Its speed swings by 0.8 m/s2 at 0.3 Hz."""

    def extra(self, t: FloatArray) -> FloatArray:
        return 0.8 / (0.6 * np.pi) * np.sin(0.6 * np.pi * t)


class Offset(Bent):
    """Takes the middle of its lane for 0.5 m further left, as with a wrong position."""

    def offset(self, t: FloatArray) -> FloatArray:
        return np.full(len(t), 0.5)


class LaneChanger(Bent):
    """Changes to the lane beside its own or back every 6 s, where there is one."""

    def __init__(self, context: PlannerContext) -> None:
        super().__init__(context)
        own = [
            lane
            for lane in context.road.lanes_at(context.start.x, context.start.y)
            if lane.drivable
        ]
        left = any(lane.left_neighbour is not None and not lane.left_opposite for lane in own)
        self._side = (
            3.5 if left else -3.5 if any(lane.right_neighbour is not None for lane in own) else 0.0
        )

    def offset(self, t: FloatArray) -> FloatArray:
        u = np.clip(2.0 * (t / 6.0 % 1.0), 0.0, 1.0)
        share, turn = u * u * (3.0 - 2.0 * u), t // 6.0
        return self._side * np.where(
            turn < 1.0, 0.0, np.where(turn % 2.0 == 1.0, share, 1.0 - share)
        )


class Late(Idm):
    """Sees the others 0.5 s late."""

    late_s = 0.5

    def __init__(self, context: PlannerContext) -> None:
        super().__init__(context)
        self._seen: list[Frame] = []

    def plan(self, frame: Frame) -> Plan:
        self._seen = [*(old for old in self._seen if old.t >= frame.t - self.late_s - 1e-6), frame]
        old = self._seen[0]
        return super().plan(
            replace(frame, agents=old.agents, predictions=_since(old.predictions, frame.t))
        )


def _since(predictions: Predictions, t: float) -> Predictions:
    """What was predicted, taken for what begins at a later time."""
    return replace(predictions, t=predictions.t - predictions.t[0] + t)


class Third(Idm):
    """Does not see every third of the others."""

    def __init__(self, context: PlannerContext) -> None:
        super().__init__(context)
        self._names: list[str] = []

    def plan(self, frame: Frame) -> Plan:
        self._names += [name for name in frame.agents.ids if name not in self._names]
        seen = np.array(
            [i for i, name in enumerate(frame.agents.ids) if self._names.index(name) % 3 != 2],
            np.int64,
        )
        guess = frame.predictions
        rows = np.isin(guess.agent, seen)
        some = {name: getattr(guess, name)[rows] for name in ("probability", "x", "y", "yaw")}
        kept = replace(guess, agent=np.searchsorted(seen, guess.agent[rows]), **some)
        return super().plan(replace(frame, agents=frame.agents.some(seen), predictions=kept))


class CurveCutter(Idm):
    """Takes curves at 4.6 m/s2."""

    def __init__(self, context: PlannerContext) -> None:
        super().__init__(context, IdmConfig(curve_accel_mps2=4.6))


class YellowRunner(Idm):
    """Takes yellow for green."""

    def plan(self, frame: Frame) -> Plan:
        lights = {
            i: Colour.GREEN if colour is Colour.YELLOW else colour
            for i, colour in frame.lights.items()
        }
        return super().plan(replace(frame, lights=lights))


class ShortStop(Idm):
    """Stops 25 m before where it should."""

    def __init__(self, context: PlannerContext) -> None:
        road = context.road
        super().__init__(
            replace(
                context,
                road=replace(road, stop_lines=tuple(_early(m, road) for m in road.stop_lines)),
            )
        )


def _early(mark: StopLine, road: Road) -> StopLine:
    center = road.lanes[mark.lane].center
    ahead = center[-1] - center[-2]
    return replace(mark, points=mark.points - 25.0 * ahead / np.hypot(*ahead))


class Liar(Idm):
    """Brakes and steers by jerks, and says that it goes on evenly and straight."""

    def plan(self, frame: Frame) -> Plan:
        plan = super().plan(frame)
        t = plan.trajectory
        bent = 0.6 * np.sin(2.0 * (t.t - t.t[0])) ** 3
        said = replace(
            t,
            x=t.x - bent * np.sin(t.yaw),
            y=t.y + bent * np.cos(t.yaw),
            a=np.zeros(len(t)),
            kappa=np.zeros(len(t)),
        )
        return replace(plan, trajectory=said)


class Short(Idm):
    """Plans of one state."""

    def plan(self, frame: Frame) -> Plan:
        plan = super().plan(frame)
        return replace(plan, trajectory=plan.trajectory.between(frame.t, frame.t))


class Slow(Idm):
    """Takes longer to plan than a period lasts."""

    def plan(self, frame: Frame) -> Plan:
        time.sleep(0.11)
        return super().plan(frame)


class Random:
    """Steers and accelerates by chance, another one in each run."""

    def __init__(self, context: PlannerContext) -> None:
        self._chance = np.random.default_rng()

    def plan(self, frame: Frame) -> Plan:
        ego = frame.ego
        v = np.maximum(ego.v + self._chance.uniform(-3.0, 2.0) * STEPS, 0.0)
        way = np.r_[0.0, np.cumsum(0.05 * (v[1:] + v[:-1]))]
        unit = arc(
            replace(ego, t=0.0, v=1.0, kappa=ego.kappa + self._chance.uniform(-0.03, 0.03)),
            way + 1e-9 * STEPS,
        )
        return Plan(
            of_positions(
                Trajectory(frame.t + STEPS, unit.x, unit.y, unit.yaw, v, 0.0 * v, unit.kappa)
            )
        )


class Teleport(Idm):
    """Every plan begins 0.45 m ahead of the ego."""

    def plan(self, frame: Frame) -> Plan:
        plan = super().plan(frame)
        t = plan.trajectory
        return replace(
            plan,
            trajectory=replace(t, x=t.x + 0.45 * np.cos(t.yaw[0]), y=t.y + 0.45 * np.sin(t.yaw[0])),
        )


class WildEnd(Idm):
    """Its plans follow `idm` for `until_s`, then swing 12 m to the left.

    The next plan puts the swing off.
    """

    until_s = 1.2

    def plan(self, frame: Frame) -> Plan:
        plan = super().plan(frame)
        late = plan.trajectory.t - frame.t - self.until_s
        late = np.where(late > 1e-6, late, 0.0)
        return (
            replace(plan, trajectory=self.bent(plan.trajectory, late)) if late[-1] > 0.0 else plan
        )

    def bent(self, path: Trajectory, late: FloatArray) -> Trajectory:
        """The plan with another end, `late` s after `until_s`."""
        return _aside(path, late, 12.0)


class Flicker(WildEnd):
    """Its plans end 3 m to the left and 3 m to the right in turns."""

    until_s, side = 1.5, 1.0

    def bent(self, path: Trajectory, late: FloatArray) -> Trajectory:
        self.side = -self.side
        return _aside(path, late, 3.0 * self.side)


class RunThrough(WildEnd):
    """Its plans end by accelerating through whatever is ahead."""

    until_s = 1.5

    def bent(self, path: Trajectory, late: FloatArray) -> Trajectory:
        return _along(path, late, 3.0)


class StopEnd(WildEnd):
    """Every other plan ends with braking to a stop."""

    until_s, turn = 1.5, False

    def bent(self, path: Trajectory, late: FloatArray) -> Trajectory:
        self.turn = not self.turn
        return _along(path, late, -4.0) if self.turn else path


def _aside(path: Trajectory, late: FloatArray, metres: float) -> Trajectory:
    """The path moved to the left, smoothly over 3 s and 20 m."""
    way = np.r_[0.0, np.cumsum(np.hypot(np.diff(path.x), np.diff(path.y)))]
    kept = late <= 0.0
    share = np.minimum(np.minimum(late / 3.0, np.maximum(way - way[kept][-1], 0.0) / 20.0), 1.0)
    aside = metres * share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    bent = of_positions(
        replace(path, x=path.x - aside * np.sin(path.yaw), y=path.y + aside * np.cos(path.yaw))
    )
    same = {
        name: np.where(kept, getattr(path, name), getattr(bent, name))
        for name in ("yaw", "v", "a", "kappa")
    }
    return replace(bent, **same)


def _along(path: Trajectory, late: FloatArray, accel: float) -> Trajectory:
    """The same path, straight on beyond its end, with another acceleration where it is late."""
    n = int(np.argmax(late > 0.0)) - 1
    lasts = late if accel > 0.0 else np.minimum(late, path.v[n] / -accel)
    v = np.where(late > 0.0, path.v[n] + accel * lasts, path.v)
    s = np.r_[0.0, np.cumsum(np.hypot(np.diff(path.x), np.diff(path.y)))] + 1e-9 * np.arange(
        len(late)
    )
    at = np.where(late > 0.0, s[n] + path.v[n] * lasts + 0.5 * accel * lasts**2, s)
    beyond = np.maximum(at - s[-1], 0.0)
    yaw, kappa = (
        np.interp(at, s, path.yaw),
        np.where(beyond > 0.0, 0.0, np.interp(at, s, path.kappa)),
    )
    x = np.interp(at, s, path.x) + beyond * np.cos(path.yaw[-1])
    y = np.interp(at, s, path.y) + beyond * np.sin(path.yaw[-1])
    moves = (late > 0.0) & (lasts == late)
    return Trajectory(
        path.t, x, y, yaw, v, np.where(moves, accel, np.where(late > 0.0, 0.0, path.a)), kappa
    )


class FarAhead:
    """Plans straight on, 1000 km in 8 s."""

    def __init__(self, context: PlannerContext) -> None:
        pass

    def plan(self, frame: Frame) -> Plan:
        return Plan(arc(replace(frame.ego, v=1.25e5), frame.t + STEPS))


@dataclass(frozen=True)
class Adversary:
    """A planner, how it is run, a log and the gate (first words) that catches it there."""

    planner: Callable[..., object]
    log: str | Callable[[], Scenario]
    gate: str
    vehicle: str = "kinematic_bicycle"

    def scenario(self) -> Scenario:
        """The log."""
        return CATALOGUE[self.log].scenario() if isinstance(self.log, str) else self.log()


def overtaken(behind: float) -> Scenario:
    """Two lanes.

    The logged ego drives 10 m/s on the right one, a car `behind` m behind it 15 m/s on the left
    one.
    """
    follower = ("7", AgentKind.CAR, (4.5, 1.8), moving(-behind, 3.5, 15.0, 0.0))
    return scenario(along(grid(12.0, 0.1), 10.0), [follower], road=straight_road(lanes=2))


def walked_along() -> Scenario:
    """The logged ego drives 8 m/s along a pedestrian who walks 1.8 m right of its lane's middle."""
    walker = ("7", AgentKind.PEDESTRIAN, (0.5, 0.5), moving(40.0, -1.8, 1.2, 0.0))
    return scenario(along(grid(12.0, 0.1), 8.0), [walker], road=straight_road(lanes=2))


def two_lanes_alone() -> Scenario:
    """The logged ego drives 12 m/s on the right one of two empty lanes."""
    return scenario(along(grid(25.0, 0.1), 12.0), road=straight_road(lanes=2, limit=12.0))


ADVERSARIES = {
    "park": Adversary(Park, "paper/free_road", "route_progress"),
    "creep": Adversary(Creep, "paper/free_road", "route_progress"),
    "tailgate": Adversary(Tailgate, "everyday/follow", "thw"),
    "wrong_way": Adversary(WrongWay, "everyday/cyclist", "collision_at_fault"),
    "cut_in": Adversary(CutIn, partial(overtaken, 16.5), "collision_at_fault"),
    "cut_in_mild": Adversary(CutIn, partial(overtaken, 20.0), "forced_braking"),
    "needless_braker": Adversary(NeedlessBraker, "paper/free_road", "needless_braking"),
    "dawdler": Adversary(Dawdler, "everyday/traffic_light", "needless_braking"),
    "stopper": Adversary(Stopper, "paper/free_road", "needless_standing"),
    "swings": Adversary(Swings, "paper/free_road", "speed_swing"),
    "hiccup": Adversary(Hiccup, "paper/free_road", "speed_swing"),
    "offset": Adversary(Offset, "paper/free_road", "lane_offset"),
    "lane_changer": Adversary(LaneChanger, two_lanes_alone, "needless_lane_change"),
    "late": Adversary(Late, "everyday/pull_outs", "speed_swing"),
    "third": Adversary(Third, "everyday/pull_outs", "collision_at_fault"),
    "curve_cutter": Adversary(CurveCutter, "everyday/bend", "curve_accel"),
    "yellow_runner": Adversary(YellowRunner, "everyday/yellow_light", "red_light"),
    "short_stop": Adversary(ShortStop, "everyday/traffic_light", "needless_standing"),
    "weaver": Adversary(Weaver, "paper/free_road", "needless_steering"),
    "straddler": Adversary(Straddler, "paper/free_road", "lane_line"),
    "close_passer": Adversary(Along, walked_along, "passing_room"),
    "red_runner": Adversary(RedRunner, "everyday/traffic_light", "red_light"),
    "swerver": Adversary(Swerver, "paper/free_road", "lat_jerk_r79"),
    "speeder": Adversary(Speeder, "paper/free_road", "speed_excess"),
    "liar": Adversary(Liar, "paper/free_road", "plan_corrected"),
    "short": Adversary(Short, "paper/free_road", "plan_complete"),
    "slow": Adversary(Slow, "paper/free_road", "deadline"),
    "random": Adversary(Random, "paper/free_road", "off_road"),
    "teleport": Adversary(Teleport, "paper/free_road", "plan_refused", "perfect"),
    "wild_end": Adversary(WildEnd, "paper/free_road", "plan_kept_lateral"),
    "flicker": Adversary(Flicker, "paper/free_road", "plan_change_lateral"),
    "run_through": Adversary(RunThrough, "everyday/follow", "plan_kept"),
    "stop_end": Adversary(StopEnd, "paper/free_road", "plan_change"),
    "far_ahead": Adversary(FarAhead, "paper/free_road", "plan_refused"),
}
