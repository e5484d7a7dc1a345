"""Alternatives: the trajectories among which a planner chose, judged each by itself.

A plan may show K trajectories with scores (`Plan.alternatives`). They are sampled as plans are, at
t_i + 0.1 s, ... after their frame. The chosen one c is that with the highest score.

(1) min_ade = min over k of ADE_k, min_fde = min over k of FDE_k (`accuracy`, open loop)
(2) min_miss = 1 where every k misses the log by more than the bound of `accuracy.miss`, else 0
(3) spread = mean over k of |p_k - mean of p|, p the position 4 s after the frame
(4) off_road, contact = share of the k that `proposals` finds more than 0.3 m farther off the road
        than at their start, or in contact at fault
(5) regret = max over k of score_k - score_c,  score: `proposals` (7), without extended comfort
(6) hit = 1 where c is the k of the least ADE at 3 s, else 0
(7) calibration error = sum over bins b of n_b / n |mean of hit - mean of P_c|, ten bins of P_c
(8) brier = sum over k of (P_k - [k is the nearest])^2

(7) and (8) need scores P_k that are probabilities: within 0 and 1, their sum is 1 within 0.001. An
alternative that ends before a horizon counts as none at it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replan.core.arrays import FloatArray, IntArray
from replan.core.once import once
from replan.logs.frame_store import light
from replan.logs.scenario import Scenario
from replan.logs.trace import Mode, Trace
from replan.metrics.accuracy import HORIZONS_S, MISS_M
from replan.metrics.metric import (
    BOTH_LOOPS,
    Measured,
    Parts,
    Reduction,
    Series,
    Unavailable,
    metric,
)
from replan.metrics.off_road import OFF_ROAD_M, known_lanes
from replan.metrics.plans import STEP_S, columns_at, frame_times, times_after
from replan.metrics.proposals import HORIZON_S, PLAN_COLUMNS, STEPS, judged, scored
from replan.metrics.reductions import MAX, MEAN, MIN, RATE, SHARE, share_beyond

NEAREST_S = 3  # Horizon of (6) to (8), s
BINS = 10  # Number of bins of (7)
SUM_WITHIN = 1e-3  # Greatest distance from 1 of a sum of probabilities
REGRET = 0.2  # A regret that matters: comfort alone weighs 2 / 12
PIECE = 200  # Frames that are sampled at a time: 20 alternatives each take 16 MB
Rows = Mapping[str, NDArray[Any]]


@once
def judged_alternatives(trace: Trace, scenario: Scenario) -> Rows | Unavailable:
    """Return the values of all alternatives, `(r,)` each, in order of their frames: the `frame`,
    the planner's `score`, what `judged` has, their `worth` by (7) of `proposals`, and the distances
    from the log by horizon.
    """
    plans = [(i, frame.plan) for i, frame in enumerate(light(trace.frames))]
    having = [(i, plan.alternatives) for i, plan in plans if plan.alternatives]
    if not having:
        return Unavailable("the planner shows no alternatives (`Plan.alternatives`)")
    all_times, pieces = times_after(trace, 0, round(max(HORIZONS_S) / STEP_S)), []
    for begin in range(0, len(having), PIECE):
        shown = [
            (i, alternative)
            for i, several in having[begin : begin + PIECE]
            for alternative in several
        ]
        frame = np.array([i for i, _ in shown])
        times = all_times[frame]
        trajectories = [alternative.trajectory for _, alternative in shown]
        columns = columns_at(trajectories, times, PLAN_COLUMNS)
        near = slice(STEPS + 1)
        rows = judged(times[:, near], columns[:, :, near], trace, scenario)
        pieces.append(
            {
                "frame": frame,
                "score": np.array([alternative.score for _, alternative in shown]),
                "worth": scored(rows, trace, np.full(len(frame), np.nan)),
                "end_x": columns[0, :, STEPS],
                "end_y": columns[1, :, STEPS],
                "off": rows["off"],
                "contact": rows["contact"],
                **_distances(times[:, 1:], columns[:2, :, 1:], scenario),
            }
        )
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}


def _distances(times: FloatArray, plan: FloatArray, scenario: Scenario) -> Rows:
    """Return ADE, FDE and the greatest distance from the log by horizon, m, `(r,)` each; NaN where
    the log or the alternative ends before.
    """
    log = scenario.ego
    x, y = (np.interp(times, log.t, column) for column in (log.x, log.y))
    beyond = (times < log.t[0] - 1e-6) | (times > log.t[-1] + 1e-6)
    distance = np.where(beyond, np.nan, np.hypot(plan[0] - x, plan[1] - y))
    by_horizon = {h: distance[:, : round(h / STEP_S)] for h in {*HORIZONS_S, *MISS_M}}
    return {
        **{f"ade.{h}": d.mean(axis=1) for h, d in by_horizon.items()},
        **{f"fde.{h}": d[:, -1] for h, d in by_horizon.items()},
        **{f"farthest.{h}": d.max(axis=1) for h, d in by_horizon.items()},
    }


def _per_frame(
    trace: Trace, rows: Rows, value: Callable[[IntArray], float], *, missing: str = ""
) -> Series:
    """Return a series of the frames, from the places `(k,)` of each frame's alternatives."""
    starts = np.flatnonzero(np.diff(rows["frame"], prepend=-1))
    places = np.split(np.arange(len(rows["frame"])), starts[1:])
    values = np.array([value(place) for place in places])
    t = frame_times(trace)[rows["frame"][starts]]
    return Series(t, values, missing=missing) if missing else Series(t, values)


def chosen_place(rows: Rows, place: IntArray) -> int:
    """Return the place of the chosen alternative of a frame, -1 where none has a score."""
    scores = rows["score"][place]
    return -1 if np.isnan(scores).all() else int(place[np.nanargmax(scores)])


def _nearest(rows: Rows, place: IntArray) -> int:
    """Return the place of the alternative nearest to the log, -1 where none is known."""
    distances = rows[f"ade.{NEAREST_S}"][place]
    return -1 if np.isnan(distances).all() else int(place[np.nanargmin(distances)])


_alternatives_metric = partial(metric, modes=BOTH_LOOPS, needs="plans with alternatives")
_log_metric = partial(
    _alternatives_metric,
    better="lower",
    modes=(Mode.OPEN,),
    needs="plans with alternatives, a logged drive that lasts to the horizon after some frame",
)
_distance_metric = partial(
    _log_metric,
    unit="m",
    reductions=(MEAN, MAX, SHARE),
    parts=tuple(f"{h}s" for h in HORIZONS_S),
    parameters=(f"horizons {', '.join(map(str, HORIZONS_S))} s", f"step {STEP_S} s"),
    source="Argoverse and nuScenes prediction, minADE and minFDE over all K",
)


def _least(row: NDArray[Any]) -> Callable[[IntArray], float]:
    return lambda place: float(np.fmin.reduce(row[place]))


def _by_horizon(
    trace: Trace, scenario: Scenario, word: str, bounds: Mapping[int, float] | None = None
) -> Parts | Unavailable:
    """Return by horizon the least value of the alternatives; with bounds, whether all are beyond
    them.
    """
    rows = judged_alternatives(trace, scenario)
    if isinstance(rows, Unavailable):
        return rows
    parts: dict[str, Measured] = {}
    for h in HORIZONS_S if bounds is None else bounds:
        least = _per_frame(trace, rows, _least(rows[f"{word}.{h}"]))
        lasts = least.t + h <= scenario.ego.t[-1] + 1e-6
        if not lasts.any():
            parts[f"{h}s"] = Unavailable(f"the log ends less than {h} s after every frame")
            continue
        t, value = least.t[lasts], least.value[lasts]
        if bounds is not None:
            value = np.where(np.isnan(value), np.nan, value > bounds[h])
        parts[f"{h}s"] = Series(t, value, missing=f"every alternative ends before {h} s")
    return parts


@_distance_metric()
def min_ade(trace: Trace, scenario: Scenario) -> Parts | Unavailable:
    """Mean distance of the log from the alternative that is nearest by it, up to the horizon.

    Formula: min over the alternatives of mean_k |e_k|
    """
    return _by_horizon(trace, scenario, "ade")


@_distance_metric()
def min_fde(trace: Trace, scenario: Scenario) -> Parts | Unavailable:
    """Final distance of the log from the alternative that is nearest by it, at the horizon.

    Formula: min over the alternatives of |e_10h|
    """
    return _by_horizon(trace, scenario, "fde")


@_log_metric(
    unit="1",
    reductions=(RATE, SHARE),
    parts=tuple(f"{h}s" for h in MISS_M),
    parameters=tuple(f"bound at {h} s: {bound:g} m" for h, bound in MISS_M.items()),
)
def min_miss(trace: Trace, scenario: Scenario) -> Parts | Unavailable:
    """Share of the frames of which every alternative is anywhere up to the horizon farther from the
    log than the bound.

    Formula: 1 where min over the alternatives of max_k |e_k| > bound, else 0
    """
    return _by_horizon(trace, scenario, "farthest", MISS_M)


@_alternatives_metric(unit="count", better="none", reductions=(MEAN, MIN, MAX))
def alternatives(trace: Trace, scenario: Scenario) -> Measured:
    """Number of trajectories among which the planner chose.

    Formula: K
    """
    rows = judged_alternatives(trace, scenario)
    return rows if isinstance(rows, Unavailable) else _per_frame(trace, rows, len)


@_alternatives_metric(
    unit="m", better="none", reductions=(MEAN, MIN), parameters=(f"horizon {HORIZON_S:g} s",)
)
def alternatives_spread(trace: Trace, scenario: Scenario) -> Measured:
    """Mean distance of the alternatives from their mean, 4 s after the frame.

    Formula: mean over k of |p_k - mean of p|
    """
    rows = judged_alternatives(trace, scenario)
    if isinstance(rows, Unavailable):
        return rows

    def spread(place: IntArray) -> float:
        end = np.stack([rows["end_x"][place], rows["end_y"][place]])
        end = end[:, np.isfinite(end[0])]
        if not end.shape[1]:
            return np.nan
        return float(np.hypot(*(end - end.mean(axis=1, keepdims=True))).mean())

    missing = f"no alternative lasts {HORIZON_S:g} s"
    return _per_frame(trace, rows, spread, missing=missing)


_share_metric = partial(
    _alternatives_metric,
    unit="1",
    better="lower",
    reductions=(MEAN, MAX),
    parameters=(f"horizon {HORIZON_S:g} s", f"step {STEP_S:g} s"),
)


@_share_metric(needs="plans with alternatives, lanes in the log")
def alternatives_off_road(trace: Trace, scenario: Scenario) -> Measured:
    """Share of a frame's alternatives that lead more than 0.3 m farther off the road than at their
    start.

    Formula: mean over k of [off_k > 0.3 m], off as in plan_off_road
    """
    lanes, rows = known_lanes(scenario), judged_alternatives(trace, scenario)
    if isinstance(rows, Unavailable):
        return rows
    if isinstance(lanes, Unavailable):
        return lanes
    beyond = np.where(np.isnan(rows["off"]), np.nan, rows["off"] > OFF_ROAD_M)
    return _per_frame(trace, rows, lambda place: float(beyond[place].mean()))


@_share_metric()
def alternatives_contact(trace: Trace, scenario: Scenario) -> Measured:
    """Share of a frame's alternatives with a contact at fault with a road user as it then moved.

    Formula: mean over k of [plan_collision of k within 4 s]
    """
    rows = judged_alternatives(trace, scenario)
    if isinstance(rows, Unavailable):
        return rows
    touching = np.isfinite(rows["contact"])
    return _per_frame(trace, rows, lambda place: float(touching[place].mean()))


@_alternatives_metric(
    unit="1",
    better="lower",
    reductions=(MEAN, MAX, share_beyond(REGRET, "share_above_20pct")),
    needs="plans with scored alternatives",
)
def selection_regret(trace: Trace, scenario: Scenario) -> Measured:
    """How much better than the chosen alternative the best one is, by replan's score of a plan.

    Formula: max over k of score_k - score of the chosen, score as in plan_score
    """
    rows = judged_alternatives(trace, scenario)
    if isinstance(rows, Unavailable):
        return rows

    def regret(place: IntArray) -> float:
        chosen = chosen_place(rows, place)
        return np.nan if chosen < 0 else float(rows["worth"][place].max() - rows["worth"][chosen])

    return _per_frame(trace, rows, regret, missing="the alternatives have no scores")


@dataclass(frozen=True, eq=False, slots=True)
class Hits(Series):
    """(6) of each frame, with the probability of the chosen alternative."""

    probability: FloatArray = field(default_factory=partial(np.empty, 0))


def _calibration_error(series: Series) -> tuple[float, int]:
    """Return (7)."""
    assert isinstance(series, Hits)
    hit, probability = series.value[series.known], series.probability[series.known]
    places = np.minimum((probability * BINS).astype(int), BINS - 1)
    error = 0.0
    for b in np.unique(places):
        inside = places == b
        error += inside.mean() * abs(hit[inside].mean() - probability[inside].mean())
    return float(error), -1


_probability_metric = partial(
    _log_metric,
    unit="1",
    needs="plans with alternatives whose scores are probabilities, a logged drive that lasts "
    f"{NEAREST_S} s after some frame",
    parameters=(f"horizon {NEAREST_S} s", f"bins {BINS}"),
)
_NO_PROBABILITIES = f"no scores sum to 1, or the log ends less than {NEAREST_S} s after every frame"


def _probabilities(rows: Rows, place: IntArray) -> FloatArray | None:
    """Return the scores of a frame's alternatives, if they are probabilities."""
    scores: FloatArray = rows["score"][place]
    within = bool(((scores >= 0.0) & (scores <= 1.0)).all())
    return scores if within and abs(scores.sum() - 1.0) <= SUM_WITHIN else None


@_probability_metric(
    better="higher",
    reductions=(MEAN, Reduction("calibration_error", _calibration_error, direction="lower")),
    source="Guo et al. 2017, expected calibration error",
)
def nearest_chosen(trace: Trace, scenario: Scenario) -> Measured:
    """Share of the frames of which the chosen alternative is the nearest to the log, and how far
    that share is from the probabilities that the planner gave (calibration_error).

    Formula: 1 where the chosen has the least ADE at 3 s; sum over bins of n_b / n |hits - P|
    """
    rows = judged_alternatives(trace, scenario)
    if isinstance(rows, Unavailable):
        return rows

    def probability(place: IntArray) -> float:
        known = _probabilities(rows, place)
        return np.nan if known is None else float(known.max())

    def hit(place: IntArray) -> float:
        nearest = _nearest(rows, place)
        if nearest < 0 or _probabilities(rows, place) is None:
            return np.nan
        return float(chosen_place(rows, place) == nearest)

    hits = _per_frame(trace, rows, hit)
    of_chosen = _per_frame(trace, rows, probability).value
    return Hits(hits.t, hits.value, missing=_NO_PROBABILITIES, probability=of_chosen)


@_probability_metric(
    reductions=(MEAN,), source="Brier 1950; Argoverse, brier-minFDE has its largest term"
)
def brier(trace: Trace, scenario: Scenario) -> Measured:
    """Squared error of the alternatives' probabilities, of which the nearest to the log should have
    1 and the others 0.

    Formula: sum over k of (P_k - [k is the nearest])^2
    """
    rows = judged_alternatives(trace, scenario)
    if isinstance(rows, Unavailable):
        return rows

    def error(place: IntArray) -> float:
        probabilities, nearest = _probabilities(rows, place), _nearest(rows, place)
        if probabilities is None or nearest < 0:
            return np.nan
        return float(np.square(probabilities - (place == nearest)).sum())

    return _per_frame(trace, rows, error, missing=_NO_PROBABILITIES)
