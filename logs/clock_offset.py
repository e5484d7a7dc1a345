"""Finds road users on another clock than the ego's by a constant.

With d the first and d' the last time of the road users after the ego's, s:

(1) a clock      d = d' within `EQUAL_S` or `STEPS` of their intervals, and |d| is at least twice
                 that and `LEAST_S`: a part that was not recorded would shift one end only
(2) is certain   if d is a difference of known clocks (`KNOWN_S`, or whole quarters of an hour):
                 then the times are shifted, with a note
(3) is asked     otherwise, and if only d' is a difference of `KNOWN_S` while d is not smaller: the
                 log is refused until the setting says what is right
"""

from __future__ import annotations

from dataclasses import replace
from math import isfinite

import numpy as np

from replan.core.errors import LogError
from replan.logs.scenario import Scenario

EQUAL_S, STEPS = 0.3, 3.0
LEAST_S = 1.0
LARGEST_ERROR_S = 1.0
"""A known difference of clocks is met within this time at any rate, s."""
SHORTEST_S = 5.0
"""Shorter logs show no clock, s."""
KNOWN_S = {
    "GPS time": 18.0,
    "TAI": 37.0,
    "TAI beside GPS time": 19.0,
    "the GPS epoch": -315_964_782.0,
    "the GPS epoch in UTC": -315_964_800.0,
}
"""What clocks are ahead of UTC, s, since 2017."""
QUARTER_S, LARGEST_ZONE_S = 900.0, 14 * 3600.0
"""Time zones are whole quarters of an hour apart from UTC, at most by 14 hours."""


def _known_offset(offset: float, tolerance: float) -> tuple[str, float] | None:
    """Return the clocks whose difference is nearest to an offset, s, and that difference; None if
    it is farther off than the tolerance.
    """
    zone = QUARTER_S * round(offset / QUARTER_S)
    known = [(name, sign * ahead) for name, ahead in KNOWN_S.items() for sign in (1.0, -1.0)]
    if 0.0 < abs(zone) <= LARGEST_ZONE_S:
        known.append((f"a time zone of {zone / 3600.0:+g} h", zone))
    nearest = min(known, key=lambda entry: abs(entry[1] - offset))
    return nearest if abs(nearest[1] - offset) <= tolerance else None


def on_one_clock(scenario: Scenario, ahead_s: float) -> Scenario:
    """Shift the road users to the ego's clock.

    `ahead_s` is what their clock is ahead; inf: found by (1), LogError if it is not certain.
    """
    tracks, ego = scenario.tracks, scenario.ego
    moving = tracks.t[~tracks.static[tracks.owner]]
    if isfinite(ahead_s):
        note = f"The road users' clock is {ahead_s:g} s ahead of the ego's, as set."
        return _shifted(scenario, ahead_s, note) if ahead_s else scenario
    if not len(moving) or len(ego) < 2 or min(np.ptp(moving), np.ptp(ego.t)) < SHORTEST_S:
        return scenario
    times = np.unique(moving)
    begins, ends = float(times[0] - ego.t[0]), float(times[-1] - ego.t[-1])
    tolerance = max(EQUAL_S, STEPS * float(np.median(np.diff(times))))
    offset = 0.5 * (begins + ends)
    if abs(ends - begins) > tolerance:
        late = _known_offset(ends, EQUAL_S) if abs(ends) < QUARTER_S else None
        if late is None or begins < ends - tolerance or ends < 0.0:
            return scenario
        raise _question(f"end {ends:.1f} s after the ego's, as {late[0]}", late[1])
    if abs(offset) < max(LEAST_S, 2.0 * tolerance):
        return scenario
    known = _known_offset(offset, min(tolerance, LARGEST_ERROR_S))
    if known is None:
        raise _question(f"begin and end {offset:.1f} s after the ego's", round(offset, 3))
    name, exact = known
    note = (
        f"The times of the road users begin and end {offset:.1f} s after the ego's, as {name}: "
        f"they are shifted by {-exact:g} s (clock_ahead_s = 0 in [log] leaves them)."
    )
    return _shifted(scenario, exact, note)


def _question(what: str, offset: float) -> LogError:
    return LogError(
        f"the times of the road users {what}: another clock?",
        topic="agents",
        remedy=f"state it in [log]: clock_ahead_s = {offset:g}, or clock_ahead_s = 0 if they are "
        "right",
    )


def _shifted(scenario: Scenario, ahead_s: float, note: str) -> Scenario:
    """Return the scenario with the road users `ahead_s` earlier."""
    spans = scenario.traffic
    if spans is not None:
        spans = tuple((begin - ahead_s, end - ahead_s) for begin, end in spans)
    return replace(
        scenario,
        tracks=scenario.tracks.shifted(-ahead_s),
        traffic=spans,
        notes=(*scenario.notes, note),
    )
