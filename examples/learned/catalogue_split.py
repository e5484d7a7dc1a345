"""Write the logs of the catalogue for training, and those of families that are kept apart.

    python catalogue_split.py train_logs held_out_logs

Both are the suite `full`, split by family; the suite `separating` is kept apart, too.
"""

import sys
from pathlib import Path

from replan import write_log
from replan.logs.catalogue import scenario, suite

HELD_OUT = (
    "paper/free_road",
    "paper/static_obstacles",
    "paper/crossing_pedestrian",
    "everyday/follow",
    "everyday/cut_in",
    "everyday/crosswalk",
    "everyday/yellow_light",
    "pedestrian/group",
    "pedestrian/hesitates",
    "pedestrian/both_sides",
    "euro_ncap/cbna_2023",
    "euro_ncap/cbna_2026",
    "euro_ncap/cpfa_2023",
    "euro_ncap/cpfa_2026",
    "euro_ncap/cbla_2023",
    "euro_ncap/cbla_2026",
    "euro_ncap/ccrb_2023",
    "euro_ncap/ccrb_2026",
    "unece_r157/swerving_lead",
    "unece_r157/blocking_obstacle",
    "unece_r157/crossing_pedestrian",
    "unece_r157/cut_out",
    "faults/sparse",
    "faults/late",
    "raw/crossing",
    "raw/rider",
)


def main(train, held_out):
    """Write the logs of both folders."""
    for name in (*suite("full"), *suite("separating")):
        family = name.partition("@")[0]
        apart = family in HELD_OUT or family.startswith("separating/")
        file = Path(held_out if apart else train, f"{name}.mcap")
        file.parent.mkdir(parents=True, exist_ok=True)
        write_log(file, scenario(name))


if __name__ == "__main__":
    main(*sys.argv[1:])
