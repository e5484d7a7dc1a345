"""The colours of a recording: packed 0xRRGGBBAA, readable on a dark and on a light background.

Contrast of two colours (WCAG 2.2), with the relative luminance L of sRGB:

(1) contrast = (L_light + 0.05) / (L_dark + 0.05)
(2) L        = 0.2126 R + 0.7152 G + 0.0722 B,  linear light: about (value / 255)^2.2
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind
from replan.logs.driving import DrivingMode
from replan.logs.plan import DecisionKind, PlanStatus

PackedArray = NDArray[np.uint32]

EGO = 0x4696FFFF
GHOST = 0xAAAAB4A0
PERCEIVED = 0x5AE6D2FF
SENSOR = 0x5AE6D270
REMOVED = 0xFF8C8C70
HIDDEN = 0xB4788C60
DP = 0xFFD750FF
QP = 0x46C8FFFF
FREE = 0x50C896FF
ALTERNATIVE = 0xE6C85AFF
HAPPENED = 0xFF5AD2FF
AXIS = 0xA0A4ACFF
GRID = 0x50545C90
TICK = 0x7E828AFF

SURFACE = 0x2A2C31FF
WALK = 0x34322EFF
EDGE = 0xD2D2D2FF
FAINT = 0x5F646CFF
MARKING = 0xB4B4B4FF
OPPOSITE = 0xE6BE3CFF
GOAL = 0x50D278FF
WORDS_LUMINANCE = 0.22
"""The largest luminance of text: its contrast to plates of 0.012 and 0.81 is above 3 (WCAG's least
for large text).
"""
GAMMA = 2.2

KINDS = {
    AgentKind.CAR: 0xF09632FF,
    AgentKind.TRUCK: 0xE16E3CFF,
    AgentKind.BUS: 0xD7785AFF,
    AgentKind.MOTORCYCLE: 0xC878DCFF,
    AgentKind.BICYCLE: 0xB482FAFF,
    AgentKind.PEDESTRIAN: 0xFF5A8CFF,
    AgentKind.OBJECT: 0x96968CFF,
}
DECISIONS = {
    DecisionKind.IGNORE: 0x8C919BFF,
    DecisionKind.NUDGE_LEFT: 0xAA8CFFFF,
    DecisionKind.NUDGE_RIGHT: 0xD796FFFF,
    DecisionKind.STOP: 0xFF463CFF,
    DecisionKind.FOLLOW: 0xFFAF3CFF,
    DecisionKind.YIELD: 0xF0645AFF,
    DecisionKind.OVERTAKE: 0x6ED278FF,
}
STATUSES = {
    PlanStatus.PLANNED: 0x3C8C50FF,
    PlanStatus.CORRECTED: 0x96A03CFF,
    PlanStatus.PREVIOUS: 0xC8961EFF,
    PlanStatus.COMFORTABLE_STOP: 0xD2691EFF,
    PlanStatus.HARD_STOP: 0xC83232FF,
    PlanStatus.REFUSED: 0x8C32C8FF,
}

DRIVERS = {
    DrivingMode.AUTONOMOUS: 0x3C8C50FF,
    DrivingMode.MANUAL: 0xC8961EFF,
    DrivingMode.STEERED: 0x5A8CA0FF,
    DrivingMode.PACED: 0x6478B4FF,
    DrivingMode.GIVEN_UP: 0xC83232FF,
    DrivingMode.UNKNOWN: 0x5A6478FF,
}

_RAMP_AT = np.array([0.0, 0.35, 0.65, 1.0])
_COST_RAMP = np.array(
    [[70, 110, 230], [40, 170, 170], [120, 205, 90], [255, 225, 60]], dtype=np.float64
)
_SPEED_RAMP = np.array(
    [[255, 70, 60], [255, 190, 60], [120, 220, 90], [60, 230, 170]], dtype=np.float64
)


def luminance(colour: int) -> float:
    """The relative luminance of a colour, (2)."""
    linear = [(((colour >> shift) & 255) / 255.0) ** GAMMA for shift in (24, 16, 8)]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def of_words(colour: int) -> int:
    """The colour, darkened to at most `WORDS_LUMINANCE`, for a label on a plate that is dark or
    light by theme.
    """
    share = min(1.0, (WORDS_LUMINANCE / max(luminance(colour), 1e-9)) ** (1.0 / GAMMA))
    red, green, blue = (round(share * ((colour >> shift) & 255)) for shift in (24, 16, 8))
    return (red << 24) | (green << 16) | (blue << 8) | (colour & 255)


def with_alpha(colour: int, alpha: int) -> int:
    """The colour with another opacity, 0 to 255."""
    return (colour & 0xFFFFFF00) | alpha


def darker(colour: PackedArray) -> PackedArray:
    """The colours at half their brightness, opaque: overlapping fills do not get denser."""
    return ((colour >> np.uint32(1)) & np.uint32(0x7F7F7F00)) | np.uint32(255)


def _ramp(anchors: FloatArray, u: FloatArray) -> PackedArray:
    red, green, blue = (np.interp(u, _RAMP_AT, anchors[:, k]).astype(np.uint32) for k in range(3))
    return np.asarray((red << 24) | (green << 16) | (blue << 8) | 255, dtype=np.uint32)


def of_cost(u: FloatArray) -> PackedArray:
    """Blue (0, cheap) over green to yellow (1, expensive)."""
    return _ramp(_COST_RAMP, u)


def of_speed(u: FloatArray) -> PackedArray:
    """Red (0, standing) over yellow to green (1, the fastest of the recording)."""
    return _ramp(_SPEED_RAMP, u)
