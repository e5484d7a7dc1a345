"""The paper's crossing pedestrian, varied: speed of the ego, speed of the walker, and when the
walker arrives.

Each cell is `paper/crossing_pedestrian` with another speed, another walk and another distance. Only
the first ego state of the log is used, because a careful driver cannot avoid contact in every cell.

A cell is judged by the options of a point mass: keep its speed, or brake and stay behind the
walker. The two boxes meet at right angles; f(t) is the front bumper's way from the walker's nearer
side, and the walker is within the ego's width from t_in to t_out:

(1) keeping its speed avoids him   <=>  f(t_out) <= 0  or  f(t_in) >= ego length + walker width
        f = v t - g
(2) braking avoids him             <=>  f(t_out) <= 0
        f = v t_b - g + s(t - t_b) from t_b on
(3) s(u) = v u - j u^3 / 6 while u <= b / j, then with b until standstill
        b, j: deceleration, jerk
(4) t_b = start of the walk + REACTION_S + dead time and lag of the brake

(b, j) are the planner's stated limits, comfortable or hard. With no time to react, (2) is the limit
of braking: in the first frame the walker's speed is unknown.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from math import sqrt

import numpy as np
import pandas as pd

from replan.core.errors import PlannerError
from replan.logs.catalogue.family_parts import ADULT, HALF_LANE
from replan.logs.catalogue.paper import crossing_pedestrian
from replan.logs.scenario import Scenario
from replan.logs.trace import EndReason, Trace
from replan.metrics import METRICS, evaluate
from replan.planners.dp_qp.speed.qp import SpeedQpConfig
from replan.planners.frenet.profiles import SpeedLimits
from replan.planners.frenet.st_boundaries import StGraphConfig
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop_config import LoopConfig
from replan.run.pool import WorkerLost, run_all

PLANNER = "dp_qp"
LOOP = LoopConfig(vehicle="single_track", controller="mpc", traffic="time")
EGO_KMH = (20.0, 30.0, 40.0, 50.0)
WALKER_MPS = (0.8, 1.15, 1.5, 1.85, 2.2)
LATE_S = (-2.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0)
REACTION_S = 0.0
WALK_RAMP_S = 0.4  # Time in which the walker of the family reaches its speed, s
RELEASE_S = 1.0
JERK_MPS3 = 4.13  # Comfort bound of the longitudinal jerk (replan.metrics.comfort)
PRESSED = 1e-3
JOINED_S = 0.5  # Releases of the brake that are shorter than this do not end the braking


@dataclass(frozen=True)
class GridCrossing:
    """One crossing."""

    ego_kmh: float
    walker_mps: float
    # Time at which the walker is in the middle of the lane, minus the time at which the front
    # bumper of an ego that keeps its speed reaches the walker's line
    late_s: float

    @property
    def parameters(self) -> dict[str, float]:
        """The parameters of the family that the cell changes."""
        nominal = crossing_pedestrian.parameters
        middle = (HALF_LANE + nominal["kerb_distance_m"]) / self.walker_mps + 0.5 * WALK_RAMP_S
        v = self.ego_kmh / 3.6
        return {
            "ego_speed_mps": v,
            "pedestrian_speed_mps": self.walker_mps,
            "distance_m": v * (middle - self.late_s),
        }


CELLS = tuple(GridCrossing(*cell) for cell in product(EGO_KMH, WALKER_MPS, LATE_S))


def crossing(cell: GridCrossing) -> Scenario:
    """The scenario of a cell; its log holds the first ego state only."""
    scenario = crossing_pedestrian.build({**crossing_pedestrian.parameters, **cell.parameters})
    name = (
        f"{crossing_pedestrian.name}@{cell.ego_kmh:g}kmh,{cell.walker_mps:g}mps,{cell.late_s:+g}s"
    )
    return replace(
        scenario, name=name, ego=scenario.ego.between(0.0, 0.0), tags=("synthetic", "pedestrian")
    )


def walker_within(scenario: Scenario, margin: float) -> tuple[float, float]:
    """First and last time at which the walker is within the ego's width and `margin` on each side,
    s.
    """
    track = scenario.tracks
    reach = 0.5 * (scenario.vehicle.width + ADULT[0]) + margin
    entry, leave = (float(np.interp(side, track.y, track.t)) for side in (-reach, reach))
    return entry, leave


def braked(u: float, v: float, limits: SpeedLimits) -> float:
    """Distance (3) of a point mass `u` >= 0 s after it began to brake from `v` m/s, m."""
    b, j = limits.decel_mps2, limits.jerk_mps3
    ramp = min(b / j, sqrt(2.0 * v / j))
    left = max(v - 0.5 * j * ramp**2, 0.0)
    first, then = min(u, ramp), min(max(u - ramp, 0.0), left / b)
    return v * first - j * first**3 / 6.0 + left * then - 0.5 * b * then**2


@dataclass(frozen=True)
class Avoidable:
    """Whether a point mass avoids contact in a cell: by (1), and by (2) with comfortable and with
    hard braking.
    """

    keeping_speed: bool
    comfortable: bool
    hard: bool

    @property
    def gently(self) -> bool:
        """Whether hard braking is not needed."""
        return self.keeping_speed or self.comfortable


def avoidable(cell: GridCrossing) -> Avoidable:
    """The options of a point mass in a cell (module docstring)."""
    scenario, qp, v = crossing(cell), SpeedQpConfig(), cell.ego_kmh / 3.6
    car, walk = scenario.vehicle, crossing_pedestrian.parameters["walk_start_s"]
    t_in, t_out = walker_within(scenario, 0.0)
    begin = walk + REACTION_S + car.brake_delay + car.brake_lag
    gap = v * walk + cell.parameters["distance_m"] - 0.5 * ADULT[1]
    keeping = v * t_out <= gap or v * t_in - gap >= car.length + ADULT[1]
    stops = [
        v * begin + float(braked(t_out - begin, v, limits)) for limits in (qp.comfort, qp.emergency)
    ]
    return Avoidable(keeping, *(stop <= gap for stop in stops))


def braking_intervals(trace: Trace) -> list[tuple[float, float]]:
    """Begin and end of each interval in which the brake was commanded, s.

    Short releases are bridged.
    """
    if trace.commands is None:
        return []
    pressed = np.r_[False, trace.commands.brake > PRESSED, False]
    edges = np.flatnonzero(pressed[1:] != pressed[:-1])
    last = len(trace.commands) - 1
    joined: list[tuple[float, float]] = []
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        begin, stop = float(trace.commands.t[first]), float(trace.commands.t[min(end, last)])
        if joined and begin - joined[-1][1] < JOINED_S:
            joined[-1] = (joined[-1][0], stop)
        else:
            joined.append((begin, stop))
    return joined


def braking_for_walker(trace: Trace, scenario: Scenario) -> tuple[float, list[tuple[float, float]]]:
    """When the walker has left the path with the planner's margin, s.

    The `braking_intervals` that begin before.
    """
    clear = walker_within(scenario, StGraphConfig().vulnerable_margin_m)[1]
    return clear, [(begin, end) for begin, end in braking_intervals(trace) if begin < clear]


def first_reason(trace: Trace) -> str:
    """When the planner first gave a reason for a plan, and the reason; empty if it never did."""
    return next(
        (f"{frame.t:.1f} s: {frame.plan.reason}" for frame in trace.frames if frame.plan.reason), ""
    )


def measured(cell: GridCrossing) -> dict[str, object]:
    """One row of the table: the cell, the options of a point mass, and the result of the drive."""
    scenario = crossing(cell)
    trace = run_closed_loop(scenario, PLANNER, config=LOOP).trace
    names = ("gap", "lon_jerk_state", "lon_accel", "fallback", "pedals_together")
    table = evaluate(trace, scenario, metrics={name: METRICS[name] for name in names}).set_index(
        "metric"
    )["value"]
    clear, before = braking_for_walker(trace, scenario)
    begin, end = (before[0][0], before[-1][1]) if before else (np.nan, np.nan)
    contact, can = trace.end in (EndReason.COLLISION, EndReason.REPLAY_CONTACT), avoidable(cell)
    jerk = float(table["lon_jerk_state.max_abs"])
    row: dict[str, object] = {
        "ego_kmh": cell.ego_kmh,
        "walker_mps": cell.walker_mps,
        "late_s": cell.late_s,
        "distance_m": cell.parameters["distance_m"],
        "keeping_speed_avoids": can.keeping_speed,
        "comfortable_braking_avoids": can.comfortable,
        "hard_braking_avoids": can.hard,
        "end": trace.end.value,
        "contact": contact,
        "contact_t_s": float(trace.ego.t[-1]) if contact else np.nan,
        "contact_v_mps": float(trace.ego.v[-1]) if contact else np.nan,
        "least_gap_m": float(table["gap.min"]),
        "brake_begin_s": begin,
        "brake_end_s": end,
        "braking_s": sum(stop - start for start, stop in before) if before else 0.0,
        "path_clear_s": clear,
        "release_after_clear_s": end - clear,
        "least_speed_mps": float(trace.ego.v.min()),
        "peak_decel_mps2": -float(table["lon_accel.min"]),
        "peak_jerk_mps3": jerk,
        "fallback_rate": float(table["fallback.rate"]),
        "pedals_together": float(table["pedals_together.count"]),
        "first_reason": first_reason(trace),
    }
    if trace.end in (EndReason.PLANNER_FAILURE, EndReason.OFF_ROAD):
        return row | {"verdict": "failed"}
    return row | {"verdict": verdict(can, contact=contact, released=end - clear, jerk=jerk)}


def verdict(can: Avoidable, *, contact: bool, released: float, jerk: float) -> str:
    """The verdict on a cell: the first of these that applies.

    "failed"        the planner failed, or the ego left the road (`measured`)
    "contact"       contact that hard braking would have avoided
    "drive on"      contact; braking could not avoid it, but keeping the speed could
    "unavoidable"   contact; neither could
    "late release"  the brake was still pressed RELEASE_S after the path was clear
    "jerk"          above the comfort bound, where no hard braking was needed
    "ok"
    """
    if contact:
        if can.hard:
            return "contact"
        return "drive on" if can.keeping_speed else "unavoidable"
    if released > RELEASE_S:
        return "late release"
    return "jerk" if can.gently and jerk > JERK_MPS3 else "ok"


def grid(
    cells: tuple[GridCrossing, ...] = CELLS,
    *,
    workers: int = 0,
    on_cell: Callable[[int], None] = lambda cells: None,
) -> pd.DataFrame:
    """The table, a row per cell in their order; the same whatever the number of `workers` (0: in
    this process).

    PlannerError if a worker died.
    """
    rows: dict[int, dict[str, object]] = {}
    outcomes = (
        run_all(measured, cells, workers)
        if workers
        else ((i, measured(cell)) for i, cell in enumerate(cells))
    )
    for index, row in outcomes:
        if isinstance(row, WorkerLost):
            raise PlannerError(f"{crossing(cells[index]).name}: {row.reason}")
        rows[index] = row
        on_cell(len(rows))
    return pd.DataFrame([rows[index] for index in range(len(cells))])
