"""Leaves out road users that are out of reach of the whole drive, where a log has very many.

Time and memory of a drive grow with the number of road users, and some steps take time for each
pair of them. A recording of a city, or of a simulator of its traffic, has tens of thousands, most
of them kilometres away.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from replan.logs.scenario import Scenario

MANY = 1000
"""A log with at most this many road users keeps all of them."""
REACH_M = 500.0
"""No planner drives this far from the box around the logged path, and no sensor sees as far."""


def within_reach(scenario: Scenario) -> Scenario:
    """Leave out the tracks whose boxes around all samples are beyond `REACH_M` of that around the
    ego's; a note counts them.

    Nothing changes for at most `MANY` tracks, for one ego state, and for repaired tracks.
    """
    ego, tracks = scenario.ego, scenario.tracks
    if len(tracks) <= MANY or len(ego) < 2 or scenario.repair is not None:
        return scenario
    far = np.zeros(len(tracks), np.bool_)
    for own, others in ((ego.x, tracks.x), (ego.y, tracks.y)):
        low = np.minimum.reduceat(others, tracks.offsets[:-1]) - own.max()
        high = own.min() - np.maximum.reduceat(others, tracks.offsets[:-1])
        far |= np.maximum(low, high) > REACH_M
    if not far.any():
        return scenario
    note = (
        f"{int(far.sum())} of {len(tracks)} road users are left out: they are never within "
        f"{REACH_M:g} m of the driven path."
    )
    near = tracks.taken(~far[tracks.owner])
    return replace(
        scenario, tracks=near, traffic=scenario.traffic_spans, notes=(*scenario.notes, note)
    )
