"""Reads the traffic lights of a bag: what each shows, by the ids of the log."""

from __future__ import annotations

from typing import Any

import numpy as np

from replan.logs.readers.ros import schemas
from replan.logs.readers.ros.ego import EgoLog
from replan.logs.readers.ros.frames import describe_timing, times_of
from replan.logs.readers.ros.part import BagPart
from replan.logs.readers.ros.schemas import STAMP
from replan.logs.rules import Colour, TrafficLight

UNSEEN_S = 2.0
"""A light is OFF (unknown) when it was not reported for this time, s."""

LightRow = tuple[Any, ...]
"""A light in a message: its ids, and its lamps, or code and word of its colour."""


def read_lights(part: BagPart, ego: EgoLog, t0: int) -> tuple[TrafficLight, ...]:
    """Read the traffic lights, with the ids of the log."""
    topics, notes = part.topics(schemas.LIGHTS, "lights"), part.notes
    if not topics:
        return ()
    topic = topics[0]
    schema = schemas.LIGHTS[topic.kind]
    stamp = STAMP if part.bag.has(topic, "header.stamp") else ("stamp.sec", "stamp.nanosec")
    lamp = ("lamps", (schema.lamps, (schema.colour,))) if schema.lamps else ("word", schema.words)
    fields = (*schema.ids, *((lamp[1],) if schema.lamps else (schema.colour, schema.words)))
    log, stamps, rows = part.read(topic, ((schema.items, fields),), stamp)
    t, keep = times_of(topic.name, log, stamps, ego.clock, notes)
    notes += describe_timing(topic.name, log, stamps, int(log[0])) if len(log) else []
    messages = [rows[k][0] for k in keep]
    column = _id_column(messages, schema)
    traffic_lights = tuple(
        TrafficLight(
            int(light),
            (np.array(list(colours), dtype=np.int64) - t0) / 1e9,
            tuple(colours.values()),
        )
        for light, colours in sorted(_changes(t.tolist(), messages, schema, column).items())
    )
    if traffic_lights:
        notes.append(
            f"{len(traffic_lights)} traffic lights of {topic.name} are named by its "
            f"{schema.ids[column]}; which lane obeys which"
            " the log does not say: without a map that names them no stop line belongs to them."
        )
    return traffic_lights


def _id_column(messages: list[list[LightRow]], schema: schemas.LightSchema) -> int:
    """The first of the ids in a row that is in use; the first one if none is."""
    rows = [row for message in messages for row in message]
    return next((i for i in range(len(schema.ids)) if any(row[i] for row in rows)), 0)


def _changes(
    times: list[int], messages: list[list[LightRow]], schema: schemas.LightSchema, column: int
) -> dict[int, dict[int, Colour]]:
    """By light, the times, ns, at which it changes, and its colours then.

    A light that was not reported for `UNSEEN_S` is OFF from then on.
    """
    shown: dict[int, list[tuple[int, Colour]]] = {}
    reported: dict[int, int] = {}
    for time, message in zip(times, messages, strict=True):
        lost = [light for light, last in reported.items() if time - last > 1e9 * UNSEEN_S]
        for light in lost:
            shown[light].append((reported.pop(light) + round(1e9 * UNSEEN_S), Colour.OFF))
        for light, colour in {row[column]: _colour(row, schema) for row in message}.items():
            reported[light] = time
            states = shown.setdefault(light, [])
            if not states or states[-1][1] is not colour:
                states.append((time, colour))
    return {
        light: dict(sorted(states, key=lambda state: state[0])) for light, states in shown.items()
    }


def _colour(row: LightRow, schema: schemas.LightSchema) -> Colour:
    if schema.lamps:
        lamps = row[-1]
        lit = {schemas.LAMPS.get(lamp[0], Colour.OFF) for lamp in lamps} - {Colour.OFF}
        if {Colour.RED, Colour.YELLOW} <= lit:
            return Colour.RED_YELLOW
        return next(
            (colour for colour in (Colour.RED, Colour.YELLOW, Colour.GREEN) if colour in lit),
            Colour.OFF,
        )
    code, word = row[-2:]
    text = str(word).upper()
    if text.startswith(("RED/", "RED_")):
        return Colour.RED_YELLOW
    if text.startswith(("AMBER", "YELLOW")):
        return Colour.YELLOW
    return schemas.RESULTS.get(code, Colour.OFF) if isinstance(code, int) else Colour.OFF
