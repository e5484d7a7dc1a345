"""Mined events against labels: precision and recall of each kind over twenty drives, and of near
misses over more.

    replan evaluate FOLDER_OF_COMMONROAD_FILES --mode closed -p dp_qp -p idm -p lattice -p constant_speed -o RUN
    replan evaluate FOLDER_OF_COMMONROAD_FILES ... --mode closed -p pdm --set loop.traffic=reactive -o PDM
    python -m studies.mining FOLDER_OF_TARTU_BAGS FOLDER_OF_ARGOVERSE_LOGS FOLDER_OF_COMMONROAD_FILES ... RUN PDM

The labels were made by looking at the drives from above, a picture each second (0.7 s for Argoverse
2), without the events: what a person would call so, not what the definitions say. An event is right
where a label of its kind has its main road user (or, of the ego alone, its stop line, crosswalk or
side). A table counts all events, or those that are not in doubt: an event in doubt is then as one
that was not found. Kinds without label and event are left out.

Near misses are rare. They are labelled by pairs of road users: every pair, with a vehicle that
drives 4 s and 15 m, that would collide within 2 s at constant velocity, comes within 1 m at a
closing speed of 1 m/s, or overlaps, for 0.3 s (by a script that shares no code with the events),
was looked at from above. A label says that an engineer would want to see it as a near miss. The
events are those of each such vehicle as the ego in turn. The drives of planners over CommonRoad's
recordings were labelled in the same way, for the ego; a collision counts as well.
"""  # noqa: E501

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from replan.core.arrays import arc_lengths
from replan.logs.agents import AgentKind
from replan.logs.log_settings import LogSettings
from replan.logs.readers import read_log
from replan.logs.readers.recorded import driven
from replan.logs.scenario import Scenario
from replan.metrics.metric import Unavailable
from replan.mine.driven_log import DrivenLog
from replan.mine.kinds import KINDS

LABELS: dict[str, tuple[tuple[str, str], ...]] = {
    "pedestrian_crossing_10": (
        ("pedestrian_crossing", "60"),
        ("ego_yields", "60"),
        ("cyclist_along", "165"),
    ),
    "pedestrian_crossing_14": (
        ("pedestrian_crossing", "25"),
        ("pedestrian_crossing", "30"),
        ("ego_yields", "25"),
        ("ego_yields", "30"),
    ),
    "pedestrian_crossing_15": (
        ("pedestrian_crossing", "28"),
        ("pedestrian_crossing", "67"),
        ("ego_yields", "28"),
        ("ego_yields", "67"),
    ),
    "kaubamaja_sfa_2": (
        ("pedestrian_crossing", "9"),
        ("pedestrian_crossing", "10"),
        ("pedestrian_crossing", "106"),
        ("close_pass", "354"),
        ("close_pass", "254"),
    ),
    "3b3570b4-7b0b-3268-a571-b0889dbf40b6": (
        ("unprotected_turn", "left"),
        ("crosswalk", "2348546"),
        ("crosswalk", "2348347"),
        ("ego_yields", "2357"),
    ),
    "7fab2350-7eaf-3b7e-a39d-6937a4c1bede": (
        ("unprotected_turn", "left"),
        ("crosswalk", "2356430"),
        ("ego_yields", "7f57"),
        ("ego_yields", "3c6c"),
    ),
}
APART: dict[str, tuple[tuple[str, str], ...]] = {
    "pedestrian_crossing_05": (("pedestrian_crossing", "30"), ("ego_yields", "30")),
    "pedestrian_crossing_09": (("pedestrian_crossing", "72"), ("ego_yields", "72")),
    "raekoda": (("close_pass", "218"), ("close_pass", "222")),
    "bot_garden": (("pedestrian_crossing", "77"),),
}
"""Labelled after the thresholds were fixed."""
FRESH: dict[str, tuple[tuple[str, str], ...]] = {
    "pedestrian_crossing_01": (("ego_yields", "944"),),
    "pedestrian_crossing_02": (("ego_yields", "1052"), ("ego_yields", "1503")),
    "pedestrian_crossing_06": (("pedestrian_crossing", "24"), ("ego_yields", "24")),
    "pedestrian_crossing_07": (
        ("pedestrian_crossing", "165"),
        ("ego_yields", "165"),
        ("ego_slows", "131"),
        ("standing_queue", "131"),
    ),
    "pedestrian_crossing_13": (("ego_yields", "1339"), ("ego_yields", "1340")),
    "USA_Lanker-2_23_T-1.xml@21248": (
        ("cut_out", "21247"),
        ("ego_slows", "21241"),
        ("hard_braking", ""),
    ),
    "USA_US101-23_1_T-1.xml@91": (("cut_out", "79"),),
    "USA_US101-15_1_T-1.xml@446": (),
    "C-DEU_MONAEast-2_480_T-559.xml": (),
    "USA_US101-23_1_T-1.xml@84": (),
}
"""Five of Tartu and five of CommonRoad, after "@" the road user taken as the ego.

They were labelled before they were mined; some rules were changed afterwards.
"""
NEAR_MISSES_SEEN: dict[str, tuple[tuple[str, str], ...]] = {
    "USA_Lanker-1_1_T-1.xml": (),
    "USA_Lanker-1_3_T-1.xml": (),
    "USA_Lanker-2_23_T-1.xml": (),
    "USA_Peach-3_1_T-1.xml": (("415", "418"),),
    "USA_Peach-4_8_T-1.xml": (("560", "566"),),
    "USA_US101-10_1_T-1.xml": (),
    "USA_US101-11_4_T-1.xml": (("116", "124"),),
    "USA_US101-14_1_T-1.xml": (),
    "USA_US101-15_1_T-1.xml": (),
    "USA_US101-17_1_T-1.xml": (),
    "USA_US101-23_1_T-1.xml": (),
    "USA_US101-6_1_T-1.xml": (("387", "407"),),
}
"""Pairs of road users with a near miss, in recordings that the rule was chosen with."""
NEAR_MISSES: dict[str, tuple[tuple[str, str], ...]] = {
    **dict.fromkeys(
        (
            "USA_Lanker-1_8_T-1.xml",
            "USA_Lanker-2_6_T-1.xml",
            "C-DEU_MONAEast-2_1680_T-1759.xml",
            "C-DEU_MONAEast-2_1_T-79.xml",
            "C-DEU_MONAEast-2_240_T-319.xml",
            "C-DEU_MONAEast-2_480_T-559.xml",
            "C-DEU_MONAEast-2_960_T-1039.xml",
            "C-DEU_MONAMerge-2_1_T-299.xml",
            "C-DEU_MONAMerge-2_480_T-559.xml",
            "C-DEU_MONAWest-2_1200_T-1279.xml",
            "C-DEU_MONAWest-2_1440_T-1519.xml",
            "C-DEU_MONAWest-2_720_T-799.xml",
            "DEU_Flensburg-10_1_T-1.xml",
            "DEU_Flensburg-15_1_T-1.xml",
            "DEU_Flensburg-2_1_T-1.xml",
            "DEU_Flensburg-68_1_T-1.xml",
            "DEU_Goeppingen-37_1_T-4.xml",
            "DEU_Lohmar-20_1_T-1.xml",
            "DEU_Lohmar-38_1_T-1.xml",
            "DEU_Lohmar-55_1_T-1.xml",
            "OSC_Overtake-1_1_T-1.xml",
            "ZAM_Tjunction-1_18_T-1.xml",
            "ZAM_Intersection-1_1_T-1.xml",
            "3b3570b4-7b0b-3268-a571-b0889dbf40b6",
            "7fab2350-7eaf-3b7e-a39d-6937a4c1bede",
            "bot_garden",
            "kaubamaja_sfa_2",
            "pedestrian_crossing_05",
            "pedestrian_crossing_06",
            "pedestrian_crossing_07",
            "pedestrian_crossing_09",
            "pedestrian_crossing_10",
            "pedestrian_crossing_14",
            "pedestrian_crossing_15",
            "raekoda",
        ),
        (),
    ),
    "DEU_Flensburg-29_1_T-1.xml": (("325", "328"),),
    "OSC_CutIn-1_2_T-1.xml": (("4", ""),),
    "C-DEU_B471-1_1_T-1.xml": (("206", "207"),),
}
"""The same in others, labelled before they were mined; "" is the recorded ego."""
NEAR_MISSES_DRIVEN: dict[str, dict[str, tuple[str, ...]]] = {
    "dp_qp": {
        "C-DEU_B471-1_3_T-1": ("399",),
        "DEU_Guetersloh-36_1_T-1": ("38",),
        "DEU_Lohmar-38_1_T-1": ("34",),
        "USA_US101-10_1_T-1": ("555",),
    },
    "idm": {
        "C-DEU_B471-1_3_T-1": ("399",),
        "C-DEU_MONAWest-2_1440_T-1519": ("10992",),
        "DEU_Guetersloh-36_1_T-1": ("38",),
        "DEU_Muc-4_2_T-1.cr": ("202", "203"),
        "OSC_CutIn-1_2_T-1": ("4",),
        "USA_US101-10_1_T-1": ("555",),
        "USA_US101-23_1_T-1": ("94", "99"),
    },
    "lattice": {
        "C-DEU_B471-1_3_T-1": ("399",),
        "C-DEU_MONAWest-2_1440_T-1519": ("10986",),
        "DEU_Guetersloh-36_1_T-1": ("38",),
        "DEU_Muc-4_2_T-1.cr": ("202",),
        "OSC_CutIn-1_2_T-1": ("4",),
    },
    "constant_speed": {
        "C-DEU_B471-1_3_T-1": ("399",),
        "C-DEU_MONAEast-2_1680_T-1759": ("12573",),
        "C-DEU_MONAEast-2_960_T-1039": ("11541",),
        "C-DEU_MONAWest-2_1440_T-1519": ("10982",),
        "DEU_Flensburg-10_1_T-1": ("321",),
        "DEU_Guetersloh-36_1_T-1": ("38",),
        "DEU_Muc-4_2_T-1.cr": ("202",),
        "OSC_CutIn-1_2_T-1": ("4",),
        "OSC_Overtake-1_1_T-1": ("257",),
        "USA_Lanker-1_1_T-1": ("1219",),
        "USA_US101-10_1_T-1": ("546",),
        "USA_US101-14_1_T-1": ("49",),
        "USA_US101-15_1_T-1": ("449",),
        "USA_US101-6_1_T-1": ("410",),
        "ZAM_Tjunction-1_18_T-1": ("1",),
        "ZAM_Tjunction-1_42_T-1": ("7",),
    },
    "pdm": {
        "C-DEU_B471-1_1_T-1": ("399",),
        "C-DEU_B471-1_3_T-1": ("399",),
        "C-DEU_MONAWest-2_1440_T-1519": ("10992",),
        "DEU_Flensburg-10_1_T-1": ("321",),
        "DEU_Flensburg-2_1_T-1": ("34",),
        "DEU_Guetersloh-36_1_T-1": ("38",),
        "DEU_Hennigsdorf-11_1_T-1": ("311",),
        "DEU_Lohmar-38_1_T-1": ("34",),
        "DEU_Muc-4_2_T-1.cr": ("202",),
        "OSC_CutIn-1_2_T-1": ("4",),
        "ZAM_Tjunction-1_277_T-1": ("5",),
    },
}
"""The same in drives of planners, by log: labelled after the rule was changed, before they were
mined.

Those of `pdm`, among reactive traffic, were labelled after one more change.
"""
SETS = "-set-"
"""In the names of two files whose road users are sets of possible places: left out."""
EGO_S, EGO_M = 4.0, 15.0
"""A vehicle is taken as the ego if it drives for this long and this far."""


def found_in(path: Path, ego: str, *, doubted: bool) -> Iterator[tuple[str, str]]:
    """Kind and main road user of each event of a log, as the labels have them; `doubted`: also of
    those in doubt.
    """
    scenario = read_log(path, LogSettings(ego=ego))
    log = DrivenLog(scenario)
    for kind in KINDS.values():
        events = kind.find(log)
        for event in () if isinstance(events, Unavailable) else events:
            about = scenario.short_names(event.agents[0]) if event.agents else event.what
            if doubted or not event.doubt:
                yield kind.name, about.removeprefix("crosswalk ").partition(",")[0]


def egos(path: Path) -> Iterator[tuple[str, Scenario]]:
    """The scenario of each vehicle of a log as the ego, with its id.

    That of the recorded ego is "".
    """
    scenario = read_log(path, LogSettings())
    if len(scenario.ego) > 1:
        yield "", scenario
    tracks = scenario.tracks
    for i, name in enumerate(tracks.ids):
        at = tracks.samples(i)
        t, x, y = tracks.t[at], tracks.x[at], tracks.y[at]
        cannot = tracks.static[i] or tracks.kinds[i] in (
            AgentKind.PEDESTRIAN,
            AgentKind.BICYCLE,
            AgentKind.OBJECT,
        )
        if cannot or t[-1] - t[0] < EGO_S or arc_lengths(x, y)[-1] < EGO_M:
            continue
        if path.suffix == ".xml":
            yield name, read_log(path, LogSettings(ego=name))
            continue
        car, yaw = scenario.vehicle, tracks.yaw[at]
        ratio = float(tracks.length[i]) / car.length
        car = replace(
            car,
            length=float(tracks.length[i]),
            width=float(tracks.width[i]),
            wheelbase=car.wheelbase * ratio,
            rear_overhang=car.rear_overhang * ratio,
        )
        axle = car.axle_to_center
        ego = driven(t - t[0], x - axle * np.cos(yaw), y - axle * np.sin(yaw), yaw, [])
        others = tracks.only(set(tracks.ids) - {name}).shifted(-float(t[0]))
        yield (
            name,
            replace(
                scenario,
                ego=ego,
                tracks=others,
                vehicle=car,
                duration=float(ego.t[-1]),
                goal=None,
                controls=None,
                lights=(),
                traffic=None,
                detections=None,
                onboard=(),
            ),
        )


Pair = tuple[str, str, str]
"""A log, and two road users in it, sorted."""


def print_near_misses(drives: Iterator[tuple[str, str, Scenario]], labelled: set[Pair]) -> None:
    """Events of the kind `near_miss_ttc` in drives (log, id of the ego, scenario), and how many
    pairs are labelled.
    """
    number, events, found = 0, 0, set[Pair]()
    for log, ego, scenario in drives:
        number += 1
        listed = KINDS["near_miss_ttc"].find(DrivenLog(scenario))
        for event in () if isinstance(listed, Unavailable) else listed:
            one, two = sorted((ego, event.agents[0]))
            says = "right" if (log, one, two) in labelled else "not labelled"
            what = f"{event.begin:.1f} s, TTC {event.value:.2f} s {event.doubt}"
            sys.stdout.write(f"{says}: {log}, '{one}' and '{two}', {what}\n")
            events += 1
            found.add((log, one, two))
    sys.stdout.writelines(f"missed: {', '.join(pair)}\n" for pair in sorted(labelled - found))
    sys.stdout.write(
        f"{number} drives, {events} events of {len(found)} pairs, {len(found & labelled)} of them "
        f"right; {len(labelled)} labels\n"
    )


def recorded(
    names: dict[str, tuple[tuple[str, str], ...]], folders: list[str]
) -> Iterator[tuple[str, str, Scenario]]:
    """The drives of recordings: log, id of the ego, scenario."""
    for name in names:
        path = next(Path(folder, name) for folder in folders if Path(folder, name).exists())
        yield from ((name, ego, scenario) for ego, scenario in egos(path))


def driven_by(planner: str, folders: list[str]) -> Iterator[tuple[str, str, Scenario]]:
    """The drives of a planner in folders of results: log, "" for the ego, scenario."""
    for path in sorted(
        path for folder in folders for path in Path(folder).glob(f"*/closed.{planner}.mcap")
    ):
        log = path.parent.name.rpartition("-")[0]
        if SETS not in log:
            yield log, "", read_log(path, LogSettings())


def main(folders: list[str]) -> None:
    """Print the tables."""
    for title, drives in (
        ("drives that the thresholds were chosen with", LABELS),
        ("drives kept apart", APART),
        ("drives labelled last", FRESH),
    ):
        for doubted in (True, False):
            sys.stdout.write(
                f"\n{title}, {'all events' if doubted else 'events that are not in doubt'}\n"
            )
            print_table(drives, folders, doubted=doubted)
    for title, recordings in (
        ("seen", NEAR_MISSES_SEEN),
        ("labelled before they were mined", NEAR_MISSES),
    ):
        sys.stdout.write(f"\nnear misses, recordings {title}\n")
        labelled = {
            (name, min(pair), max(pair)) for name, pairs in recordings.items() for pair in pairs
        }
        print_near_misses(recorded(recordings, folders), labelled)
    for planner, logs in NEAR_MISSES_DRIVEN.items():
        sys.stdout.write(f"\nnear misses, drives of {planner}\n")
        those = {(log, "", who) for log, agents in logs.items() for who in agents}
        print_near_misses(driven_by(planner, folders), those)


def print_table(
    drives: dict[str, tuple[tuple[str, str], ...]], folders: list[str], *, doubted: bool
) -> None:
    """Precision and recall by kind, of all events or of those that are not in doubt."""
    right, wrong, missed = Counter[str](), Counter[str](), Counter[str]()
    for name, labels in drives.items():
        file, _, ego = name.partition("@")
        path = next(Path(folder, file) for folder in folders if Path(folder, file).exists())
        expected, events = Counter(labels), Counter(found_in(path, ego, doubted=doubted))
        for kind, about in (events | expected).elements():
            both = min(events[kind, about], expected[kind, about], 1)
            table = right if both else wrong if events[kind, about] else missed
            table[kind] += 1
            if not both:
                sys.stdout.write(
                    f"{'not labelled' if events[kind, about] else 'missed'}: {name}, {kind} "
                    f"{about}\n"
                )
    sys.stdout.write(
        "| kind | right | not labelled | missed | precision | recall |\n|---|---|---|---|---|---|\n"
    )
    for kind in [*sorted(right | wrong | missed), "all"]:
        r, w, m = (
            table.total() if kind == "all" else table[kind] for table in (right, wrong, missed)
        )
        precision = f"{r / (r + w):.2f}" if r + w else "-"
        recall = f"{r / (r + m):.2f}" if r + m else "-"
        sys.stdout.write(f"| {kind} | {r} | {w} | {m} | {precision} | {recall} |\n")


if __name__ == "__main__":
    main(sys.argv[1:])
