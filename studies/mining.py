"""Mined events against labels: precision and recall of each kind over twenty drives.

    python -m studies.mining FOLDER_OF_TARTU_BAGS FOLDER_OF_ARGOVERSE_LOGS FOLDER_OF_COMMONROAD_FILES

The labels were made by looking at the drives from above, a picture each second (0.7 s for Argoverse 2), without the
events: what a person would call so, not what the definitions say. An event is right where a label of its kind has its
main road user (or, of the ego alone, its stop line, crosswalk or side). A table counts all events, or those that are
not in doubt: an event in doubt is then as one that was not found. Kinds without label and event are left out.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from logs.log_settings import LogSettings
from logs.readers import read_log
from metrics.metric import Unavailable
from replay.mine.driven_log import DrivenLog
from replay.mine.kinds import KINDS

LABELS: dict[str, tuple[tuple[str, str], ...]] = {
    "pedestrian_crossing_10": (("pedestrian_crossing", "60"), ("ego_yields", "60"), ("cyclist_along", "165")),
    "pedestrian_crossing_14": (
        ("pedestrian_crossing", "25"), ("pedestrian_crossing", "30"), ("ego_yields", "25"), ("ego_yields", "30"),
    ),
    "pedestrian_crossing_15": (
        ("pedestrian_crossing", "28"), ("pedestrian_crossing", "67"), ("ego_yields", "28"), ("ego_yields", "67"),
    ),
    "kaubamaja_sfa_2": (
        ("pedestrian_crossing", "9"), ("pedestrian_crossing", "10"), ("pedestrian_crossing", "106"),
        ("close_pass", "354"), ("close_pass", "254"),
    ),
    "3b3570b4-7b0b-3268-a571-b0889dbf40b6": (
        ("unprotected_turn", "left"), ("crosswalk", "2348546"), ("crosswalk", "2348347"), ("ego_yields", "2357"),
    ),
    "7fab2350-7eaf-3b7e-a39d-6937a4c1bede": (
        ("unprotected_turn", "left"), ("crosswalk", "2356430"), ("ego_yields", "7f57"), ("ego_yields", "3c6c"),
    ),
}  # fmt: skip
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
        ("pedestrian_crossing", "165"), ("ego_yields", "165"), ("ego_slows", "131"), ("standing_queue", "131"),
    ),
    "pedestrian_crossing_13": (("ego_yields", "1339"), ("ego_yields", "1340")),
    "USA_Lanker-2_23_T-1.xml@21248": (("cut_out", "21247"), ("ego_slows", "21241"), ("hard_braking", "")),
    "USA_US101-23_1_T-1.xml@91": (("cut_out", "79"),),
    "USA_US101-15_1_T-1.xml@446": (),
    "C-DEU_MONAEast-2_480_T-559.xml": (),
    "USA_US101-23_1_T-1.xml@84": (),
}  # fmt: skip
"""Five of Tartu and five of CommonRoad, after "@" the road user taken as the ego.

They were labelled before they were mined; some rules were changed afterwards.
"""


def found_in(path: Path, ego: str, *, doubted: bool) -> Iterator[tuple[str, str]]:
    """Kind and main road user of each event of a log, as the labels have them; `doubted`: also of those in doubt."""
    scenario = read_log(path, LogSettings(ego=ego))
    log = DrivenLog(scenario)
    for kind in KINDS.values():
        events = kind.find(log)
        for event in () if isinstance(events, Unavailable) else events:
            about = scenario.short_names(event.agents[0]) if event.agents else event.what
            if doubted or not event.doubt:
                yield kind.name, about.removeprefix("crosswalk ").partition(",")[0]


def main(folders: list[str]) -> None:
    """Print the tables."""
    for title, drives in (
        ("drives that the thresholds were chosen with", LABELS),
        ("drives kept apart", APART),
        ("drives labelled last", FRESH),
    ):
        for doubted in (True, False):
            sys.stdout.write(f"\n{title}, {'all events' if doubted else 'events that are not in doubt'}\n")
            print_table(drives, folders, doubted=doubted)


def print_table(drives: dict[str, tuple[tuple[str, str], ...]], folders: list[str], *, doubted: bool) -> None:
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
                sys.stdout.write(f"{'not labelled' if events[kind, about] else 'missed'}: {name}, {kind} {about}\n")
    sys.stdout.write("| kind | right | not labelled | missed | precision | recall |\n|---|---|---|---|---|---|\n")
    for kind in [*sorted(right | wrong | missed), "all"]:
        r, w, m = (table.total() if kind == "all" else table[kind] for table in (right, wrong, missed))
        precision = f"{r / (r + w):.2f}" if r + w else "-"
        recall = f"{r / (r + m):.2f}" if r + m else "-"
        sys.stdout.write(f"| {kind} | {r} | {w} | {m} | {precision} | {recall} |\n")


if __name__ == "__main__":
    main(sys.argv[1:])
