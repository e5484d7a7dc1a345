"""Whether a log's road users are tracks already: by what the log says of itself, whatever its format."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from logs.detections import Detections
from logs.kernel import FloatArray

STEP_S, FASTEST_MPS, JUMPS = 0.5, 60.0, 0.02
"""Ids are no identities if more than `JUMPS` of the steps of one id within `STEP_S` are faster than `FASTEST_MPS`, or
if so many boxes have an id that another box of their frame has."""
SHORT_S, FLICKER, LEAST_IDS = 1.0, 0.5, 10
"""Road users flicker if more than half of at least ten ids are seen for less than a second."""


def needs_repair(detections: Detections) -> str | None:
    """Why these detections must be repaired, in a sentence; None where they are tracks already."""
    if not any(detections.ids):
        return "The log gives its detections no ids." if len(detections) else None
    why = no_identities(detections.ids, detections.t, detections.x, detections.y)
    if why or np.ptp(detections.frames) < 2.0 * SHORT_S:
        return why
    codes = np.unique(np.array(detections.ids), return_inverse=True)[1]
    begin, end = np.full(codes.max() + 1, np.inf), np.full(codes.max() + 1, -np.inf)
    np.minimum.at(begin, codes, detections.t)
    np.maximum.at(end, codes, detections.t)
    short = int((end - begin < SHORT_S).sum())
    if len(begin) >= LEAST_IDS and short > FLICKER * len(begin):
        return f"Road users flicker: {short} of {len(begin)} ids are seen for less than {SHORT_S:g} s."
    return None


def no_identities(ids: Sequence[str], t: FloatArray, x: FloatArray, y: FloatArray) -> str | None:
    """Why the ids `(m,)` of boxes at times t `(m,)`, s, equal within a frame, name no objects throughout; else None."""
    codes = np.unique(np.array(ids), return_inverse=True)[1]
    order = np.lexsort((t, codes))
    same, dt = np.diff(codes[order]) == 0, np.diff(t[order])
    twice = int((same & (dt == 0.0)).sum())
    if twice > JUMPS * len(ids):
        return f"Ids of detections are no identities: {twice / len(ids):.0%} stand twice in a frame."
    near = same & (dt > 0.0) & (dt <= STEP_S)
    step = np.hypot(np.diff(x[order]), np.diff(y[order]))
    jumps = int((near & (step > FASTEST_MPS * np.maximum(dt, 0.02))).sum())
    if jumps > JUMPS * max(int(near.sum()), 1):
        return f"Ids of detections are no identities: {jumps} of {int(near.sum())} steps are jumps."
    return None
