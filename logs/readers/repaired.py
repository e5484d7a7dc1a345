"""Makes tracks from raw detections, as `[log] repair` says.

    "auto"    if a log holds detections that are not tracks (`replan.logs.repair.needs_repair`)
    "on"      always; in a log of tracks, their samples are the detections, and static road users
              stay unchanged
    "off"     never: the reader makes the tracks

If the road is assumed along the driven path, the repaired tracks decide the width of its lane
(`passed_width`).

The repair precedes the cut of a part, so that a part has the same tracks as the whole log. A reader
that reads only a part reads `cut.DETECTED_S` more on both sides: the repair then lacks data from
farther away, and the names of tracks and the choice of "auto" may differ from those of the whole
log.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.names import counted, visible_name
from replan.logs.complete import passed_width
from replan.logs.edit.cut import framed
from replan.logs.readers.admission import LIMITS, SIZES_M, SPEED, zero_of
from replan.logs.repair.detections import Detections, named_as_tracked, needs_repair
from replan.logs.repair.offline import detections_of, repair
from replan.logs.road import RoadSource
from replan.logs.scenario import Scenario


def reason_to_repair(choice: str, detections: Detections | None) -> str | None:
    """Return the reason for a repair of the detections, in a sentence; None: they are not
    repaired.
    """
    if detections is None or choice == "off":
        return None
    if choice == "on":
        return "It was asked for."
    return needs_repair(detections)


def repaired(scenario: Scenario, choice: str) -> Scenario:
    """Make tracks from the scenario's detections as `choice` ("auto", "on", "off") says.

    The result has no `detections`; a repaired scenario has them in its `repair`.
    """
    detections = scenario.detections
    if choice == "on" and detections is None:
        if scenario.repair is not None:
            detections = scenario.repair.detections
        else:
            tracks = scenario.tracks
            detections = detections_of(tracks.taken(~tracks.static[tracks.owner]))
    reason = reason_to_repair(choice, detections)
    if detections is None or reason is None:
        return scenario if scenario.detections is None else replace(scenario, detections=None)
    notes = list(scenario.notes)
    detections = _within_limits(scenario, framed(detections), notes)
    tracks, result = repair(detections, scenario.ego, scenario.vehicle)
    if scenario.detections is None and scenario.repair is None:
        # static road users stay, under unused names
        before, used = scenario.tracks, {*tracks.ids, *result.removed.ids}
        static = before.taken(before.static[before.owner])
        ids = tuple(f"{name}~static" if name in used else name for name in static.ids)
        tracks = tracks.with_more(replace(static, ids=ids))
        extended = np.r_[result.extended, np.zeros(len(static.t), np.bool_)]
        result = replace(result, tracks=tracks, extended=extended)
    road = scenario.road
    if road.source is RoadSource.DRIVEN_PATH and scenario.repair is None:
        road = passed_width(road, tracks, notes)
    source = f"The road users are made of {len(detections)} detections. {reason}"
    notes.append(" ".join((source, *result.summary())))
    return replace(
        scenario, tracks=tracks, road=road, detections=None, repair=result, notes=tuple(notes)
    )


def _within_limits(scenario: Scenario, detections: Detections, notes: list[str]) -> Detections:
    """Return the detections within the limits of agents, with printable names; a note counts those
    left out.
    """
    limits = LIMITS["agents"]
    is_within = np.logical_and.reduce(
        [
            np.abs(getattr(detections, name) - zero_of(scenario, name)) <= limit.most
            for name, limit in limits.items()
        ]
    )
    if not is_within.all():
        count = counted(int((~is_within).sum()), "detection")
        notes.append(f"{count} beyond the limits of poses are left out.")
        detections = detections.taken(is_within)
    with np.errstate(all="ignore"):
        speed = np.hypot(np.nan_to_num(detections.vx), np.nan_to_num(detections.vy))
    printable = {name: visible_name(name) for name in set(detections.ids)}
    is_fast = speed > SPEED.most
    return replace(
        detections,
        ids=tuple(printable[name] for name in detections.ids),
        length=_known_size(detections.length),
        width=_known_size(detections.width),
        vx=np.where(is_fast, np.nan, detections.vx),
        vy=np.where(is_fast, np.nan, detections.vy),
    )


def _known_size(size: FloatArray) -> FloatArray:
    """Return sizes `(n,)`, m, of which those out of `SIZES_M` are NaN."""
    least, greatest = SIZES_M
    return np.where((size >= least) & (size <= greatest), size, np.nan)


def named(scenario: Scenario) -> Scenario:
    """Give the repaired tracks the names of the causal tracker's tracks
    (`replan.logs.repair.detections`).
    """
    assert scenario.repair is not None and scenario.repair.tracks is scenario.tracks
    result = named_as_tracked(scenario.repair)
    return replace(scenario, tracks=result.tracks, repair=result)
