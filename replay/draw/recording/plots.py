"""Curves over time: speeds, accelerations, pedals, tracking errors, tyres, stage times.

Only what is in the trace, the scenario, the timings and the steps of the metrics, of which the jerk is one. A panel
without a finite value is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
import rerun as rr

from logs.frame_store import loaded
from logs.kernel import FloatArray
from logs.road import RoadSource
from logs.scenario import Scenario
from logs.states import Controls, Trajectory
from logs.trace import Mode, Trace
from metrics.comfort import LON_JERK_STATE
from replay.draw.recording import colours
from replay.draw.recording.columns import Instants, Tape
from replay.draw.recording.text import path_parts, plain
from replay.vehicle.tyre_use import tyre_use

if TYPE_CHECKING:
    from pandas import DataFrame

    from replay.drive import StageTime

JERK = LON_JERK_STATE.name


@dataclass(frozen=True, eq=False)
class Curve:
    """One curve of a panel.

    Attributes:
        name: An entity path part.
        legend: What the viewer shows.
        colour: Packed.
        t: `(n,)` s; `values` `(n,)`.
        width: Pixels.
        steps: Whether a value holds until the next.
        spiky: Whether the axis may cut off its rarest values.
    """

    name: str
    legend: str
    colour: int
    t: FloatArray
    values: FloatArray
    width: float = 1.5
    steps: bool = False
    spiky: bool = False


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves that share an axis.

    Attributes:
        entity: Parent of the curves.
        title: With the unit.
        curves: Those with a finite value.
        least_span: The axis is never shorter than this, so that a still curve looks still.
    """

    entity: str
    title: str
    curves: tuple[Curve, ...]
    least_span: float

    @property
    def y_range(self) -> tuple[float, float]:
        """The axis: all finite values (of spiky curves 96 in 100), some room, and at least two numbers on it."""
        shown = [(curve.values[np.isfinite(curve.values)], curve.spiky) for curve in self.curves]
        spans = [np.percentile(values, (2.0, 98.0) if spiky else (0.0, 100.0)) for values, spiky in shown]
        low, high = float(np.min(spans)), float(np.max(spans))
        middle, half = 0.5 * (low + high), 0.57 * max(high - low, self.least_span)
        return with_two_numbers(middle - half, middle + half)

    @property
    def corner(self) -> Corner:
        """Where the legend hides least of the curves: a corner of `CORNERS`, the first of the best."""
        (low, high), wide, tall = self.y_range, *LEGEND
        begin, end = min(curve.t[0] for curve in self.curves), max(curve.t[-1] for curve in self.curves)
        hidden: dict[Corner, float] = dict.fromkeys(CORNERS, 0.0)
        for curve in self.curves:
            x, y = (curve.t - begin) / max(end - begin, 1e-9), (curve.values - low) / (high - low)
            for corner in CORNERS:
                across = x > 1.0 - wide if "Right" in corner else x < wide
                room = tall * len(self.curves) + 0.05
                hidden[corner] += float(np.mean(across & (y > 1.0 - room if "Top" in corner else y < room)))
        return min(CORNERS, key=hidden.__getitem__)


Corner = Literal["RightTop", "RightBottom", "LeftTop", "LeftBottom"]
CORNERS: tuple[Corner, ...] = ("RightTop", "RightBottom", "LeftTop", "LeftBottom")
LEGEND = 0.16, 0.14
"""Width of a legend, and height of one of its rows, as shares of a panel of usual size."""
MOST_NUMBERS = 8.0
"""The viewer writes multiples of a power of ten along an axis, those that leave room: no more than this."""


def with_two_numbers(low: float, high: float) -> tuple[float, float]:
    """A range of values, made longer where the viewer would write fewer than two numbers along it."""
    step = 10.0 ** np.ceil(np.log10((high - low) / MOST_NUMBERS) - 1e-9)
    first, last = step * np.ceil(low / step - 1e-9), step * np.floor(high / step + 1e-9)
    if last > first:
        return low, high
    margin = 0.08 * step
    if last < first:  # none
        return float(last - margin), float(first + margin)
    above, below = first + step - high, low - (first - step)
    return (low, float(first + step + margin)) if above <= below else (float(first - step - margin), high)


def _panel(entity: str, title: str, curves: Iterable[Curve | None], least_span: float) -> Panel | None:
    kept = tuple(curve for curve in curves if curve is not None and np.isfinite(curve.values).any())
    return Panel(f"plots/{entity}", title, kept, least_span) if kept else None


def draw_panels(tape: Tape, panels: Iterable[Panel], frames: FloatArray) -> None:
    """Each curve an entity of its own; values that are not finite are gaps."""
    for panel in panels:
        for curve in panel.curves:
            entity = f"{panel.entity}/{curve.name}"
            mode = rr.components.InterpolationMode.StepAfter if curve.steps else None
            style = rr.SeriesLines(
                colors=[curve.colour], names=[curve.legend], widths=[curve.width], interpolation_mode=mode
            )
            tape.static(entity, style)
            values = np.where(np.isfinite(curve.values), curve.values, np.nan)
            tape.rows(entity, Instants.among(curve.t, frames), rr.Scalars.columns(scalars=values))


def _planned(trace: Trace, value: Callable[[Trajectory], FloatArray]) -> FloatArray:
    """What the plan in force says at each of `trace.ego.t`; NaN before the first plan."""
    out = np.full(len(trace.ego), np.nan)
    starts = np.searchsorted(trace.ego.t, np.array([frame.t for frame in trace.frames]) - 1e-9)
    stops = np.r_[starts[1:], len(out)]
    for frame, start, stop in zip(trace.frames, starts, stops, strict=True):
        path = loaded(frame.plan.trajectory)
        out[start:stop] = np.interp(trace.ego.t[start:stop], path.t, value(path))
    return out


def _measured(steps: DataFrame | None, metric: str) -> tuple[FloatArray, FloatArray]:
    """Times and values `(n,)` of a metric; none where it was not measured."""
    if steps is None:
        return np.empty(0), np.empty(0)
    mine = steps[steps["metric"] == metric]
    return mine["t_s"].to_numpy(np.float64), mine["value"].to_numpy(np.float64)


def _limits(trace: Trace, scenario: Scenario, times: FloatArray) -> FloatArray:
    """Speed limit of the lane that the ego is on, as the log has it; NaN elsewhere."""
    out = np.full(len(times), np.nan)
    if scenario.road.source is RoadSource.LANES:
        x, y = np.interp(times, trace.ego.t, trace.ego.x), np.interp(times, trace.ego.t, trace.ego.y)
        for i in range(len(times)):
            lanes = scenario.road.lanes_at(float(x[i]), float(y[i]))
            out[i] = next((lane.speed_limit for lane in lanes if lane.drivable), np.nan)
    return out


def _ahead(trace: Trace, value: Callable[[Trajectory], FloatArray], lag: float) -> tuple[FloatArray, FloatArray]:
    """At each time what the plan that is `lag` seconds old said of it: times `(k,)` and values `(k,)`."""
    plans = ((frame.t + lag, loaded(frame.plan.trajectory)) for frame in trace.frames)
    end = trace.ego.t[-1]
    said = [(t, np.interp(t, path.t, value(path))) for t, path in plans if t <= min(path.t[-1], end) + 1e-9]
    t, values = np.array(said, dtype=np.float64).reshape(-1, 2).T
    return t, values


def _plan_curves(trace: Trace, value: Callable[[Trajectory], FloatArray]) -> list[Curve]:
    """Closed loop: the plan in force. Open loop, where each plan starts at the log: what older plans foresaw."""
    yellow, violet = colours.SERIES[1], colours.SERIES[4]
    if not trace.frames:
        return []
    if trace.mode is Mode.CLOSED:
        return [Curve("plan", "plan", yellow, trace.ego.t, _planned(trace, value))]
    return [
        Curve(f"plan_{lag:.0f}s", f"plan {lag:.0f} s before", colour, *_ahead(trace, value, lag), 1.2)
        for lag, colour in ((1.0, yellow), (3.0, violet))
    ]


def motion_panels(trace: Trace, scenario: Scenario, times: FloatArray, steps: DataFrame | None = None) -> list[Panel]:
    """Speed, acceleration, jerk, pedals, steering and tracking errors, as far as they are known, until `times` end.

    `steps` are those of `metrics.series`; without them there is no jerk.
    """
    ego, log = trace.ego, scenario.ego.between(-np.inf, float(times[-1]))
    blue, _, red, *_, grey = colours.SERIES
    compared = trace.mode is Mode.CLOSED and len(log) > 1
    jerk = _measured(steps, JERK)
    speeds = [
        Curve("limit", "limit", red, times, _limits(trace, scenario, times), 1.0, steps=True),
        *([Curve("log", "log", grey, log.t, log.v, 1.0)] if compared else []),
        *_plan_curves(trace, lambda path: path.v),
        Curve("ego", "ego", blue, ego.t, ego.v, 2.0),
    ]
    accelerations = [
        Curve("jerk", "jerk", colours.with_alpha(red, 150), *jerk, 1.0, spiky=True),
        *([Curve("log", "log", grey, log.t, log.a, 1.0)] if compared else []),
        *_plan_curves(trace, lambda path: path.a),
        Curve("ego", "ego", blue, ego.t, ego.a, 2.0),
    ]
    panels = [
        _panel("speed", "Speed [m/s]", speeds, 2.0),
        _panel("acceleration", "Acceleration [m/s²], jerk [m/s³]", accelerations, 1.0),
        _panel("jerk", "Jerk in full", [Curve("ego", "jerk [m/s³]", red, *jerk)], 2.0),
        *_pedal_panels(trace, scenario),
        *_error_panels(trace),
        *_tyre_panels(trace, scenario),
    ]
    return [panel for panel in panels if panel]


def _pedal_panels(trace: Trace, scenario: Scenario) -> list[Panel | None]:
    """Throttle and brake, and steering: done, commanded, logged."""
    done, asked, log = trace.actuation, trace.commands, _until(scenario.controls, float(trace.ego.t[-1]))
    blue, yellow, red, green, *_, grey = colours.SERIES
    dim = {colour: colours.with_alpha(colour, 120) for colour in (red, green, blue)}
    pedals = (
        Curve("throttle_command", "throttle asked", dim[green], asked.t, asked.throttle, 1.0) if asked else None,
        Curve("brake_command", "brake asked", dim[red], asked.t, asked.brake, 1.0) if asked else None,
        Curve("throttle", "throttle", green, done.t, done.throttle, 2.0) if done else None,
        Curve("brake", "brake", red, done.t, done.brake, 2.0) if done else None,
        Curve("throttle_log", "throttle log", grey, log.t, log.throttle, 1.0) if log else None,
        Curve("brake_log", "brake log", yellow, log.t, log.brake, 1.0) if log else None,
    )
    steer = (
        Curve("log", "log", grey, log.t, log.steer, 1.0) if log else None,
        Curve("command", "asked", dim[blue], asked.t, asked.steer, 1.0) if asked else None,
        Curve("ego", "ego", blue, done.t, done.steer, 2.0) if done else None,
    )
    return [
        _panel("pedals", "Throttle, brake [0..1]", pedals, 0.2),
        _panel("steer", "Steering [rad]", steer, 0.02),
    ]


def _until(some: Controls | None, end: float) -> Controls | None:
    """The samples not later than `end`."""
    if some is None:
        return None
    kept = some.t <= end
    return Controls(*(getattr(some, name)[kept] for name in ("t", "steer", "throttle", "brake")))


def _error_panels(trace: Trace) -> list[Panel | None]:
    errors = trace.tracking
    if errors is None:
        return []
    _, yellow, _, green, violet, teal, *_ = colours.SERIES
    across = (
        Curve("lateral", "lateral [m]", yellow, errors.t, errors.lateral),
        Curve("heading", "heading [rad]", teal, errors.t, errors.heading),
    )
    along = (
        Curve("station", "station [m]", violet, errors.t, errors.station),
        Curve("speed", "speed [m/s]", green, errors.t, errors.speed),
    )
    return [
        _panel("error_across", "Tracking error: across", across, 0.1),
        _panel("error_along", "Tracking error: along", along, 0.2),
    ]


def _tyre_panels(trace: Trace, scenario: Scenario) -> list[Panel | None]:
    """Slip angles and the share of the friction that is used."""
    if trace.actuation is None or len(trace.ego) < 2:
        return []
    blue, yellow, red, *_ = colours.SERIES
    use, t = tyre_use(trace.ego, trace.actuation, scenario.vehicle), trace.ego.t
    slips = (Curve("front", "front", blue, t, use.front), Curve("rear", "rear", yellow, t, use.rear))
    return [
        _panel("slip", "Tyre slip angles [rad]", slips, 0.02),
        _panel("friction", "Friction used [0..1]", [Curve("friction", "of the tyres", red, t, use.friction)], 0.2),
    ]


def stage_panel(timings: Sequence[StageTime]) -> Panel | None:
    """Milliseconds per stage; "total" is the whole plan."""
    parts = path_parts(timing.stage for timing in timings)
    curves = []
    for k, (stage, part) in enumerate(sorted(parts.items(), key=lambda item: item[0] != "total")):
        some = sorted((timing.t, timing.seconds) for timing in timings if timing.stage == stage)
        t, seconds = np.array(some).T
        colour, width = (colours.SERIES[-1], 2.0) if stage == "total" else (colours.SERIES[k % 7], 1.2)
        curves.append(Curve(part, plain(stage), colour, t, 1e3 * seconds, width, spiky=True))
    return _panel("stages", "Stage times [ms]", curves, 0.2)
