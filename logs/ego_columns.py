"""Compares the ego's speed, acceleration, curvature and steering with its motion.

A log that states one of them beside poses states it twice. Over windows of about `WINDOW_S`, R is
what the motion shows, and S what the column states:

(1) speed         R = displacement along the heading        S = int v dt
(2) acceleration  R = change of the speed                   S = int a dt
(3) curvature     R = change of the heading                 S = int kappa v dt
(4) steering      R = change of the heading                 S = int v tan(steer) / wheelbase dt

(5) misfit = sum |R - S| / sum max(|R|, |S|), over the windows in which R or S exceeds `least`:
    0 for equal values, 0.72 for a factor of 3.6, 1 if one of them is 0, 2 for the other sign

A column contradicts the motion if its misfit exceeds `denied`. If one of its readings (another
sign, another unit, the radius for the curvature) then has a misfit below `fits`, the column is
converted; else, beyond `ignored`, it is left out, and derived from the motion. A note says either.
Between them nothing changes: `replan.metrics.health` reports speeds that are off by a tenth.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from replan.core.arrays import FloatArray, IntArray

WINDOW_S = 1.0
"""Duration of a window, s: within it, noise of poses and of derived speeds averages out."""
STEP_S = 2.0
"""Longest step within a window, s: the motion within a longer one is not known."""
ENOUGH = 3
"""Fewer windows show nothing."""
ASKEW = 0.3
"""Sine of the angle between heading and motion above which a window is askew."""
LEAST_M = 1.0
"""Least way in a window that can be askew, m."""
MOST_ASKEW = 0.3
"""If a larger share of the windows is askew, the headings are wrong, and no column is judged."""
PROPORTIONAL = 0.15
"""Misfit (5) of columns that are proportional to the motion."""
MOVES_MPS = 0.5
"""Slower cars do not show their curvature, m/s."""
LEAST_FACTOR = 1e-4
"""A column below this share of the motion is not in proportion to it."""
MOST_FACTOR = 1e4
"""A column above this share of the motion is not in proportion to it."""
MOST_STEER_RAD = 1.5
"""Angles beyond this count as it: the tangent has no meaning from 90 degrees on, rad."""

Readings = Mapping[str, Callable[[FloatArray, FloatArray], FloatArray]]
"""Other meanings of a column, by name: functions of the column and the speed `(n,)`."""


def _times(factor: float) -> Callable[[FloatArray, FloatArray], FloatArray]:
    return lambda column, v: factor * column


def _inverse(column: FloatArray, v: FloatArray) -> FloatArray:
    return np.divide(1.0, column, out=np.zeros(len(column)), where=column != 0.0)


def _over_speed(column: FloatArray, v: FloatArray) -> FloatArray:
    return np.divide(column, v, out=np.zeros(len(column)), where=np.abs(v) > MOVES_MPS)


_SIGN: Readings = {"with the other sign": _times(-1.0)}
_STEERING_WHEELS = {f"the steering wheel's, {k} times as large": 1.0 / k for k in range(10, 22)}


@dataclass(frozen=True)
class EgoColumn:
    """A column that the motion shows, too.

    Attributes:
        word: The column in words; `shown_by` is what shows it.
        least: Windows in which R and S are smaller do not count, in the unit of R.
        denied: Misfit (5) from which the column contradicts the motion.
        fits: Misfit below which a reading fits.
        ignored: Misfit from which a column of no known reading is not used.
        readings: Other meanings of the column, by name.
        remedy: The settings that leave the column out, in words.
        keeps_scale: Whether a column in proportion to the motion is kept: the times may be wrong.
    """

    word: str
    shown_by: str
    least: float
    denied: float
    fits: float
    ignored: float
    readings: Readings
    remedy: str
    keeps_scale: bool = False


EGO_COLUMNS: Mapping[str, EgoColumn] = MappingProxyType(
    {
        "v": EgoColumn(
            word="speed",
            shown_by="positions",
            least=1.0,
            denied=0.3,
            fits=0.15,
            ignored=0.6,
            readings={
                **_SIGN,
                "in km/h": _times(1.0 / 3.6),
                "in mph": _times(0.44704),
                "in kn": _times(1852.0 / 3600.0),
                "in ft/s": _times(0.3048),
                "in cm/s": _times(0.01),
            },
            remedy='"-" under topics.speed or columns.v leaves it out',
            keeps_scale=True,
        ),
        "a": EgoColumn(
            word="acceleration",
            shown_by="speed",
            least=0.5,
            denied=0.8,
            fits=0.4,
            ignored=0.9,
            readings={**_SIGN, "in g": _times(9.80665), "in cm/s2": _times(0.01)},
            remedy='"-" under topics.acceleration or columns.a leaves it out',
        ),
        "kappa": EgoColumn(
            word="curvature",
            shown_by="headings",
            least=0.03,
            denied=0.8,
            fits=0.4,
            ignored=0.9,
            readings={
                **_SIGN,
                "as the radius": _inverse,
                "as the radius with the other sign": lambda column, v: -_inverse(column, v),
                "in degrees": _times(np.pi / 180.0),
                "as the yaw rate": _over_speed,
            },
            remedy='"-" under columns.kappa leaves it out',
        ),
        "steer": EgoColumn(
            word="steering angle",
            shown_by="headings",
            least=0.03,
            denied=0.8,
            fits=0.4,
            ignored=0.9,
            readings={
                **_SIGN,
                "in degrees": _times(np.pi / 180.0),
                "in degrees with the other sign": _times(-np.pi / 180.0),
                **{name: _times(share) for name, share in _STEERING_WHEELS.items()},
                **{
                    f"{name}, with the other sign": _times(-share)
                    for name, share in _STEERING_WHEELS.items()
                },
            },
            remedy='"-" under topics.steering or columns.steer leaves it out',
        ),
    }
)
"""The comparisons (1) to (4), by the name of the column."""


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows of a drive: first and last sample of each, `(k,)`, and the times `(n,)`, s."""

    t: FloatArray
    first: IntArray
    last: IntArray

    @classmethod
    def of(cls, t: FloatArray) -> Windows:
        """Split the times `(n,)`, s, into windows of `WINDOW_S` without a step over `STEP_S`."""
        ends = np.searchsorted(t, t + WINDOW_S - 1e-6)
        whole_until = np.append(np.flatnonzero(np.diff(t) > STEP_S), len(t) - 1)
        first, last, begin = list[int](), list[int](), 0
        while begin < len(t) - 1:
            end = max(int(ends[begin]), begin + 1)
            gap = int(whole_until[np.searchsorted(whole_until, begin)])
            if end <= gap:
                first.append(begin)
                last.append(end)
                begin = end
            else:
                begin = gap + 1
        return cls(t, np.array(first, np.int64), np.array(last, np.int64))

    def change(self, values: FloatArray) -> FloatArray:
        """Return the change of values `(n,)` within each window `(k,)`."""
        return values[self.last] - values[self.first]

    def integral(self, values: FloatArray) -> FloatArray:
        """Return the integral of values `(n,)` over each window `(k,)`; NaN with a NaN in it."""
        steps = 0.5 * np.diff(self.t) * (values[1:] + values[:-1])
        return np.array(
            [steps[begin:end].sum() for begin, end in zip(self.first, self.last, strict=True)]
        )


def misfit(shown: FloatArray, stated: FloatArray, least: float) -> float | None:
    """Return the misfit (5) of windows `(k,)`; None if fewer than `ENOUGH` of them show it."""
    size = np.maximum(np.abs(shown), np.abs(stated))
    used = (size > least) & np.isfinite(shown) & np.isfinite(stated)
    if np.count_nonzero(used) < ENOUGH:
        return None
    return float(np.abs(shown - stated)[used].sum() / size[used].sum())


def _scales(shown: FloatArray, stated: FloatArray) -> bool:
    """Return whether what is stated is in proportion to what is shown, `(k,)`."""
    known = np.isfinite(shown) & np.isfinite(stated)
    size = float((stated[known] ** 2).sum())
    factor = float((shown[known] * stated[known]).sum()) / size if size > 0.0 else 0.0
    if not LEAST_FACTOR < factor < MOST_FACTOR:
        return False
    scaled = misfit(shown, factor * stated, 0.0)
    return scaled is not None and scaled < PROPORTIONAL


def agreed(
    name: str,
    column: FloatArray,
    v: FloatArray,
    shown: FloatArray,
    integral: Callable[[FloatArray], FloatArray],
    notes: list[str],
) -> FloatArray:
    """Return a column `(n,)` as it agrees with the motion, with a note if it was changed.

    All NaN if it contradicts the motion and no reading fits. `shown` is R `(k,)`, and `integral`
    gives S of a column.
    """
    comparison = EGO_COLUMNS[name]
    off = misfit(shown, integral(column), comparison.least)
    if off is None or off < comparison.denied:
        return column
    readings = {name: read(column, v) for name, read in comparison.readings.items()}
    fits = {
        name: misfit(shown, integral(values), comparison.least) for name, values in readings.items()
    }
    known = {name: fit for name, fit in fits.items() if fit is not None}
    best = min(known, key=lambda name: known[name], default="")
    says = f"The ego's {comparison.word} contradicts its {comparison.shown_by} by {off:.0%}"
    if best and known[best] < comparison.fits:
        notes.append(
            f"{says}; read {best} it fits within {known[best]:.0%}, and is read so "
            f"({comparison.remedy})."
        )
        return readings[best]
    if off < comparison.ignored or (comparison.keeps_scale and _scales(shown, integral(column))):
        return column
    notes.append(f"{says} and is not used ({comparison.remedy}).")
    return np.full(len(column), np.nan)


def with_agreed_columns(
    columns: Mapping[str, FloatArray], notes: list[str]
) -> dict[str, FloatArray]:
    """Return the columns t, x, y, yaw, v, a, kappa `(n,)` of an ego as they agree with its poses.

    NaN where v, a and kappa are to be derived.
    """
    t, x, y, v = (columns[name] for name in ("t", "x", "y", "v"))
    windows, yaw = Windows.of(t), np.unwrap(columns["yaw"])
    if not len(windows.first):
        return dict(columns)
    middle = 0.5 * (yaw[windows.first] + yaw[windows.last])
    dx, dy = windows.change(x), windows.change(y)
    along = dx * np.cos(middle) + dy * np.sin(middle)
    across = dy * np.cos(middle) - dx * np.sin(middle)
    askew = np.abs(across) > ASKEW * np.hypot(dx, dy)
    if (askew & (np.hypot(dx, dy) > LEAST_M)).mean() > MOST_ASKEW:
        return dict(columns)
    if along.sum() > 0.0:  # a drive backward states no sign of its speed
        v = agreed("v", v, v, along, windows.integral, notes)
    a = agreed("a", columns["a"], v, windows.change(v), windows.integral, notes)
    kappa = agreed(
        "kappa",
        columns["kappa"],
        v,
        windows.change(yaw),
        lambda values: windows.integral(values * v),
        notes,
    )
    return {**columns, "v": v, "a": a, "kappa": kappa}


def speed_along(t: FloatArray, x: FloatArray, y: FloatArray, yaw: FloatArray) -> FloatArray:
    """Return backward differences of the position along the heading `(n,)`, m/s.

    The first state has the speed of the second one; a single state stands.
    """
    if len(t) < 2:
        return np.zeros(len(t))
    v = (np.diff(x) * np.cos(yaw[1:]) + np.diff(y) * np.sin(yaw[1:])) / np.diff(t)
    return np.r_[v[:1], v]


def agreed_steering(
    t: FloatArray,
    steer: FloatArray,
    motion: tuple[FloatArray, FloatArray],
    wheelbase: float,
    notes: list[str],
) -> FloatArray:
    """Return the steering angles `(n,)`, rad, as they agree with the motion (4).

    `motion` has speed and heading at the times t `(n,)`, s; `wheelbase` is in m.
    """
    v, yaw = motion
    windows = Windows.of(t)
    if not len(windows.first):
        return steer
    return agreed(
        "steer",
        steer,
        v,
        windows.change(yaw),
        lambda values: windows.integral(
            v * np.tan(np.clip(values, -MOST_STEER_RAD, MOST_STEER_RAD)) / wheelbase
        ),
        notes,
    )
