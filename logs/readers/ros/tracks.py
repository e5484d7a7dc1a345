"""Samples of objects as tracks: one box, kind and front for each agent, and how they move where the log does not say.

A log has a box of its own in each frame, a Scenario one for each agent: the median of its sizes, and the kind that it
had most often.
"""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import numpy as np

from logs.agents import USUAL_SIZE_M, AgentKind
from logs.kernel import FloatArray, IntArray
from logs.readers.ros.motion import AGENT_WINDOW_S, OBJECT_WINDOW_S, rates, spread
from logs.readers.ros.objects import MOVES_MPS, Samples, firsts
from logs.scenario import Tracks

NOISE_M = {
    AgentKind.PEDESTRIAN: 0.07, AgentKind.BICYCLE: 0.07, AgentKind.MOTORCYCLE: 0.17, AgentKind.TRUCK: 0.17,
    AgentKind.BUS: 0.17,
}  # fmt: skip
NOISE_OTHERS_M, NOISES = 0.1, 2.0
"""Noise of box centres (root mean square in the 13 drives of Tartu); a derived velocity counts from so many times the
standard deviation that follows on: who was seen twice 0.1 s apart is not yet known to move."""
EGO_WITHIN_M, EGO_LEAST_S = 1.0, 1.0
"""A track whose centre stays so near the ego's for so long while the ego drives is the ego."""


def tracks_of(samples: Samples, t: FloatArray, said: list[str]) -> Tracks:
    """The samples as tracks; t `(k,)` s are the times of their messages."""
    if not len(samples):
        return Tracks.empty()
    names = np.array(samples.names, dtype=object).astype(str)
    _, first_seen, codes = np.unique(names, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first_seen, kind="stable"), kind="stable")
    codes = rank[codes]
    order = np.lexsort((samples.message, codes))
    twice = np.r_[False, (np.diff(codes[order]) == 0) & (np.diff(samples.message[order]) == 0)]
    if twice.any():
        said.append(f"{int(twice.sum())} samples repeat an id within a frame: the first counts.")
    order = order[~twice]
    some, codes = samples.taken(order), codes[order]
    first = firsts(codes)
    offsets = np.append(np.unique(first), len(codes))
    seconds = t[some.message]
    parts = [slice(*ends) for ends in pairwise(offsets)]
    kinds = tuple(Counter(some.kinds[part]).most_common(1)[0][0] for part in parts)
    yaw, length, width = _aligned(some, parts)
    yaw = _one_front(yaw, some, seconds, parts, kinds, said)
    sizes = _median_sizes(length, width, kinds, parts, said)
    vx, vy = _filled(some, seconds, first, kinds, np.diff(offsets), said)
    return Tracks(
        tuple(names[order[offsets[:-1]]].tolist()), kinds, *sizes, np.zeros(len(parts), np.bool_), offsets, seconds,
        some.x, some.y, yaw, vx, vy,
    )  # fmt: skip


def _aligned(samples: Samples, parts: list[slice]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Headings and sizes of rectangles around outlines, which may lie on any of four sides: each as the one before."""
    yaw, length, width = samples.yaw.copy(), samples.length.copy(), samples.width.copy()
    for part in parts:
        for i in range(part.start + 1, part.stop):
            if samples.turned[i] and samples.turned[i - 1]:
                turns = round((yaw[i - 1] - yaw[i]) / (0.5 * np.pi))
                yaw[i] += 0.5 * np.pi * turns
                if turns % 2:
                    length[i], width[i] = width[i], length[i]
    return yaw, length, width


def _one_front(
    yaw: FloatArray, samples: Samples, t: FloatArray, parts: list[slice], kinds: tuple[AgentKind, ...], said: list[str]
) -> FloatArray:
    """Headings of boxes whose front and back change places, so that none turns round from one sample to the next.

    The front is where an agent that moves goes, by most of its samples; of one that stands what most headings say.
    """
    out, turned = yaw.copy(), 0
    for part, kind in zip(parts, kinds, strict=True):
        if kind is AgentKind.PEDESTRIAN or part.stop - part.start < 2:
            continue
        # by how many half turns each differs from the one before, summed up
        steps = np.round(np.diff(yaw[part]) / np.pi)
        half = np.r_[0.0, np.cumsum(steps)]
        if not (half % 2).any():
            continue
        own = yaw[part] - np.pi * half
        along = np.diff(samples.x[part]) * np.cos(own[1:]) + np.diff(samples.y[part]) * np.sin(own[1:])
        speed = along / np.diff(t[part])
        moves = np.abs(speed) > MOVES_MPS
        backward = np.sum(np.sign(speed[moves])) < 0 if moves.mean() > 0.5 else (half % 2).mean() > 0.5
        out[part] = own + (np.pi if backward else 0.0)
        turned += int(min((half % 2).sum(), len(half) - (half % 2).sum()))
    if turned:
        said.append(f"{turned} samples of objects have front and back exchanged and are turned round.")
    return out


def _median_sizes(
    length: FloatArray, width: FloatArray, kinds: tuple[AgentKind, ...], parts: list[slice], said: list[str]
) -> tuple[FloatArray, FloatArray]:
    out, assumed, varied = np.empty((2, len(parts))), 0, 0
    for k, part in enumerate(parts):
        for row, column in enumerate((length, width)):
            values = column[part][np.isfinite(column[part])]
            out[row, k] = np.median(values) if len(values) else USUAL_SIZE_M[kinds[k]][row]
            assumed += not len(values)
            varied += bool(len(values) and np.ptp(values) > 0.01)
    if assumed:
        said.append("Some objects have no size: that of their kind is assumed.")
    if varied:
        said.append("An agent's box is the median of its sizes, its kind the one that it had most often.")
    return out[0], out[1]


def _filled(
    samples: Samples, t: FloatArray, first: IntArray, kinds: tuple[AgentKind, ...], counts: IntArray, said: list[str]
) -> tuple[FloatArray, FloatArray]:
    """The logged velocities, and where there are none the motion over a backward window; a first sample has none."""
    missing = ~(np.isfinite(samples.vx) & np.isfinite(samples.vy))
    if not missing.any():
        return samples.vx, samples.vy
    windows = np.array([OBJECT_WINDOW_S if kind is AgentKind.OBJECT else AGENT_WINDOW_S for kind in kinds])
    values = np.array([samples.x, samples.y])
    found = rates(t, values, first, np.repeat(windows, counts), parabola=False)[0]
    noise = np.repeat([NOISE_M.get(kind, NOISE_OTHERS_M) for kind in kinds], counts)
    explained = NOISES * noise >= np.hypot(*found) * spread(t, first, np.repeat(windows, counts))
    found = np.where(explained, 0.0, found)
    said.append(
        f"Velocities of objects ({missing.mean():.0%} of the samples) are derived from their positions in the last"
        f" {AGENT_WINDOW_S} s, of what is no road user in the last {OBJECT_WINDOW_S:g} s; what the noise of positions"
        " explains is a stand."
    )
    return np.where(missing, found[0], samples.vx), np.where(missing, found[1], samples.vy)


def without_ego(tracks: Tracks, t: FloatArray, x: FloatArray, y: FloatArray, said: list[str]) -> Tracks:
    """The tracks but for one that is the ego's own box; x, y `(n,)` are the ego's box centre at t, s."""
    if not len(tracks) or np.hypot(x - x[0], y - y[0]).max() < 10.0 * EGO_WITHIN_M:
        return tracks
    keep = np.ones(len(tracks.t), np.bool_)
    for i in range(len(tracks)):
        part = tracks.samples(i)
        own = tracks.t[part]
        inside = (own >= t[0]) & (own <= t[-1])
        if not inside.any() or np.ptp(own[inside]) < EGO_LEAST_S:
            continue
        away = np.hypot(np.interp(own, t, x) - tracks.x[part], np.interp(own, t, y) - tracks.y[part])[inside]
        travelled = np.ptp(np.interp(own[inside], t, x)) + np.ptp(np.interp(own[inside], t, y))
        if away.max() < EGO_WITHIN_M and travelled > 5.0 * EGO_WITHIN_M:
            keep[part] = False
            said.append(f"Object {tracks.ids[i]} is the ego itself and is left out.")
    return tracks if keep.all() else tracks.taken(keep)
