"""How well tracks show the road users that there were: HOTA, IDF1, errors, ghosts, lost ones.

HOTA (Luiten et al., IJCV 129, 2021) with the similarity 1 - distance / 2 m; IDF1 (Ristani et al.,
2016) within 1 m.

    python tests/support/track_score.py LOG ...

degrades each log as a detector would, repairs it and prints the scores.
"""

import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment

from replan.core.arrays import BoolArray, FloatArray, IntArray
from replan.logs.agents import AgentKind
from replan.logs.catalogue.detector import Sight, detected, sight
from replan.logs.readers import read_log
from replan.logs.repair.detections import Detections
from replan.logs.repair.offline import repair
from replan.logs.repair.tracker import Tracked
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.tracks import Tracks

REACH_M, NEAR_M = 2.0, 15.0
LEAST_FRAMES = 10
"""Who is in sight for fewer frames need not be found."""
FOUND, SEEN = 0.3, 3
"""A road user found in a smaller share of its frames is lost; a track that is one for less is a
ghost. One detected less often cannot be found; one found in a smaller share of the frames in which
it was detected is missed."""


@dataclass(frozen=True)
class Score:
    hota: float
    idf1: float
    position: float
    still: float
    moving: float
    tracks: int
    users: int
    ghosts: int
    lost: int
    lost_near: int
    missed_near: int


@dataclass(frozen=True, eq=False)
class Points:
    """Who is where: frame, number, x, y, vx, vy, `(m,)` each."""

    frame: IntArray
    who: IntArray
    xy: FloatArray
    v: FloatArray

    @property
    def count(self) -> int:
        return int(self.who.max(initial=-1)) + 1


def true_points(scenario: Scenario, seen: Sight) -> tuple[Points, Points]:
    """Those in sight for long enough; and whoever need not be found, as others hide them they are
    no road users or not there for long."""
    visible = np.bincount(seen.agent[~seen.hidden], minlength=len(scenario.tracks)) >= LEAST_FRAMES
    users = np.array([kind is not AgentKind.OBJECT for kind in scenario.tracks.kinds])
    asked = (visible & users)[seen.agent] & ~seen.hidden
    return _points(seen, asked), _points(seen, ~asked)


def _points(seen: Sight, keep: BoolArray) -> Points:
    rows = np.flatnonzero(keep)
    who = np.unique(seen.agent[rows], return_inverse=True)[1]
    return Points(seen.frame[rows], who, np.c_[seen.x, seen.y][rows], np.c_[seen.vx, seen.vy][rows])


def found_points(tracks: Tracks, frames: FloatArray, extended: FloatArray) -> Points:
    """The measured samples of tracks at the frames."""
    who = np.repeat(np.arange(len(tracks)), np.diff(tracks.offsets))[~extended]
    frame = np.searchsorted(frames, tracks.t[~extended] - 1e-6)
    return Points(
        frame, who, np.c_[tracks.x, tracks.y][~extended], np.c_[tracks.vx, tracks.vy][~extended]
    )


def _asked(true: Points, found: Points, other: Points) -> Points:
    """What was found but for those that show `other`, and none of the true ones: they count neither
    way.
    """
    keep = np.ones(len(found.who), np.bool_)
    for k in np.unique(other.frame).tolist():
        _, rows, s = _similar(true, found, k)
        b = np.flatnonzero(other.frame == k)
        elsewhere = np.linalg.norm(other.xy[b][:, None] - found.xy[rows], axis=2).min(
            axis=0, initial=np.inf
        )
        best = s.max(axis=0, initial=0.0)
        keep[rows] = (best >= 0.5) | (elsewhere > 0.5 * REACH_M)
    some = np.flatnonzero(keep)
    who = np.unique(found.who[some], return_inverse=True)[1]
    return Points(found.frame[some], who, found.xy[some], found.v[some])


def score(true: Points, found: Points, near: FloatArray, seen: BoolArray) -> Score:
    """The score of what was found; `near` `(n,)`: how close each true one comes to the ego, m.

    `seen` `(m,)`: which of the true points the detector reported.
    """
    frames = range(int(max(true.frame.max(), found.frame.max(initial=0))) + 1)
    pairs = [_similar(true, found, k) for k in frames]
    potential = np.zeros((true.count, found.count))
    for a, b, s in pairs:
        whole = s.sum(axis=0)[None] + s.sum(axis=1)[:, None] - s
        np.add.at(
            potential,
            (true.who[a][:, None], found.who[b]),
            np.where(whole > 0.0, s / np.maximum(whole, 1e-9), 0),
        )
    of_true, of_found = np.bincount(true.who), np.bincount(found.who, minlength=found.count)
    union = of_true[:, None] + of_found
    jaccard = potential / np.maximum(union - potential, 1e-9)
    hota = []
    for alpha in np.arange(0.05, 0.99, 0.05):
        matched = np.zeros_like(potential)
        for a, b, s in pairs:
            one, two = linear_sum_assignment(
                -jaccard[true.who[a][:, None], found.who[b]] * s - 1e-6 * s
            )
            good = s[one, two] >= alpha - 1e-9
            np.add.at(matched, (true.who[a[one[good]]], found.who[b[two[good]]]), 1)
        hits = matched.sum()
        associated = (matched**2 / np.maximum(union - matched, 1)).sum() / max(hits, 1)
        hota.append(np.sqrt(associated * hits / (len(true.who) + len(found.who) - hits)))
    return _errors(true, found, near, seen, pairs, float(np.mean(hota)))


def _similar(true: Points, found: Points, frame: int) -> tuple[IntArray, IntArray, FloatArray]:
    a, b = np.flatnonzero(true.frame == frame), np.flatnonzero(found.frame == frame)
    away = np.linalg.norm(true.xy[a][:, None] - found.xy[b], axis=2)
    return a, b, np.clip(1.0 - away / REACH_M, 0.0, 1.0)


def _errors(
    true: Points, found: Points, near: FloatArray, seen: BoolArray, pairs: list, hota: float
) -> Score:
    same = np.zeros((true.count, found.count))
    one, two = [], []
    for a, b, s in pairs:
        np.add.at(same, (true.who[a][:, None], found.who[b]), s >= 0.5)
        i, j = linear_sum_assignment(-s)
        good = s[i, j] >= 0.5
        one.append(a[i[good]])
        two.append(b[j[good]])
    a, b = np.concatenate(one), np.concatenate(two)
    agreed = same[linear_sum_assignment(-same)].sum()
    apart = np.linalg.norm(true.xy[a] - found.xy[b], axis=1)
    off, speed = np.linalg.norm(true.v[a] - found.v[b], axis=1), np.linalg.norm(true.v[a], axis=1)
    lost = np.bincount(true.who[a], minlength=true.count) < FOUND * np.bincount(true.who)
    reported, both = (
        np.bincount(true.who[rows], minlength=true.count) for rows in (seen, a[seen[a]])
    )
    missed = (reported >= SEEN) & (both < FOUND * reported)
    matched = np.bincount(found.who[b], minlength=found.count)
    ghosts = matched < FOUND * np.bincount(found.who, minlength=found.count)

    def rms(values: FloatArray) -> float:
        return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0

    return Score(
        hota,
        float(2.0 * agreed / (len(true.who) + len(found.who))),
        rms(apart),
        rms(off[speed < 0.2]),
        rms(off[speed >= 0.2]),
        found.count,
        true.count,
        int(ghosts.sum()),
        int(lost.sum()),
        int((lost & (near < NEAR_M)).sum()),
        int((missed & (near < NEAR_M)).sum()),
    )


def tracked_points(found: Tracked, frames: FloatArray, true: Points, other: Points) -> Points:
    """Who a tracker reports at the frames, but for those that count neither way."""
    agents = [found.at(t) for t in frames.tolist()]
    names = [name for each in agents for name in each.ids]
    frame = np.repeat(np.arange(len(frames)), [len(each) for each in agents])
    xy = np.vstack([np.c_[each.x, each.y] for each in agents])
    v = np.vstack([np.c_[each.vx, each.vy] for each in agents])
    return _asked(true, Points(frame, np.unique(names, return_inverse=True)[1], xy, v), other)


def near_ego(true: Points, ego: Trajectory) -> FloatArray:
    """How close each true one comes to the way that the ego drives at any time `(n,)`, m."""
    way = np.c_[ego.x, ego.y][:: max(1, len(ego) // 200)]
    away = np.linalg.norm(true.xy[:, None] - way, axis=2).min(axis=1)
    out = np.full(true.count, np.inf)
    np.minimum.at(out, true.who, away)
    return out


def repaired_score(scenario: Scenario, seed: int) -> Score:
    """Of a clean log: degraded, repaired, scored."""
    found = detected(scenario.tracks, scenario.ego, seed)
    tracks, done = repair(found, scenario.ego, scenario.vehicle)
    seen = sight(scenario.tracks, scenario.ego)
    true, other = true_points(scenario, seen)
    points = _asked(true, found_points(tracks, seen.frames, done.extended), other)
    return score(true, points, near_ego(true, scenario.ego), reported(true, found))


def reported(true: Points, found: Detections) -> BoolArray:
    """Which of the true points a detection shows `(m,)`."""
    out = np.zeros(len(true.who), np.bool_)
    frame = np.searchsorted(found.frames, found.t)
    boxes = Points(frame, np.arange(len(frame)), np.c_[found.x, found.y], np.c_[found.vx, found.vy])
    for k in range(len(found.frames)):
        a, _, s = _similar(true, boxes, k)
        out[a] = s.max(axis=1, initial=0.0) >= 0.5
    return out


if __name__ == "__main__":
    for path in sys.argv[1:]:
        log = read_log(Path(path))
        for number in (1, 2):
            numbers = asdict(repaired_score(log, number))
            words = (f"{name} {round(value, 3)}" for name, value in numbers.items())
            sys.stdout.write(f"{log.name[:24]} {number} {' '.join(words)}\n")
