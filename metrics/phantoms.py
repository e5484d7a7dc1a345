"""Phantoms: boxes in which the logged ego stands, which therefore cannot have been there.

A box that reaches `DEEP_M` into the ego's while the ego was recorded at that place is no evidence of a contact. It is
left out from the last sample of its track that is `AROUND_S` before the overlap to the first that is as long after it;
a static one for good. Only recorded logs are excused. `without_phantoms` gives tracks that have gaps there
(`logs.observed`), for metrics as well as for the contact that ends a drive.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np

from logs.scenario import Scenario, Tracks
from logs.shapes import overlap
from metrics.boxes import ego_boxes
from metrics.once import once
from metrics.others import in_spans, name_of

AROUND_S = 1.0  # Before and after: more than `logs.observed.MAX_GAP_S`, so it is a gap of any track
GRID_S = 0.05
DEEP_M = 0.3  # So deep on every side a box is inside of the ego's: what only grazes it was near, not on it


@dataclass(frozen=True, slots=True)
class Phantom:
    """A box that the recorded ego stood in: id of the track, name with its kind, and between which times, s, it is out.

    Times may be -inf (from the begin) and inf (to the end).
    """

    agent: str
    name: str
    t_from: float
    t_to: float


@once
def phantoms(scenario: Scenario) -> tuple[Phantom, ...]:
    """Those of a recorded log, in order of tracks and time; none in any other."""
    if not scenario.is_recorded or not len(scenario.tracks):
        return ()
    ego, tracks = scenario.ego, scenario.tracks
    t = np.union1d(ego.t, np.arange(ego.t[0], ego.t[-1], GRID_S))
    boxes, car = ego_boxes(ego.resampled(t), scenario), scenario.vehicle
    found = []
    for i, steps, others in in_spans(tracks, t):
        size, pose, ego_box = others.size[0], others.pose[:3, 0], boxes[:3, steps]
        reach = 0.5 * (np.hypot(car.length, car.width) + np.hypot(*size))
        inside = others.there[0] & (np.hypot(pose[0] - ego_box[0], pose[1] - ego_box[1]) <= reach)
        for k in np.flatnonzero(inside):
            (x1, y1, yaw1), (x2, y2, yaw2) = ego_box[:, k], pose[:, k]
            inside[k] = overlap(x1, y1, yaw1, car.length - 2.0 * DEEP_M, car.width - 2.0 * DEEP_M, x2, y2, yaw2, *size)
        if not inside.any():
            continue
        sampled = np.empty(0) if tracks.static[i] else tracks.t[tracks.samples(i)]
        seen = t[steps][inside]
        for run in np.split(seen, np.flatnonzero(np.diff(seen) > 2.0 * AROUND_S) + 1):  # margins that meet are one run
            before, after = sampled[sampled <= run[0] - AROUND_S], sampled[sampled >= run[-1] + AROUND_S]
            begin, end = (float(before[-1]) if len(before) else -inf), (float(after[0]) if len(after) else inf)
            found.append(Phantom(tracks.ids[i], name_of(tracks, i), begin, end))
    return tuple(dict.fromkeys(found))


def without_phantoms(tracks: Tracks, found: tuple[Phantom, ...]) -> Tracks:
    """The tracks (known by their ids) less the samples of phantoms; with no phantoms, the same object."""
    if not found:
        return tracks
    owner = np.repeat(np.arange(len(tracks)), np.diff(tracks.offsets))
    keep = np.ones(len(tracks.t), np.bool_)
    for phantom in found:
        if phantom.agent in tracks.ids:
            mine = owner == tracks.ids.index(phantom.agent)
            keep &= ~(mine & (phantom.t_from < tracks.t) & (tracks.t < phantom.t_to))
    return tracks.taken(keep)
