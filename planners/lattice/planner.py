"""The planner's one screen: start, scene, pairs, the first of them in order of cost that passes; or the fallback."""

from __future__ import annotations

import numpy as np

from logs.frame import Frame, PlannerContext
from logs.kernel import FloatArray, IntArray
from logs.states import Trajectory
from logs.trace import Artefact, Candidates, Internals, Plan
from planners.frenet.fallback import fall_back
from planners.frenet.occupancy import on_reference
from planners.frenet.profiles import HORIZON_STEPS, STEP_S
from planners.frenet.start import RouteTracker
from planners.lattice.candidates import Pairs, Sampler
from planners.lattice.checks import REST_MPS, SAID, Body, Others, Room, Tried, first_feasible
from planners.lattice.config import LatticeConfig
from planners.lattice.futures import Ego, Futures, ego_frenet, futures_of
from planners.lattice.polynomials import lateral_polynomial, sampled, states
from planners.lattice.record import artefacts
from planners.rules import Rulebook, RuleMemory


class Lattice:
    """Chooses among pairs of polynomials; its memory is the last station and what the rules remember.

    Where no pair can be driven, the ladder of `planners.frenet.fallback` answers: the rest of the previous plan, else a
    comfortable stop, else a hard one. Who follows behind is not looked at while the ego keeps its track.
    """

    def __init__(self, context: PlannerContext, config: LatticeConfig | None = None) -> None:
        self._config = config or LatticeConfig()
        self._vehicle, self._lap = context.vehicle, context.lap
        self._tracker = RouteTracker(context)
        self._rules = Rulebook(context.road, self._tracker.reference, context.vehicle)
        self._memory = RuleMemory()
        passes_left = context.road.drives_on_right
        self._sampler = Sampler(self._tracker.reference, self._vehicle, self._config, passes_left=passes_left)

    def plan(self, frame: Frame) -> Plan:
        """The cheapest pair that can be driven, ties to the first; else the fallback, and why."""
        scene, start_kind = self._tracker.scene(frame)
        if frame.previous is None:
            self._memory = RuleMemory()
        if scene.trouble:
            return fall_back(frame, scene.start, start_kind, None, scene.trouble, (), self._vehicle)
        ego = ego_frenet(scene)
        futures = futures_of(scene, ego, self._config)
        self._lap("scene")
        demanded, self._memory = self._rules.stops(scene, self._memory)
        stops = on_reference(demanded, scene.s, self._vehicle)
        pairs = self._sampler.pairs(ego, futures, stops)
        self._lap("candidates")
        chosen, faults = self._choose(ego, futures, pairs)
        counted = _counted(pairs, faults, chosen)
        self._lap("choice")
        if chosen < 0:
            reason = "no candidate can be driven: " + ", ".join(f"{n} {why}" for why, n in counted.rejected)
            return fall_back(frame, scene.start, start_kind, None, reason, (counted,), self._vehicle)
        row, line = int(pairs.row[chosen]), scene.reference.line
        motion = sampled(pairs.lon.coef[row, None], pairs.lon.T[row, None], HORIZON_STEPS)[0]
        lateral = lateral_polynomial(np.array(ego.lateral), pairs.l1[chosen], pairs.length[chosen])
        at = states(line.s, line.coef, scene.s, lateral, pairs.length[chosen], motion)

        def internals() -> tuple[Artefact, ...]:
            shown = artefacts(scene, ego, futures, pairs, chosen, at, motion, self._config)
            return (*shown, *(stop.decision for stop in stops), counted)

        return Plan(trajectory(frame.t, at), start=start_kind, internals=Internals((), internals))

    def _choose(self, ego: Ego, futures: Futures, pairs: Pairs) -> tuple[int, IntArray]:
        """The first pair without a fault, -1 where there is none, and the faults of those before it."""
        car, line = self._vehicle, self._tracker.reference.line
        order = np.argsort(np.round(pairs.costs.sum(axis=0), 9), kind="stable")
        return first_feasible(
            Tried(pairs.lon.coef, pairs.lon.T, pairs.row, pairs.l1, pairs.length, pairs.changes),
            order,
            ego.s,
            np.array(ego.lateral),
            Room(line.s, line.coef, self._sampler.left, self._sampler.right),
            Others(futures.pose, futures.sizes, futures.behind),
            Body(car.axle_to_center, car.length, car.width, car.max_kappa, self._config.lat_accel_mps2),
        )


def _counted(pairs: Pairs, faults: IntArray, chosen: int) -> Candidates:
    """How many pairs there were, and why the others were not taken."""
    rejected = pairs.faults + faults
    dearer = len(pairs) - int(faults.sum()) - 1 if chosen >= 0 else 0
    counts = [(why, int(rejected[fault])) for fault, why in SAID.items()]
    counts.append(("dearer than the chosen one", dearer))
    return Candidates("lattice", len(pairs) + int(pairs.faults.sum()), tuple(count for count in counts if count[1]))


def trajectory(t: float, at: FloatArray) -> Trajectory:
    """The trajectory from time `t` of `states` `(9, k)`; a rest is a rest."""
    x, y, yaw, v, a, kappa = at[:6]
    rest = v < 1e-3
    times = t + STEP_S * np.arange(at.shape[1])
    return Trajectory(times, x, y, yaw, np.where(rest, 0.0, v), np.where(rest & (np.abs(a) < REST_MPS), 0.0, a), kappa)
