"""Whether a log's road users are tracks already: by what the log says of itself, whatever its format."""

from __future__ import annotations

import numpy as np

from logs.detections import Detections

STEP_S, FASTEST_MPS, JUMPS = 0.5, 60.0, 0.02
"""Ids are no identities if more than `JUMPS` of the steps of one id within `STEP_S` are faster than `FASTEST_MPS`, or
if so many boxes have an id that another box of their frame has."""
SHORT_S, FLICKER, LEAST_IDS = 1.0, 0.5, 10
"""Road users flicker if more than half of at least ten ids are seen for less than a second."""


def needs_repair(detections: Detections) -> str | None:
    """Why these detections must be repaired, in a sentence; None where they are tracks already."""
    if not len(detections):
        return None
    if not any(detections.ids):
        return "The log gives its detections no ids."
    codes = np.unique(np.array(detections.ids), return_inverse=True)[1]
    order = np.lexsort((detections.t, codes))
    same = np.diff(codes[order]) == 0
    dt = np.diff(detections.t[order])
    twice = int((same & (dt == 0.0)).sum())
    if twice > JUMPS * len(detections):
        return f"Ids of detections are no identities: {twice / len(detections):.0%} stand twice in a frame."
    near = same & (dt > 0.0) & (dt <= STEP_S)
    step = np.hypot(np.diff(detections.x[order]), np.diff(detections.y[order]))
    jumps = int((near & (step > FASTEST_MPS * np.maximum(dt, 0.02))).sum())
    if jumps > JUMPS * max(int(near.sum()), 1):
        return f"Ids of detections are no identities: {jumps} of {int(near.sum())} steps are jumps."
    times = detections.t[order]
    first = np.flatnonzero(np.r_[True, ~same])
    lives = times[np.r_[first[1:] - 1, len(times) - 1]] - times[first]
    short = int((lives < SHORT_S).sum())
    lasts = float(np.ptp(detections.frames)) >= 2.0 * SHORT_S
    if lasts and len(lives) >= LEAST_IDS and short > FLICKER * len(lives):
        return f"Road users flicker: {short} of {len(lives)} ids are seen for less than {SHORT_S:g} s."
    return None
