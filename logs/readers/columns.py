"""Columns of a table by replan's names and in its units.

`columns` maps replan's names to those of the table, with a unit in brackets if it differs: "heading
[deg]", "speed [km/h]" (`UNITS`), "frame [25 Hz]". A unit in the table's header is used, too: "v
[km/h]", "v (km/h)", "v_kmh".
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from replan.core.arrays import FloatArray, IntArray
from replan.core.errors import LogError
from replan.logs.log_settings import HEADINGS
from replan.logs.readers.clocks import names_zone, nanoseconds, unit_of_times
from replan.logs.readers.recorded import heading, is_unit

NAMES = ("ego", "agents")
NONE = "-"
"""Name of a column in the settings that means: use no column."""
DIMENSIONS = {
    "length": {"m": 1.0, "cm": 0.01, "mm": 0.001, "km": 1000.0, "ft": 0.3048},
    "angle": {"rad": 1.0, "deg": np.pi / 180.0, "mrad": 1e-3},
    "speed": {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704, "kn": 1852.0 / 3600.0, "ft/s": 0.3048},
    "acceleration": {"m/s2": 1.0, "g": 9.80665, "ft/s2": 0.3048},
    "curvature": {"1/m": 1.0},
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
    "share": {"1": 1.0, "%": 0.01},
}
UNITS = {"": 1.0} | {
    unit: factor for units in DIMENSIONS.values() for unit, factor in units.items()
}
"""Factor to replan's unit, by the unit in brackets after a column's name."""
SPELLINGS = {
    "mps": "m/s",
    "kmh": "km/h",
    "kph": "km/h",
    "km/hr": "km/h",
    "kmph": "km/h",
    "mps2": "m/s2",
    "m/s^2": "m/s2",
    "m/s\u00b2": "m/s2",
    "m/s/s": "m/s2",
    "ms2": "m/s2",
    "\u00b5s": "us",
    "\u03bcs": "us",
    "sec": "s",
    "msec": "ms",
    "usec": "us",
    "nsec": "ns",
    "degree": "deg",
    "degrees": "deg",
    "\u00b0": "deg",
    "radian": "rad",
    "radians": "rad",
    "meter": "m",
    "meters": "m",
    "metre": "m",
    "metres": "m",
    "seconds": "s",
    "m^-1": "1/m",
    "rad/m": "1/m",
    "per_m": "1/m",
    "knots": "kn",
    "percent": "%",
    "-": "1",
}
"""Other spellings of units."""
TIMES = {"t": "s", "t_ms": "ms", "t_us": "us", "t_ns": "ns"}
"""Replan's names of the time column, and their default units."""
QUATERNION = ("qx", "qy", "qz", "qw")
"""Columns of an orientation; `yaw` wins over them."""
COLUMNS = (
    "x",
    "y",
    "yaw",
    "v",
    "a",
    "kappa",
    "steer",
    "throttle",
    "brake",
    "driver",
    "id",
    "vx",
    "vy",
    "length",
    "width",
    "kind",
    "z",
    "height",
    *QUATERNION,
)
_DIMENSION = (
    dict.fromkeys(TIMES, "time")
    | dict.fromkeys(("x", "y", "z", "length", "width", "height"), "length")
    | dict.fromkeys(("yaw", "steer"), "angle")
    | dict.fromkeys(("v", "vx", "vy"), "speed")
    | dict.fromkeys(("throttle", "brake"), "share")
    | {"a": "acceleration", "kappa": "curvature"}
)
"""Dimension of each of replan's columns."""
_WITH_UNIT = re.compile(
    r"^(?P<name>.*?)\s*(?:\[(?P<unit>[^\]]*)\]|\((?P<unit2>[^)]*)\))\s*$", re.DOTALL
)
_RATE = re.compile(r"(\d+(?:\.\d+)?) ?(?:Hz|fps)", re.IGNORECASE)


class NamedColumns:
    """A data frame whose columns are found by replan's names."""

    def __init__(
        self, frame: pd.DataFrame, name: str, columns: Mapping[str, str], heading: str = ""
    ) -> None:
        self.frame, self.name, self.heading = frame, name, heading
        self._headers = [(str(header), header) for header in frame.columns]
        names_in_table = {
            ours: columns.get(f"{name}.{ours}", columns.get(ours, ours))
            for ours in (*TIMES, *COLUMNS)
        }
        self._columns = {
            ours: self._find_column(ours, name) for ours, name in names_in_table.items()
        }
        if not len(frame):
            raise LogError("the table has no rows", topic=name, remedy="give at least one")

    def _find_column(self, ours: str, given: str) -> tuple[Any, float, bool] | None:
        """Return the table's header of a column, the factor of its unit, and whether the unit is
        stated; None if there is no such column.

        The header is `given` (`NONE`: no column), or `given` without its unit, or followed by the
        header's own unit. If both have a unit, the units must be the same.
        """
        if given == NONE:
            return None
        name, asked = _split_unit(given)
        exact = [header for text, header in self._headers if text == given]
        whole = [header for text, header in self._headers if text == name]
        parts = [(header, *_split_unit(text)) for text, header in self._headers]
        short = [header for header, base, unit in parts if unit and base == name]
        short += [
            header for header, base, unit in _with_suffix(self._headers, ours) if base == name
        ]
        matches = list(dict.fromkeys(exact or whole or short))
        if not matches:
            return None
        if len(matches) > 1:
            problem = f"{name} may be {' or '.join(map(str, matches))}"
            raise LogError(
                problem, topic=self.name, remedy=f'name one: columns = {{{ours} = "{matches[0]}"}}'
            )
        held, header = "", str(matches[0])
        if exact or not whole:  # the unit in the header itself
            held = _split_unit(header)[1] or "".join(
                unit for _, _, unit in _with_suffix([(header, header)], ours)
            )
        factors = [self._factor(ours, unit, header) for unit in (asked, held) if unit]
        if len(set(factors)) > 1:
            raise LogError(
                f"{matches[0]} is asked for in [{asked}]",
                topic=self.name,
                remedy="leave that unit out",
            )
        factor = factors[0] if factors else UNITS[TIMES.get(ours, "")]
        return matches[0], factor, bool(factors)

    def _factor(self, ours: str, unit: str, header: str) -> float:
        """Return the factor from a unit of a column to replan's; LogError if it is not a unit of
        this column.
        """
        rate = _RATE.fullmatch(unit) if ours in TIMES else None
        if rate and float(rate[1]) > 0.0:
            return 1.0 / float(rate[1])
        plain = SPELLINGS.get(
            unit, SPELLINGS.get(unit.lower(), unit if unit in UNITS else unit.lower())
        )
        known = DIMENSIONS.get(_DIMENSION.get(ours, ""), {})
        if plain not in known:
            wrong = "is unknown" if plain not in UNITS else f"is none of {ours}"
            problem, names = f"the unit [{unit}] of {header} {wrong}", ", ".join(known) or "none"
            remedy = (
                f'known: {names}; another name is given as columns = {{{ours} = "NAME [unit]"}}'
            )
            raise LogError(problem, topic=self.name, remedy=remedy)
        return UNITS[plain]

    def has(self, ours: str) -> bool:
        """Return whether the table has this column."""
        return self._columns[ours] is not None

    def column(self, ours: str) -> tuple[pd.Series[Any], float]:
        """Return a column and the factor to replan's unit; LogError if the table has no such
        column.
        """
        header = self._columns[ours]
        if header is None:
            held = ", ".join(map(str, self.frame.columns[:12]))
            problem = f"the table has no column {ours}; it has {held}"
            remedy = f'name it: columns = {{{ours} = "its name [unit]"}}'
            if len(self.frame.columns) == 1:
                remedy = "separate the columns of the file by commas, semicolons or tabs"
            raise LogError(problem, topic=self.name, remedy=remedy)
        return self.frame[header[0]], header[1]

    def numbers(self, ours: str) -> FloatArray:
        """Return a column in replan's unit `(n,)`; NaN where it is empty."""
        column, factor = self.column(ours)
        try:
            return np.asarray(pd.to_numeric(column), dtype=np.float64) * factor
        except (ValueError, TypeError) as error:
            raise LogError(
                f"{column.name} is not a column of numbers: {error}", topic=self.name
            ) from None

    def yaw(self) -> FloatArray | None:
        """Return the headings `(n,)`, rad, of yaw, else of unit quaternions (or a LogError); None
        without either.
        """
        if self.has("yaw"):
            factor, offset = HEADINGS.get(self.heading, (1.0, 0.0))
            return offset + factor * self.numbers("yaw")
        if not all(map(self.has, QUATERNION)):
            return None
        turns = np.column_stack([self.numbers(name) for name in QUATERNION])
        wrong = np.flatnonzero(~is_unit(turns) & np.isfinite(turns).all(axis=1))
        if len(wrong):
            problem, remedy = (
                f"the quaternion of row {wrong[0]} is not of unit length",
                "check the order of its columns",
            )
            raise LogError(problem, topic=self.name, remedy=remedy)
        return heading(turns)

    def times(self, notes: list[str]) -> tuple[IntArray, bool]:
        """Return the time of each row `(n,)`, ns, and whether the times are texts of times of
        day.

        The unit of t is found by its steps if the table does not state it, with a note.
        """
        name = self._time_name()
        column, factor = self.column(name)
        header, _, is_stated = self._columns[name] or ("", 0.0, True)
        if name == "t" and not is_stated and pd.api.types.is_numeric_dtype(column):
            unit = unit_of_times(column.to_numpy(dtype=np.float64, na_value=np.nan))
            if unit != "s":
                notes.append(
                    f"The times of the {self.name} are taken for {unit}, by their steps "
                    f'(columns = {{"{self.name}.t" = "{header} [{unit}]"}} states it).'
                )
                factor = UNITS[unit]
        return nanoseconds(column, factor, self.name)

    def names_zone(self) -> bool | None:
        """Return whether the times are dates with a time zone; None if they are no dates."""
        return names_zone(self.column(self._time_name())[0], self.name)

    def _time_name(self) -> str:
        return next((name for name in TIMES if self.has(name)), "t")


def with_index(frame: pd.DataFrame, name: str, columns: Mapping[str, str]) -> pd.DataFrame:
    """Return a table with the named levels of its index as columns.

    An index of dates or durations is the column t, if the table has no other times.
    """
    if not len(frame):
        return frame
    levels = [level for level in frame.index.names if level is not None]
    levels = [level for level in levels if level not in frame.columns]
    whole = frame.reset_index(level=levels) if levels else frame
    is_time = isinstance(frame.index, pd.DatetimeIndex | pd.TimedeltaIndex)
    if is_time and not any(map(NamedColumns(whole, name, columns).has, TIMES)):
        return frame.assign(t=frame.index)
    return whole


def _split_unit(text: str) -> tuple[str, str]:
    """A header, and the unit in brackets behind it ("": none)."""
    match = _WITH_UNIT.match(text)
    return (match["name"], (match["unit"] or match["unit2"] or "").strip()) if match else (text, "")


def _with_suffix(headers: Sequence[tuple[str, Any]], ours: str) -> Iterator[tuple[Any, str, str]]:
    """Yield headers that end in a unit of the column ("speed_kmh"): header, text before the unit,
    unit.
    """
    known = DIMENSIONS.get(_DIMENSION.get(ours, ""), {})
    for text, header in headers:
        base, _, unit = text.rpartition("_")
        if base and SPELLINGS.get(unit.lower(), unit.lower()) in known:
            yield header, base, unit


def holds(header: Sequence[str], names: Sequence[str], columns: Mapping[str, str]) -> bool:
    """Return whether a table of agents with this header has the columns `names`."""
    if not header or len(set(header)) < len(header):
        return False
    try:
        table = NamedColumns(
            pd.DataFrame([[0] * len(header)], columns=list(header)), "agents", columns
        )
    except LogError:  # reading it would name the unit
        return False
    return all(map(table.has, names))


def check_names(columns: Mapping[str, str], frames: Mapping[str, pd.DataFrame | None]) -> None:
    """Raise LogError for unknown names, and for columns that no table has, which would silently be
    derived.
    """
    known = (*TIMES, *COLUMNS)
    held = [
        NamedColumns(frame, name, columns)
        for name, frame in frames.items()
        if frame is not None and len(frame)
    ]
    for key, names in columns.items():
        of, _, ours = key.rpartition(".")
        if ours not in known or of not in ("", *NAMES):
            problem = f"columns has {key}, which is not a known name"
            raise LogError(
                problem,
                topic="[log]",
                remedy=f"known: {', '.join(known)}; of one table: ego.v, agents.v ...",
            )
        if (
            names != NONE
            and held
            and not any(table.has(ours) for table in held if of in ("", table.name))
        ):
            raise LogError(
                f"no table has the column {names} that {key} is read from", topic="[log] columns"
            )
