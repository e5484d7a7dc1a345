"""What a reference driver sees: where the others are along its line and beside its band (`reference_drivers`)."""

from __future__ import annotations

from math import cos, hypot, sin

import numpy as np

from logs.kernel import BoolArray, FloatArray, inner_kernel, kernel
from logs.road import line_frame, line_project

NEAR_M, ASIDE_M = 150.0, 20.0
"""Who is farther ahead, or farther aside, is not looked at."""


@kernel
def look(
    knots: FloatArray, coef: FloatArray, k: int, s: float, l_ego: float, box: FloatArray, there: BoolArray,
    pose: FloatArray, size: FloatArray, vulnerable: BoolArray, out: FloatArray,
) -> None:  # fmt: skip
    """Fill per agent at step k what the driver sees of it, `(n, 7)`.

    Gap, u, lateral gap, lateral speed towards the band, extent along the line, whether it crosses, extent across.
    Gap is NaN for who is not there, too far, or not ahead. In the band the lateral gap is negative.
    """
    x, y = line_frame(knots, coef, s)[:2]
    for i in range(len(size)):
        out[i, 0] = np.nan
        if not there[i, k] or hypot(pose[0, i, k] - x, pose[1, i, k] - y) > NEAR_M:
            continue
        at, l = line_project(knots, coef, pose[0, i, k], pose[1, i, k], s, NEAR_M)  # noqa: E741
        yaw_r = line_frame(knots, coef, at)[2]
        turn, vx, vy = pose[2, i, k] - yaw_r, pose[3, i, k], pose[4, i, k]
        u, w = vx * cos(yaw_r) + vy * sin(yaw_r), vy * cos(yaw_r) - vx * sin(yaw_r)
        half = 0.5 * (size[i, 0] * abs(cos(turn)) + size[i, 1] * abs(sin(turn)))
        aside = 0.5 * (size[i, 0] * abs(sin(turn)) + size[i, 1] * abs(cos(turn)))
        side = l - l_ego
        ahead = at - s - box[0]
        if ahead <= 0.0 or abs(side) > ASIDE_M:
            continue
        out[i, 0] = ahead - half - 0.5 * box[1]
        out[i, 1] = max(u, 0.0)
        out[i, 2] = abs(side) - aside - 0.5 * box[2]
        out[i, 3] = -w if side > 0.0 else w
        out[i, 4] = 2.0 * half
        out[i, 5] = 1.0 if vulnerable[i] or abs(w) > abs(u) else 0.0
        out[i, 6] = 2.0 * aside


@inner_kernel
def comes_in(seen: FloatArray, v: float, box: FloatArray, slack: float, late: float) -> bool:
    """Whether who is beside the band will be in it before the ego is past it and, if it crosses, not out too early.

    `slack` s are given to the one, and `late` s less to both.
    """
    gap, u, aside, towards = seen[0], seen[1], seen[2], seen[3]
    if towards <= 0.0 or v <= u or gap < 0.0:
        return False
    enters = aside / towards
    passed = (gap + box[1] + seen[4]) / (v - u) + slack - late
    leaves = (aside + box[2] + seen[6]) / towards
    return enters < passed and not (seen[5] > 0.0 and leaves - late < gap / (v - u))
