"""`[log] repair`: raw detections become tracks, in one place for logs of every format.

    "auto"    where a log holds detections and they are no tracks (`logs.repair.needs_repair`)
    "on"      always; of a log of tracks their samples are the detections, and who never moves stays as they are
    "off"     never: the tracks are those that the reader makes

Where the road is assumed along the driven path, its lane gets its width from the tracks made (`passed_width`).

It is done before a part is cut out, so that a part's tracks are the whole's. A reader that reads a part only reads
`REACH_S` more on both sides: then what a repair knows from farther away, the names of tracks and the choice of "auto"
may be others than for the whole.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from logs.agents import Detections
from logs.mcap.complete import passed_width
from logs.readers.admission import detections_within
from logs.readers.cut import DETECTED_S, framed
from logs.road import RoadSource
from logs.scenario import Scenario

REACH_S = DETECTED_S
"""Around a part so much of the log is repaired with it."""


def reason_to_repair(choice: str, found: Detections | None) -> str | None:
    """Why detections are made into tracks, in a sentence; None: they are not."""
    if found is None or choice == "off":
        return None
    if choice == "on":
        return "It was asked for."
    from logs.repair import needs_repair

    return needs_repair(found)


def repaired(scenario: Scenario, choice: str) -> Scenario:
    """The scenario with tracks made of its detections as `choice` ("auto", "on", "off") says; else the same tracks.

    What is not repaired has no `detections` afterwards, what is repaired has them in its `repair`.
    """
    found = scenario.detections
    if choice == "on" and found is None:
        if scenario.repair is not None:
            found = scenario.repair.detections
        else:
            from logs.repair import detections_of

            tracks = scenario.tracks
            found = detections_of(tracks.taken(np.repeat(~tracks.static, np.diff(tracks.offsets))))
    reason = reason_to_repair(choice, found)
    if found is None or reason is None:
        return scenario if scenario.detections is None else replace(scenario, detections=None)
    from logs.repair import repair

    found, left_out = detections_within(scenario, framed(found))
    tracks, made = repair(found, scenario.ego, scenario.vehicle)
    if scenario.detections is None and scenario.repair is None:
        # who never moves stays, under names that are not taken
        was, taken = scenario.tracks, {*tracks.ids, *made.removed.ids}
        stay = was.taken(np.repeat(was.static, np.diff(was.offsets)))
        names = ("length", "width", "static", "t", "x", "y", "yaw", "vx", "vy")
        tracks = replace(
            tracks,
            ids=(*tracks.ids, *(f"{name}~static" if name in taken else name for name in stay.ids)),
            kinds=(*tracks.kinds, *stay.kinds),
            offsets=np.r_[tracks.offsets, stay.offsets[1:] + len(tracks.t)],
            **{name: np.r_[getattr(tracks, name), getattr(stay, name)] for name in names},
        )
        made = replace(made, tracks=tracks, extended=np.r_[made.extended, np.zeros(len(stay.t), np.bool_)])
    road, notes = scenario.road, [*scenario.notes, *left_out]
    if road.source is RoadSource.DRIVEN_PATH and scenario.repair is None:
        road = passed_width(road, tracks, notes)
    notes.append(" ".join((f"The road users are made of {len(found)} detections. {reason}", *made.summary())))
    return replace(scenario, tracks=tracks, road=road, detections=None, repair=made, notes=tuple(notes))


def named(scenario: Scenario) -> Scenario:
    """The repaired scenario whose tracks have the names by which a causal tracker knows them (`logs.repair.names`)."""
    made = scenario.repair
    assert made is not None and made.tracks is scenario.tracks
    from logs.repair.names import named_as_tracked

    made = named_as_tracked(made)
    return replace(scenario, tracks=made.tracks, repair=made)
