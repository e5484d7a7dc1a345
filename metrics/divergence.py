"""How far a closed loop has parted from its log, and from when on the replay is weak evidence.

The others react to the log's ego. With the ego's place p(t), the logged q(t), speed v(t) and heading h(t):

(1) d(t) = |p - q|, along(t) = (p - q) . h, across(t) = (p - q) x h
(2) the drive has parted where |along| > max(v AWAY_S, `LENGTH_M`) or |across| > `WIDTH_M`, or where a road user is
    farther than `OFF_M` from where the log has it, or is there in one of them only

The replay is weak from the first such moment to the end of the drive. `AWAY_S`: a second of way is about the least gap
that drivers should keep (Germany fines less than 0.9 s), so that farther away the ego may be at another road user's
place; at low speed a car's length takes its part, across it a lane's width does. `OFF_M` is less than any of them, and
more than resampled tracks differ by.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from logs.kernel import BoolArray, FloatArray
from logs.scenario import Scenario
from logs.trace import Mode, Trace
from metrics.metric import COUNT, HAVING, MAX, Measured, Metric, Reduction, Series, Unavailable, counted
from metrics.others import each, name_of, some_at

AWAY_S, LENGTH_M, WIDTH_M = 1.0, 5.0, 3.5
OFF_M = 0.5
_NO_DRIVE = Unavailable("the log holds one ego state only: there is no drive to part from")


def _apart(trace: Trace, scenario: Scenario) -> tuple[FloatArray, FloatArray, FloatArray]:
    """d, along and across of (1) `(k,)`, NaN after the log's ego; along and across over their bounds of (2)."""
    drive, log = trace.ego, scenario.ego
    x, y, yaw, v = (np.interp(drive.t, log.t, column) for column in (log.x, log.y, log.yaw, log.v))
    dx, dy, c, s = drive.x - x, drive.y - y, np.cos(yaw), np.sin(yaw)
    lasts = np.where(drive.t <= log.t[-1] + 1e-6, 1.0, np.nan)
    along = (c * dx + s * dy) / np.maximum(np.abs(v) * AWAY_S, LENGTH_M)
    return np.hypot(dx, dy) * lasts, along * lasts, (c * dy - s * dx) / WIDTH_M * lasts


def _off(trace: Trace, scenario: Scenario) -> Iterator[tuple[str, BoolArray]]:
    """Of each agent of the log that is not where the log has it (2): its name, and when `(k,)`."""
    log, agents, t = scenario.tracks, trace.agents, trace.ego.t
    index = {name: i for i, name in enumerate(agents.ids)}
    for i, there, row in each(log, t) if agents is not log else ():
        at = index.get(log.ids[i], -1)
        off = there.there[row].copy()
        if at >= 0:
            here = some_at(agents, np.array([at]), t)
            both = here.there[0] & there.there[row]
            off = here.there[0] != there.there[row]
            off[both] = np.hypot(*(here.pose[:2, 0] - there.pose[:2, row])[:, both]) > OFF_M
        if off.any():
            yield name_of(log, i), off


def _divergence(trace: Trace, scenario: Scenario) -> Measured:
    return Series(trace.ego.t, _apart(trace, scenario)[0]) if len(scenario.ego) > 1 else _NO_DRIVE


def _weak(trace: Trace, scenario: Scenario) -> Measured:
    if len(scenario.ego) < 2:
        return _NO_DRIVE
    t, (_, along, across) = trace.ego.t, _apart(trace, scenario)
    ways = ("the ego along its way", np.abs(along) > 1.0), ("the ego across its way", np.abs(across) > 1.0)
    parted = {name: off for name, off in (*ways, *_off(trace, scenario)) if off.any()}
    first = min((int(np.argmax(off)) for off in parted.values()), default=len(t))
    why = "; ".join(name for name, off in parted.items() if off[first])
    weak = np.where(np.arange(len(t)) >= first, t, np.nan)
    return Series(t, weak, (why,) * len(t), "the drive never parts from the log")


def _displaced(trace: Trace, scenario: Scenario) -> Measured:
    return counted(trace.ego.t, ((int(np.argmax(off)), name) for name, off in _off(trace, scenario)))


FROM = Reduction("from", lambda series: (float(series.value[series.known][0]), int(np.argmax(series.known))))
_CLOSED = (Mode.CLOSED,)
DIVERGENCE = Metric(
    "divergence", "m", "none", _CLOSED, _divergence, (MAX,),
    "Distance between the ego and where the log has it at the same time, while the log's ego lasts.",
    formula="|p - q|", needs="a log that holds the ego's drive",
)  # fmt: skip
WEAK = Metric(
    "divergence_weak", "s", "none", _CLOSED, _weak,
    (FROM, Reduction("share", HAVING.reduce, unit="1", direction="none", empty=0.0)),
    "From when on the drive has parted from its log, so that the replay is weak evidence, and the share after that.",
    parameters=(
        f"along {AWAY_S:g} s of way, at least {LENGTH_M:g} m", f"across {WIDTH_M:g} m", f"a road user {OFF_M:g} m",
    ),
    formula=f"first t: |along| > max({AWAY_S:g} s v, {LENGTH_M:g} m) or |across| > {WIDTH_M:g} m or a road user off",
    needs="a log that holds the ego's drive",
)  # fmt: skip
DISPLACED = Metric(
    "displaced", "count", "none", _CLOSED, _displaced, (COUNT,),
    "Road users who were not where the log has them, each once: who gave way, and who was held up by them.",
    formula="number of road users farther than this from where the log has them", parameters=(f"{OFF_M:g} m",),
)  # fmt: skip
