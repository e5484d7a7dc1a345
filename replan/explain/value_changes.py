"""Values of two drives side by side: how much they differ, and that in words."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from math import inf, log10
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from replan.core.arrays import BoolArray, FloatArray

TOLERANCE = 1e-3
"""Tolerance in m, rad, m/s, and pedal positions, 0 to 1: a millimetre is less than any metric
resolves.
"""
FINE = 1e-8
"""In the same units.

Just above rounding (1e-9 m in the grid of a city), so that causes are separated from effects.
"""


class Change(NamedTuple):
    """A value that differs: the size of the difference (inf for words), its description, and the
    agent that it is about.
    """

    size: float
    describe: Callable[[], str]
    agent: str = ""


Changes = Iterator[Change]


def worded(sentence: str, agent: str = "") -> Change:
    """A difference that is no number."""
    return Change(inf, partial(str, sentence), agent)


def sizes(one: FloatArray, two: FloatArray) -> FloatArray:
    """Absolute differences `(n,)`; inf if only one value is a number."""
    same: BoolArray = (one == two) | (np.isnan(one) & np.isnan(two))
    with np.errstate(invalid="ignore"):
        sizes = np.abs(two - one)
    return np.where(same, 0.0, np.where(np.isnan(sizes), inf, sizes))


def largest(
    one: FloatArray,
    two: FloatArray,
    label_of: Callable[[int], str],
    unit: str,
    agents: Sequence[str] | NDArray[np.str_] = (),
) -> Changes:
    """The largest difference of two columns; `agents`: the agent that each row is about."""
    if len(one) != len(two):
        yield worded(f"{len(one)} -> {len(two)} values")
    elif len(one):
        size = sizes(one, two)
        row = int(np.argmax(size))
        if size[row] > FINE:
            describe = partial(numbers, label_of(row), one[row], two[row], unit)
            yield Change(float(size[row]), describe, str(agents[row]) if len(agents) else "")


def curve(one: FloatArray, two: FloatArray, value: str, abscissa: str) -> Changes:
    """Curves `(n, 2)` of a value, m, over a time or station, formatted by `abscissa`: where both
    exist, then their ends.
    """
    if not len(one) or not len(two):
        if len(one) != len(two):
            yield worded(f"{value}: {'none' if len(two) == 0 else 'there now'}")
        return
    if one.shape == two.shape:
        x, before, after = one[:, 0], one[:, 1], two[:, 1]
    else:
        x = one[(one[:, 0] >= two[0, 0]) & (one[:, 0] <= two[-1, 0]), 0]
        before, after = (np.interp(x, *curve.T) for curve in (one, two))
    differences = list(
        largest(before, after, lambda i: f"{value} at {abscissa.format(float(f'{x[i]:.4g}'))}", "m")
    )
    yield from differences
    if one.shape != two.shape and not any(change.size > TOLERANCE for change in differences):
        ends = " -> ".join(abscissa.format(float(f"{curve[-1, 0]:.4g}")) for curve in (one, two))
        yield worded(f"{value} ends at {ends}")


def numbers(quantity: str, one: float, two: float, unit: str) -> str:
    """Both values with as many digits as show that they differ."""
    size = abs(two - one)
    digits = int(np.clip(1 - np.floor(log10(size)), 2, 9)) if 0.0 < size < inf else 2
    return f"{quantity} {one:.{digits}f} -> {two:.{digits}f}{f' {unit}' if unit else ''}"
