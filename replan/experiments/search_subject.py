"""The subject of a falsification and its axes; their scales define a distance from the recorded
case.

The subject is a recorded log or a family of the catalogue; a point of the axes makes a scenario of
it. For a log, and for a family with a variation as an axis, every point is a varied log
(`replan.logs.edit.variations.varied`), even the recorded point: only the start of the ego's log is
kept. If all axes are parameters of a family, a point is the scenario that the family builds.

(1) u_i = (value_i - origin_i) / scale_i
(2) distance = sqrt(sum of u_i^2)

The origin is the recorded value: the neutral value of a variation, the default of a family's
parameter. An agent that was not recorded (`pedestrian`, `standing_car`, `copy`) has none: its
origin is the end HIGH of the range.

The scales are about the differences between two drives on two days (`SCALES`, docs/experiments.md):

    time, copy and *_s      1 s: a driver who notices late and reacts (UN R157, Annex 4, Appendix 3:
                            0.4 s + 0.75 s)
    speed, speeds           0.2 of the recorded one: of adults who cross, from the mean of 1.45 m/s
                            to the 15th
                            percentile of 1.15 m/s (Fitzpatrick et al., TCRP Report 112, 2006)
    ego_speed, ego speeds   0.1 of the recorded one: the excess that a speedometer may show (UN R39,
                            without its 4 km/h)
    side, lateral ways      0.375 m: the wandering zone in a lane of UN R157's careful driver
    ego_start, other ways   5 m: the length of a car
    pedestrian, standing_car  10 m: the distance that an ego at 36 km/h drives in 1 s
    *_mps2                  1 m/s2: of lifting the foot from the accelerator
    *_deg                   10 degrees;  *_percent  25, the step of Euro NCAP's overlaps
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.errors import ConfigError, LogError, unknown_name
from replan.experiments.ego_encounters import conflicting_agent
from replan.experiments.question import check_agents, vary_agents
from replan.experiments.recorded_log import opened, prepared
from replan.logs.catalogue.family import Family
from replan.logs.edit.variations import VARIATIONS, varied
from replan.logs.readers import LogSettings
from replan.logs.scenario import Scenario

FORM = "write it as NAME=LOW:HIGH, for example time=-3:3"
TIME_S, SPEED, EGO_SPEED = 1.0, 0.2, 0.1
LATERAL_M, ALONG_M, AHEAD_M = 0.375, 5.0, 10.0
ACCEL_MPS2, ANGLE_DEG, PERCENT = 1.0, 10.0, 25.0
SCALES: Mapping[str, float] = {
    "time": TIME_S,
    "copy": TIME_S,
    "speed": SPEED,
    "side": LATERAL_M,
    "ego_start": ALONG_M,
    "ego_speed": EGO_SPEED,
    "pedestrian": AHEAD_M,
    "standing_car": AHEAD_M,
}
"""Scales of the variations, by name."""
_LATERAL = (
    "lateral",
    "offset",
    "side",
    "intrusion",
    "kerb",
    "clearance",
    "room",
    "marking",
    "width",
    "swing",
)
"""Words in the names of parameters that are lateral distances."""
UNITS = {
    "s": "s",
    "m": "m",
    "deg": "deg",
    "mps": "m/s",
    "kmh": "km/h",
    "mps2": "m/s2",
    "percent": "%",
}
"""Units by the last part of a parameter's name."""
_BY_ENDING = {"s": TIME_S, "mps2": ACCEL_MPS2, "deg": ANGLE_DEG, "percent": PERCENT}
DEFAULT_RANGES: Mapping[str, tuple[float, float]] = {
    "time": (-3.0, 3.0),
    "speed": (0.5, 2.0),
    "ego_speed": (0.7, 1.3),
}
"""Default axes and ranges for a log; only `ego_speed` if it has no agents."""
MOST_AXES = 8
"""Largest number of axes: with more, 200 drives are too few."""


@dataclass(frozen=True)
class SearchAxis:
    """One direction of a search.

    Attributes:
        name: Name of a variation or of a family's parameter.
        low: Least value; `high` the greatest.
        origin: The recorded value.
        scale: The scale in (1), in the unit of the value, positive.
        unit: "1" for a factor.
        is_variation: Whether the name is in `VARIATIONS`; else it is a parameter of a family.
    """

    name: str
    low: float
    high: float
    origin: float
    scale: float
    unit: str
    is_variation: bool

    @property
    def label(self) -> str:
        """The name with its unit."""
        return self.name if self.unit == "1" else f"{self.name} [{self.unit}]"

    def shown(self, value: float) -> str:
        """The name with a value and its unit: "time -1.25 s"."""
        return f"{self.name} {value:.6g}" + ("" if self.unit == "1" else f" {self.unit}")


def box_of(axes: Sequence[SearchAxis]) -> FloatArray:
    """Least and greatest u of (1) for each axis, `(2, n)`."""
    ends = [[(end - axis.origin) / axis.scale for end in (axis.low, axis.high)] for axis in axes]
    return np.array(ends).T


def values_at(axes: Sequence[SearchAxis], point: Sequence[float]) -> dict[str, float]:
    """The values (1) of a point `(n,)`, within the ranges, by name."""
    return {
        axis.name: min(max(round(axis.origin + axis.scale * u, 9), axis.low), axis.high)
        for axis, u in zip(axes, point, strict=True)
    }


def search_axes(
    words: Sequence[str], scales: Sequence[str], family: Family | None, *, with_agents: bool
) -> tuple[SearchAxis, ...]:
    """The axes that `--axis` and `--scale` name; by default those of the subject.

    Args:
        words: "NAME=LOW:HIGH" each.
        scales: "NAME=VALUE" each: another scale of a named axis.
        family: The family that is searched, whose parameters may be axes; None: a log.
        with_agents: Whether the scenario has agents to vary.

    Raises:
        ConfigError: A word is not of this form, a name is unknown, duplicate, a choice or without a
            scale, a range does not contain the recorded value or is out of bounds, or there are too
            many axes.
    """
    ranges: dict[str, tuple[float, float]] = {}
    for word in words:
        name, _, text = word.partition("=")
        ends = _numbers(*text.split(":"))
        if len(ends) != 2 or not ends[0] < ends[1]:
            raise ConfigError(f"--axis {word}: {FORM}; LOW below HIGH")
        if name in ranges:
            raise ConfigError(f"--axis: an axis is named twice: {', '.join(words)}")
        ranges[name] = ends[0], ends[1]
    own_scales: dict[str, float] = {}
    for word in scales:
        name, _, text = word.partition("=")
        steps = _numbers(text)
        if not steps or not steps[0] > 0.0:
            raise ConfigError(f"--scale {word}: write it as NAME=VALUE with a positive value")
        own_scales[name] = steps[0]
    if not ranges and family is not None:  # the axes of its published grid, except choices
        for name, values in family.grid.items():
            default = family.parameters[name]
            if len(values) > 1 and _parameter_scale(name, default) is not None:
                ranges[name] = min(*values, default), max(*values, default)
    if not ranges:
        usual = DEFAULT_RANGES.items()
        ranges = {name: ends for name, ends in usual if with_agents or VARIATIONS[name].of == "ego"}
    for name in own_scales:
        if name not in ranges:
            raise unknown_name("axis (of --scale)", name, ranges)
    if len(ranges) > MOST_AXES:
        raise ConfigError(
            f"--axis: {len(ranges)} axes; at most {MOST_AXES} can be searched at once"
        )
    return tuple(_axis(name, *ends, own_scales.get(name), family) for name, ends in ranges.items())


def _axis(
    name: str, low: float, high: float, scale: float | None, family: Family | None
) -> SearchAxis:
    """One axis; ConfigError as `search_axes`."""
    parameters: Mapping[str, float] = {} if family is None else family.parameters
    if name in parameters:
        origin, ending = parameters[name], name.rpartition("_")[2]
        unit = UNITS.get(ending, "1")
        usual = _parameter_scale(name, origin)
        if scale is None and usual is None:
            raise ConfigError(
                f"--axis {name}: it has no scale by its name; say how large a step is: --scale "
                f"{name}=1"
            )
    elif name in VARIATIONS:
        variation = VARIATIONS[name]
        if variation.is_choice:
            raise ConfigError(
                f"--axis {name}: is a choice and has no distance; use replan vary --vary "
                f"{name}=0:1:2"
            )
        for value in (low, high):
            variation.check(value)
        origin, unit = (variation.neutral if isfinite(variation.neutral) else high), variation.unit
        usual = SCALES[name]
    else:
        raise unknown_name("axis", name, [*VARIATIONS, *parameters])
    if not low <= origin <= high:
        raise ConfigError(
            f"--axis {name}={low:g}:{high:g}: does not hold the recorded value, {origin:g}"
        )
    step = scale if scale is not None else usual
    assert step is not None
    return SearchAxis(name, low, high, origin, step, unit, name not in parameters)


def _numbers(*words: str) -> list[float]:
    """The finite numbers in words; empty if one of them is not a finite number."""
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        return []
    return numbers if all(map(isfinite, numbers)) else []


def _parameter_scale(name: str, default: float) -> float | None:
    """The scale of a family's parameter by the words of its name; None if they give none."""
    *words, ending = name.split("_")
    if ending in ("mps", "kmh"):
        share = EGO_SPEED if "ego" in words else SPEED
        return share * abs(default) if default else {"mps": 1.0, "kmh": 3.6}[ending]
    if ending == "m":
        return LATERAL_M if any(word in _LATERAL for word in words) else ALONG_M
    return _BY_ENDING.get(ending) if words else None


@dataclass(frozen=True, eq=False)
class SearchSubject:
    """The log or family that is searched.

    Attributes:
        scenario: The recorded scenario, or that of the family with its defaults; prepared for
            variations.
        family: The family; None for a log.
        agents: Ids of the varied agents; empty if there are none, or if the agent is inserted.
    """

    name: str
    scenario: Scenario
    family: Family | None = None
    agents: tuple[str, ...] = ()

    def of(self, agents: tuple[str, ...]) -> SearchSubject:
        """The subject with these agents varied."""
        return replace(self, agents=agents)

    @property
    def short_agents(self) -> tuple[str, ...]:
        """Short names of the varied agents."""
        return tuple(map(self.scenario.short_names, self.agents))

    def at(self, axes: Sequence[SearchAxis], values: Mapping[str, float]) -> Scenario:
        """The scenario with these values of the axes.

        Raises:
            LogError: There is no such scenario.
        """
        changes = {axis.name: values[axis.name] for axis in axes if axis.is_variation}
        parameters = {axis.name: values[axis.name] for axis in axes if not axis.is_variation}
        scenario = self.scenario
        if parameters:
            assert self.family is not None
            try:
                scenario = self.family.scenario(**parameters)
            except ConfigError as error:  # the family refuses the values: there is no such scenario
                raise LogError(str(error)) from None
            scenario = prepared(scenario) if changes else scenario
        return varied(scenario, self.agents, changes) if changes else scenario


def subject_of(name: str, settings: LogSettings) -> SearchSubject:
    """The log at a path or URL, or the family of a name.

    Errors as `replan.experiments.recorded_log.opened`.
    """
    scenario, family = opened(name, settings)
    return SearchSubject(name if family else scenario.name, scenario, family)


def agents_of(
    subject: SearchSubject, axes: Sequence[SearchAxis], named: Sequence[str]
) -> tuple[str, ...]:
    """The agents to vary: the named ones, otherwise the one in conflict with the ego, if an axis
    needs one.

    Raises:
        ConfigError: A named agent does not exist, or there is no agent.
    """
    short = subject.scenario.short_names
    agents = tuple(short.whole(word) for word in named)
    check_agents(agents, subject.scenario.tracks.ids)
    asks = vary_agents(axis.name for axis in axes if axis.is_variation)
    return agents if agents or not asks else (conflicting_agent(subject.scenario),)
