"""Kinds of road users by the words of data sets, for all readers.

A word is compared in lower case, without "TYPE_" and with "_" for spaces and hyphens: first whole
with `NAMES`, then with each part of `PARTS`, of which the first that it contains decides. Words of
nuScenes, KITTI, Waymo, CARLA, Apollo, Argoverse, Autoware, SUMO and of common use.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise

import numpy as np

from replan.core.arrays import IntArray
from replan.core.errors import LogError
from replan.core.names import counted
from replan.logs.agents import AgentKind, ObjectClass

CAR, TRUCK, BUS, MOTORCYCLE, BICYCLE, PEDESTRIAN, OBJECT = AgentKind
NAMES: Mapping[str, AgentKind] = {
    "av": CAR,
    "ego": CAR,
    "evehicle": CAR,
    "passenger": CAR,
    "private": CAR,
    "emergency": CAR,
    "authority": CAR,
    "army": CAR,
    "vip": CAR,
    "hov": CAR,
    "smallmot": CAR,
    "pedestrian/bicycle": PEDESTRIAN,
    "delivery": TRUCK,
    "bigmot": TRUCK,
    "large_vehicle": TRUCK,
    "vehicle.construction": TRUCK,
    "vehicle.ford.ambulance": TRUCK,
    "vehicle.mercedes.sprinter": TRUCK,
    "vehicle.carlamotors.carlacola": TRUCK,
    "vehicle.carlamotors.european_hgv": TRUCK,
    "vehicle.carlamotors.firetruck": TRUCK,
    "vehicle.tesla.cybertruck": CAR,
    "vehicle.volkswagen.t2": CAR,
    "vehicle.mitsubishi.fusorosa": BUS,
    "coach": BUS,
    "railed_vehicle": BUS,
    "vehicle.harley_davidson.low_rider": MOTORCYCLE,
    "vehicle.kawasaki.ninja": MOTORCYCLE,
    "vehicle.yamaha.yzf": MOTORCYCLE,
    "vehicle.vespa.zx125": MOTORCYCLE,
    "vehicle.gazelle.omafiets": BICYCLE,
    "vehicle.diamondback.century": BICYCLE,
    "nonmot": BICYCLE,
    "dog": OBJECT,
    "mobile_pedestrian_crossing_sign": OBJECT,
    "dontcare": OBJECT,
    "official_signaler": PEDESTRIAN,
    "wheeled_device": BICYCLE,
    "heavy_truck": TRUCK,
    "semitractor": TRUCK,
    "semitrailer": TRUCK,
}
"""Kinds by whole words, of which no part decides, or a wrong one."""
PARTS = (
    ("motor", MOTORCYCLE),
    ("moped", MOTORCYCLE),
    ("scooter", MOTORCYCLE),
    ("bicycle_rack", OBJECT),
    ("cycl", BICYCLE),
    ("bike", BICYCLE),
    ("rider", BICYCLE),
    ("pedestrian", PEDESTRIAN),
    ("pedtype", PEDESTRIAN),
    ("person", PEDESTRIAN),
    ("human", PEDESTRIAN),
    ("people", PEDESTRIAN),
    ("walker", PEDESTRIAN),
    ("child", PEDESTRIAN),
    ("stroller", PEDESTRIAN),
    ("wheelchair", PEDESTRIAN),
    ("animal", PEDESTRIAN),
    ("message_board", OBJECT),
    ("light_trailer", OBJECT),
    ("truck", TRUCK),
    ("lorry", TRUCK),
    ("trailer", TRUCK),
    ("construction_vehicle", TRUCK),
    ("bus", BUS),
    ("tram", BUS),
    ("train", BUS),
    ("rail", BUS),
    ("cart", OBJECT),
    ("cardboard", OBJECT),
    ("carton", OBJECT),
    ("car", CAR),
    ("van", CAR),
    ("taxi", CAR),
    ("veh", CAR),
    ("object", OBJECT),
    ("static", OBJECT),
    ("unknown", OBJECT),
    ("movable", OBJECT),
    ("cone", OBJECT),
    ("barrier", OBJECT),
    ("barrel", OBJECT),
    ("bollard", OBJECT),
    ("debris", OBJECT),
    ("obstacle", OBJECT),
    ("sign", OBJECT),
    ("traffic", OBJECT),
    ("construction", OBJECT),
    ("misc", OBJECT),
    ("other", OBJECT),
    ("hazard", OBJECT),
    ("drivable", OBJECT),
)
"""Kinds by parts of words: the first part that a word contains decides."""
CLASSES = (
    ("cone", ObjectClass.CONE),
    ("pylon", ObjectClass.CONE),
    ("barrel", ObjectClass.CONE),
    ("barrier", ObjectClass.BARRIER),
    ("sign", ObjectClass.SIGN),
    ("message_board", ObjectClass.SIGN),
)
"""Classes of objects by parts of words: the first part that a word contains decides."""
BLANKS = frozenset(("", "nan", "none", "null", "n/a", "<na>"))
"""Texts of a field that is empty."""
_SHOWN = 12


def kind_of_word(word: str) -> AgentKind | None:
    """Return the kind that a word names; None if it is unknown."""
    text = re.sub(r"[\s-]+", "_", word.strip().lower()).removeprefix("type_")
    if text in NAMES:
        return NAMES[text]
    return next((kind for part, kind in PARTS if part in text), None)


def object_classes(
    ids: Sequence[str], kinds: Sequence[AgentKind], words: Sequence[str]
) -> dict[str, ObjectClass]:
    """Return the class of each object by its id, of those whose words name one."""
    classes = {}
    for name, kind, word in zip(ids, kinds, words, strict=True):
        text = word.lower()
        named = next((named for part, named in CLASSES if part in text), None)
        if kind is AgentKind.OBJECT and named is not None:
            classes[name] = named
    return classes


def most_common(labels: IntArray, owner: IntArray, count: int) -> IntArray:
    """Return the most frequent label of each of `count` owners, -1 without one; `labels` and
    `owner` are `(m,)`.
    """
    values, codes = np.unique(labels, return_inverse=True)
    counts = np.zeros((count, max(len(values), 1)), np.int64)
    np.add.at(counts, (owner, codes), 1)
    if not len(values):
        return np.full(count, -1)
    return np.where(counts.any(axis=1), values[counts.argmax(axis=1)], -1)


def kinds_by_word(
    words: Iterable[str], given: Mapping[str, str], known: Mapping[str, str]
) -> dict[str, AgentKind | None]:
    """Return the kind of each word, None for blanks; LogError that names all unknown words.

    `given` are kinds by the user's words, `known` those of the data set in lower case; both win
    over replan's.
    """
    stated = {**known, **{word.lower(): kind for word, kind in given.items()}}
    kinds = {
        word: (AgentKind(stated[word.lower()]) if word.lower() in stated else kind_of_word(word))
        for word in sorted(set(words))
        if word.strip().lower() not in BLANKS
    }
    unknown = [word for word, kind in kinds.items() if kind is None]
    if unknown:
        named = ", a ".join(map(repr, unknown[:_SHOWN]))
        more = f" and {len(unknown) - _SHOWN} more" if len(unknown) > _SHOWN else ""
        example = ", ".join(f'{_quoted(word)} = "car"' for word in unknown[:_SHOWN])
        choice = ", ".join(kind.value for kind in AgentKind)
        raise LogError(
            f"an agent is a {named}{more}",
            topic="agents",
            remedy=f"name the kind in [log]: kinds = {{{example}}}; known kinds: {choice}",
        )
    return {**dict.fromkeys(words), **kinds}


def _quoted(word: str) -> str:
    escaped = word.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def kinds_of_tracks(
    words: Sequence[str],
    offsets: IntArray,
    given: Mapping[str, str],
    known: Mapping[str, str],
    notes: list[str],
) -> tuple[AgentKind, ...]:
    """Return the kind of each track: that of most of its rows, of two the first.

    Track i has the words `words[offsets[i] : offsets[i + 1]]`; blank words are unknown, and a track
    of blanks is taken for a car. Notes say so; LogError as in `kinds_by_word`.
    """
    kinds = kinds_by_word(words, given, known)
    chosen, blank, several = list[AgentKind](), 0, 0
    for begin, end in pairwise(offsets.tolist()):
        rows = Counter(kinds[word] for word in words[begin:end])
        del rows[None]
        blank += not rows
        several += len(rows) > 1
        chosen.append(rows.most_common(1)[0][0] or CAR if rows else CAR)
    if blank == len(chosen):
        notes.append("The log does not say what the agents are: they are taken for cars.")
    elif blank:
        notes.append(f"{counted(blank, 'road user')} of no kind: taken for cars.")
    if several:
        notes.append(
            f"{counted(several, 'road user')} with rows of several kinds: that of most rows counts."
        )
    return tuple(chosen)
