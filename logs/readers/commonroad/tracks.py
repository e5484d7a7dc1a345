"""Makes tracks and the ego's log from CommonRoad obstacles: corrects headings, chooses velocities.

Headings. Some recordings give headings against true north and positions on a map grid, so that all
vehicles seem to drive askew by the same angle (MONA: 1.93 degrees, the grid convergence of UTM zone
32 at Munich).

(1) offset = median over vehicles of median(direction of motion - heading),
        added where it exceeds `_ASKEW` and four of five vehicles agree with it within `_ASKEW`.

Velocities. Stored speeds agree with the positions in some files and not in others (SUMO
co-simulations), and differences of positions are noisy (NGSIM). Both candidates use no later sample
than their own:

(2) v cos(yaw), v sin(yaw) with the stored speed v     or     (p_k - p_{k-1}) / (t_k - t_{k-1})

The one with the smaller mean error of a constant-velocity prediction 1 s ahead, over all the file's
traffic, is taken for the whole file. A first sample has no difference: its stored speed is used.

Ego log. The rear axle is the box centre minus `axle_to_center` along the heading (positions are
exact). Speed and acceleration as stored; where 5 % of the stored speeds are off by more than 1 m/s,
by central differences. Curvature is the slope of heading over distance, and acceleration, where it
is not stored, that of speed over time: least squares within `WINDOW_S` to both sides. An ego log is
ground truth and not seen by planners: central windows are allowed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import radians

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind
from replan.logs.kind_words import kind_of_word
from replan.logs.readers.commonroad.document_records import Document, Obstacle
from replan.logs.readers.commonroad.occupancy_sets import standing
from replan.logs.states import Trajectory, wrap
from replan.logs.tracks import Tracks
from replan.logs.vehicle import VehicleParameters

WINDOW_S = 0.5
"""Half of the window over which the ego log's slopes are fitted."""
_ASKEW = radians(0.5)
"""Greatest difference of a heading from the direction of motion that is not corrected, rad."""


def turned(document: Document) -> tuple[Document, tuple[str, ...]]:
    """Correct the headings of the document by (1); return it with a note."""
    medians = []
    for obstacle in document.obstacles:
        step, x, y, yaw = obstacle.states[:, :4].T
        dx, dy = np.diff(x), np.diff(y)
        moving = np.hypot(dx, dy) > 3.0 * document.dt * np.diff(step)
        if len(step) >= 6 and moving.sum() >= 5:
            angle = np.arctan2(dy, dx) - 0.5 * (yaw[1:] + yaw[:-1])
            medians.append(float(np.median([wrap(a) for a in angle[moving]])))
    offset = float(np.median(medians)) if len(medians) >= 5 else 0.0
    agreeing = np.mean(np.abs(np.array(medians) - offset) < _ASKEW) if medians else 0.0
    if abs(offset) <= _ASKEW or agreeing < 0.8:
        return document, ()
    turn = np.array([0.0, 0.0, 0.0, offset, 0.0, 0.0])
    obstacles = tuple(replace(o, states=o.states + turn) for o in document.obstacles)
    problems = []
    for problem in document.problems:
        goals = (
            g if g.yaw is None else replace(g, yaw=(g.yaw[0] + offset, g.yaw[1] + offset))
            for g in problem.goals
        )
        problems.append(replace(problem, start=problem.start + turn, goals=tuple(goals)))
    note = (
        f"headings are turned by {np.degrees(offset):.2f} deg: {len(medians)} vehicles drive "
        "askew by that angle"
    )
    return replace(document, obstacles=obstacles, problems=tuple(problems)), (note,)


def velocities(document: Document) -> tuple[dict[int, FloatArray], tuple[str, ...]]:
    """Velocity vectors `(n, 2)` per moving obstacle by (2), m/s, and which rule was taken."""
    moving = [o for o in document.obstacles if not o.static]
    stored, backward = [], []
    for obstacle in moving:
        step, x, y, yaw, v, _ = obstacle.states.T
        stored.append(np.column_stack([v * np.cos(yaw), v * np.sin(yaw)]))
        backward.append(stored[-1].copy())
        backward[-1][1:] = (
            np.column_stack([np.diff(x), np.diff(y)]) / (document.dt * np.diff(step))[:, None]
        )
    errors = [_prediction_error(moving, v, document.dt) for v in (stored, backward)]
    by_difference = bool(errors[1] < errors[0]) or any(np.isnan(v).any() for v in stored)
    chosen = backward if by_difference else stored
    velocity_of_id = {o.id: v for o, v in zip(moving, chosen, strict=True)}
    if not np.isfinite(errors).all():
        return velocity_of_id, ()
    rule = (
        "backward differences of positions" if by_difference else "stored speeds along the headings"
    )
    note = (
        f"agents' velocities are {rule} (error 1 s ahead {min(errors):.2f} m, the other way "
        f"{max(errors):.2f} m)"
    )
    return velocity_of_id, (note,)


def _prediction_error(
    obstacles: Sequence[Obstacle], velocity: Sequence[FloatArray], dt: float
) -> float:
    """Mean distance to the truth of a constant-velocity prediction over 1 s, m; NaN where no track
    is that long.
    """
    ahead, errors = max(1, round(1.0 / dt)), []
    for obstacle, v in zip(obstacles, velocity, strict=True):
        step, p = obstacle.states[:, 0], obstacle.states[:, 1:3]
        if len(step) > ahead + 1:
            span = dt * (step[ahead + 1 :] - step[1:-ahead])
            errors.append(np.hypot(*(p[1:-ahead] + v[1:-ahead] * span[:, None] - p[ahead + 1 :]).T))
    return float(np.mean(np.concatenate(errors))) if errors else float("nan")


def tracks_of(
    document: Document,
    velocity: dict[int, FloatArray],
    without: int | None,
    start: float,
    origin: tuple[float, float],
) -> Tracks:
    """The traffic from time step `start` on, which becomes t = 0; obstacle `without` is the ego.

    `velocity` is that of `velocities`; `origin`, m, is subtracted from positions. Samples before
    `start` are left out (their differences are in the velocities); static obstacles stay.
    """
    tracks: list[tuple[str, AgentKind, float, float, bool, FloatArray]] = []
    for o in document.obstacles:
        later = o.states[:, 0] >= start - 1e-6
        if o.id == without:
            continue
        if o.sets and not o.static:
            # Each box for as long as its set stands
            for name, first, last, box in standing(o.sets):
                if last > start:
                    pose = (box.x, box.y, box.yaw, 0.0, 0.0)
                    states = np.array([(max(first, start), *pose), (last, *pose)])
                    tracks.append(
                        (f"{o.id} {name}", AgentKind.OBJECT, box.length, box.width, False, states)
                    )
        elif o.static or later.any():
            v = np.zeros((1, 2)) if o.static else velocity[o.id][later]
            states = np.column_stack([(o.states if o.static else o.states[later])[:, :4], v])
            tracks.append(
                (
                    str(o.id),
                    kind_of_word(o.type) or AgentKind.OBJECT,
                    o.length,
                    o.width,
                    o.static,
                    states,
                )
            )
    if not tracks:
        return Tracks.empty()
    ids, kinds, length, width, static, samples = zip(*tracks, strict=True)
    step, x, y, yaw, vx, vy = np.vstack(samples).T
    offsets = np.cumsum([0, *map(len, samples)])
    t = np.where(
        np.repeat(static, np.diff(offsets)), 0.0, np.round((step - start) * document.dt, 9)
    )
    place = x - origin[0], y - origin[1], yaw, vx, vy
    return Tracks(
        ids, kinds, np.array(length), np.array(width), np.array(static), offsets, t, *place
    )


def sized(obstacle: Obstacle) -> VehicleParameters:
    """The default vehicle at an obstacle's size: axles in proportion to its length, radius of
    gyration too.
    """
    base = VehicleParameters()
    ratio = obstacle.length / base.length
    return replace(
        base,
        length=obstacle.length,
        width=obstacle.width,
        wheelbase=base.wheelbase * ratio,
        rear_overhang=base.rear_overhang * ratio,
        cog_to_front=base.cog_to_front * ratio,
        yaw_inertia=base.yaw_inertia * ratio**2,
    )


def trimmed(obstacle: Obstacle, dt: float) -> tuple[Obstacle, tuple[str, ...]]:
    """Drop a first or last sample whose position contradicts the speed; return the obstacle and
    notes.

    Recordings clip a vehicle's first position to the edge of their view: it then covers the first
    step at a third of its speed (MONA), or a simulator writes the first state twice. A sample
    contradicts the speed where the step to it is off by more than 2 m/s, and the next step by less
    than 1 m/s.
    """
    states, notes = obstacle.states, []
    for where, end in (("first", slice(1, None)), ("last", slice(None, -1))):
        if len(states) < 4:
            break
        speeds = np.hypot(*np.diff(states[:, 1:3], axis=0).T) / (dt * np.diff(states[:, 0]))
        off = np.abs(speeds - 0.5 * (states[1:, 4] + states[:-1, 4]))
        edge, inner = (off[0], off[1]) if where == "first" else (off[-1], off[-2])
        if edge > 2.0 and inner < 1.0:
            states = states[end]
            notes.append(
                f"the ego log's {where} sample is dropped: its position is off by {edge * dt:.1f} m"
            )
    return replace(obstacle, states=states), tuple(notes)


def ego_log(
    obstacle: Obstacle, dt: float, vehicle: VehicleParameters, origin: tuple[float, float]
) -> tuple[Trajectory, tuple[str, ...]]:
    """Return the obstacle's drive at its rear axle, t = 0 at its first sample, and notes on
    assumptions.
    """
    step, cx, cy, yaw, v, a = obstacle.states.T
    t = np.round((step - step[0]) * dt, 9)
    x = cx - origin[0] - vehicle.axle_to_center * np.cos(yaw)
    y = cy - origin[1] - vehicle.axle_to_center * np.sin(yaw)
    notes = [f"the ego's curvature is differenced over {2.0 * WINDOW_S:g} s"]
    along = np.gradient(x, t) * np.cos(yaw) + np.gradient(y, t) * np.sin(yaw)
    known = bool(np.isfinite(v).all())
    off = float(np.percentile(np.abs(v - along), 95)) if known else np.inf
    if not known or (off > 1.0 and len(t) >= 4):
        v, a = along, np.full(len(t), np.nan)
        why = f"the stored one is off by {off:.1f} m/s" if known else "none is stored"
        notes.append(f"the ego's speed is differenced from its positions: {why}")
    if not np.isfinite(a).all():
        a = _slopes(t, v, t, 1e-3)
        notes.append(f"the ego's acceleration is differenced over {2.0 * WINDOW_S:g} s")
    station = np.r_[0.0, np.cumsum(np.diff(x) * np.cos(yaw[1:]) + np.diff(y) * np.sin(yaw[1:]))]
    kappa = np.clip(_slopes(station, yaw, t, 1.0), -vehicle.max_kappa, vehicle.max_kappa)
    return Trajectory(t, x, y, yaw, v, a, kappa), tuple(notes)


def _slopes(x: FloatArray, y: FloatArray, t: FloatArray, least: float) -> FloatArray:
    """Least-squares slope dy/dx at each sample over `WINDOW_S` to both sides; 0 where x spans less
    than `least`.
    """
    slopes = np.zeros(len(x))
    for i in range(len(x)):
        near = np.abs(t - t[i]) <= WINDOW_S + 1e-9
        dx, dy = x[near] - x[near].mean(), y[near] - y[near].mean()
        if np.ptp(dx) >= least:
            slopes[i] = (dx @ dy) / (dx @ dx)
    return slopes
