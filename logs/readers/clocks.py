"""Reads the times of a table's rows, and tells rows in any order from a clock that starts again.

Times are numbers, dates, ISO 8601 texts, or times of day ("23:59:55.1"). Times of day, and seconds
of the day or the week, start again at midnight or at the week's end:

(1) the times lie in [0, P), P a day or a week, the largest gap between two of them is longer than P
    / 2, and the gap across P is at most `GAP_S` (any gap, for texts): the times before the largest
    gap are P later
(2) but not if the rows are in order of time

Rows may be in any order. If times go back in the order of the file, either the rows are unsorted,
or the clock started again, and rows of two drives would interleave. With W the way through the
rows, m, in the order of the file, and S the way through them in order of time:

(3) the clock started again if S - W > `SHUFFLED` W, and, if fewer than `FEW` of the steps go back,
    if S > W, or if one goes back by more than `STEPS` median steps and every road user is, after
    it, where it was before it: within `NEAR` times the way that 95 % of the steps do not exceed
(4) it also did if, in order of time, more than `BETWEEN` of the rows come alone between two rows
    that follow each other in the file, and are farther than `OFF` of the way between these two from
    the line between them (medians)
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from replan.core.arrays import FloatArray, IntArray
from replan.core.errors import LogError
from replan.logs.readers.admission import GAP_S

LAST_S = 9e9
"""Greatest time, s: about the greatest that fits into 64 bits of nanoseconds."""
PERIODS_S = {"midnight": 86400, "the end of the week": 7 * 86400}
"""Periods of clocks that start again, by the name of their end."""
SHUFFLED, FEW = 0.5, 0.1
STEPS, NEAR = 5.0, 3.0
BETWEEN, OFF = 0.25, 0.1
"""Constants of (3) and (4)."""
_TIME_OF_DAY = r"\d{1,2}:\d{2}:\d{2}(?:[.,]\d+)?"
_DATE, _ZONE = r"\d{4}[-/]\d", r":\d\d(?:[.,]\d+)?\s*(?:[Zz]|[+-]\d{2}(?::?\d{2})?)$"
GIVE_ZONE = (
    "give all times a zone (2024-05-03T10:00:00+02:00; in pandas: "
    "frame['t'].dt.tz_localize('Europe/Berlin')), or none of them"
)
"""Remedy for dates of which some have a time zone."""


def nanoseconds(column: pd.Series[Any], factor: float, topic: str) -> tuple[IntArray, bool]:
    """Return the times of a column `(n,)`, ns, and whether they are texts of times of day; LogError
    for others.

    The column has numbers (`factor` seconds per unit), dates (without a zone: UTC), durations, or
    texts (module docstring).
    """
    name = column.name
    if pd.api.types.is_datetime64_any_dtype(column) or pd.api.types.is_timedelta64_dtype(column):
        _check_all(column.notna(), f"{name} is not a time in every row", topic)
        is_date = pd.api.types.is_datetime64_any_dtype(column)
        return (pd.DatetimeIndex(column) if is_date else pd.TimedeltaIndex(column)).as_unit(
            "ns"
        ).asi8, False
    if not pd.api.types.is_numeric_dtype(column):
        numbers = pd.to_numeric(column.astype(object), errors="coerce")
        if numbers.isna().any() and numbers.isna().sum() != column.isna().sum():
            return _of_texts(column.astype(object), topic)
        column = numbers
    seconds = column.to_numpy(dtype=np.float64, na_value=np.nan) * factor
    _check_all(np.isfinite(seconds), f"{name} is not finite in every row", topic)
    if np.abs(seconds).max(initial=0.0) > LAST_S:
        raise LogError(f"{name} is beyond any clock", topic=topic, remedy="give its unit: [ns]")
    if pd.api.types.is_integer_dtype(column) and factor * 1e9 == round(factor * 1e9):
        return column.to_numpy().astype(np.int64) * round(factor * 1e9), False
    return np.round(seconds * 1e9).astype(np.int64), False


EPOCHS = (("ns", 1e17), ("us", 1e14), ("ms", 1e11))
"""Least time since 1970 in a unit: 1973."""
STEPS_OF = (("ns", 1e7), ("us", 1e4), ("ms", 10.0))
"""Least median step in a unit: a log has 100 states a second or fewer, and more than one in ten."""


def unit_of_times(values: FloatArray) -> str:
    """Return the unit of times `(n,)` without a stated one: "s", "ms", "us" or "ns"."""
    times = np.unique(values[np.isfinite(values)])
    if not len(times):
        return "s"
    size = float(np.median(np.abs(times)))
    step = float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    by_epoch = next((unit for unit, least in EPOCHS if size >= least), "")
    return by_epoch or next((unit for unit, least in STEPS_OF if step >= least), "s")


def names_zone(column: pd.Series[Any], topic: str) -> bool | None:
    """Return whether the dates of a column have a time zone; None for times that are no dates.

    LogError if some of them have one.
    """
    if pd.api.types.is_datetime64_any_dtype(column):
        return column.dt.tz is not None
    if pd.api.types.is_numeric_dtype(column) or pd.api.types.is_timedelta64_dtype(column):
        return None
    words = column.dropna().astype(str).str.strip()
    dates = words[words.str.match(_DATE)]
    if not len(dates):
        return None
    zoned = dates.str.contains(_ZONE)
    if zoned.any() and not zoned.all():
        problem = (
            f"{column.name} has dates with a time zone, and without: {dates[~zoned].iloc[0]!r}"
        )
        raise LogError(problem, topic=topic, remedy=GIVE_ZONE)
    return bool(zoned.all())


def check_zones(zones: Mapping[str, bool | None]) -> None:
    """Raise LogError if, of the tables by name, one has dates with a time zone and one has dates
    without: they would be hours apart.
    """
    without = next((name for name, zoned in zones.items() if zoned is False), None)
    zoned = next((name for name, zoned in zones.items() if zoned), None)
    if without is not None and zoned is not None:
        problem = f"its times have no time zone, those of {zoned} have one"
        raise LogError(problem, topic=without, remedy=GIVE_ZONE)


def _check_all(good: Any, what: str, topic: str) -> None:
    wrong = np.flatnonzero(~np.asarray(good, np.bool_))
    if len(wrong):
        raise LogError(f"{what}: row {wrong[0]}", topic=topic, remedy="leave such rows out")


def _of_texts(column: pd.Series[Any], topic: str) -> tuple[IntArray, bool]:
    """Return the times of texts, ns, and whether they are times of day."""
    _check_all(column.notna(), f"{column.name} is not a time in every row", topic)
    words = column.astype(str).str.strip()
    if words.str.fullmatch(_TIME_OF_DAY).all():
        return pd.TimedeltaIndex(pd.to_timedelta(words.str.replace(",", "."))).as_unit(
            "ns"
        ).asi8, True
    dates = pd.to_datetime(words.str.replace("/", "-"), format="ISO8601", utc=True, errors="coerce")
    wrong = np.flatnonzero(dates.isna())
    if len(wrong):
        problem = (
            f"{column.name} is neither a number nor a date and time in row {wrong[0]}: "
            f"{words.iloc[wrong[0]]!r}"
        )
        raise LogError(
            problem[:200],
            topic=topic,
            remedy="write seconds, ISO 8601 (2024-05-03T23:59:55), or HH:MM:SS",
        )
    return pd.DatetimeIndex(dates).as_unit("ns").asi8, False


def continued(
    ego: IntArray, agents: IntArray, *, is_text: bool, notes: list[str]
) -> tuple[IntArray, IntArray]:
    """Let the times of a log's rows, ns, run on over midnight (1) unless (2), with a note.

    `is_text`: they are texts of times of day.
    """
    every = np.unique(np.concatenate([ego, agents]))
    gaps = np.diff(every)
    if not len(gaps) or every[0] < 0:
        return ego, agents
    last = every[int(gaps.argmax())]
    if (np.diff(ego) >= 0).all() and ego.min() <= last < ego.max():
        return ego, agents
    for end, period_s in PERIODS_S.items():
        period = period_s * 10**9
        across = int(every[0]) + period - int(every[-1])
        if every[-1] < period < 2 * int(gaps.max()) and (is_text or across <= GAP_S * 1e9):
            notes.append(
                f"The clock starts again at {end}: the times after it are {period_s} s later than "
                "stated."
            )
            return ego + period * (ego <= last), agents + period * (agents <= last)
    return ego, agents


ROUNDED = 0.2
"""More equal times than this share are rounded, not repeated rows."""


def check_distinct(
    t: FloatArray, x: FloatArray, y: FloatArray, topic: str, names: Any = None
) -> None:
    """Raise LogError if two rows of one road user have the same time.

    `t` `(n,)`, s, does not decrease within a road user; other arguments as in `check_restart`.
    """
    same = np.diff(t) <= 0.0
    if names is not None:
        same &= names[1:] == names[:-1]
    if not same.any():
        return
    first = int(np.argmax(same))
    moves = np.hypot(np.diff(x), np.diff(y)) > 0.0
    if same.mean() > ROUNDED and np.ptp(t) > 0.0 and moves[same].mean() > 0.5:
        problem = (
            f"the times are rounded: {same.sum()} of {len(t)} rows have the time of another one"
        )
        remedy = (
            "write them with their decimals, not as 32-bit numbers; or count the rows: "
            'columns = {t = "frame [10 Hz]"}'
        )
        raise LogError(problem, topic=topic, remedy=remedy)
    problem = f"two rows have the time {t[first]:g} s"
    if names is not None:
        problem = f"agent {names[first]} has two rows at {t[first]:g} s"
    raise LogError(problem, topic=topic, remedy="keep one of them")


def check_restart(
    ns: IntArray, x: FloatArray, y: FloatArray, topic: str, names: Any = None
) -> None:
    """Raise LogError if the rows of a table are of several clocks (3), (4).

    `ns` are times in the order of the file `(n,)`; x and y positions, m, NaN where unknown; `names`
    the road user of each row (None: all rows are of one).
    """
    of = np.zeros(len(ns), np.int64) if names is None else np.unique(names, return_inverse=True)[1]
    filed, timed = np.argsort(of, kind="stable"), np.lexsort((ns, of))
    same = np.diff(of[filed]) == 0
    steps = np.diff(ns[filed])[same]
    back = steps < 0.0
    if not back.any():
        return
    distances_by_order = [
        np.hypot(np.diff(x[order]), np.diff(y[order]))[same] for order in (filed, timed)
    ]
    in_file, in_time = (float(np.nansum(distances)) for distances in distances_by_order)
    more, rounding = in_time - in_file, 1e-9 * (1.0 + in_file)
    is_few = back.mean() < FEW or back.sum() == 1
    is_far = -steps.min() > STEPS * float(np.median(np.abs(steps)))
    is_near = bool(
        (
            distances_by_order[0][back]
            <= NEAR * np.nanpercentile(distances_by_order[0], 95.0) + rounding
        ).all()
    )
    is_split = is_few and (more > rounding or (is_far and is_near))
    if more > SHUFFLED * in_file + rounding or is_split or _interleaves(ns, x, y, of, filed, timed):
        k = int(np.flatnonzero(same)[back.argmax()])
        before, row = int(filed[k]), int(filed[k + 1])
        owner = "" if names is None else f" of agent {names[row]}"
        problem = (
            f"t goes back at row {row}{owner} ({ns[before] / 1e9:.12g} to {ns[row] / 1e9:.12g} "
            "s): the clock restarts"
        )
        raise LogError(problem, topic=topic, remedy="split the file there")


def _interleaves(
    ns: IntArray, x: FloatArray, y: FloatArray, of: IntArray, filed: IntArray, timed: IntArray
) -> bool:
    """Return whether the rows, in order of time, alternate between two drives (4)."""
    run = np.empty(len(ns), np.int64)
    run[filed] = np.cumsum(np.r_[True, (np.diff(ns[filed]) < 0) | (np.diff(of[filed]) != 0)])
    before, middle, after = timed[:-2], timed[1:-1], timed[2:]
    alone = (
        (run[before] == run[after])
        & (run[middle] != run[before])
        & (of[middle] == of[before])
        & (ns[after] > ns[before])
    )
    if np.count_nonzero(alone) <= BETWEEN * len(ns):
        return False
    before, middle, after = before[alone], middle[alone], after[alone]
    share = (ns[middle] - ns[before]) / (ns[after] - ns[before])
    off = np.hypot(*(z[middle] - z[before] - share * (z[after] - z[before]) for z in (x, y)))
    distance = np.hypot(x[after] - x[before], y[after] - y[before])
    return bool(np.nanmedian(off) > OFF * np.nanmedian(distance) + 1e-6)
