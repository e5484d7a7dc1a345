"""The table of what a log states twice: how it is compared, and what replan does.

The scenario of each reader passes `COMPARISONS` in their order. Rows without a function are
compared while a log is read, where what contradicts is still at hand; the columns of the ego are
rows of `replan.logs.ego_columns.EGO_COLUMNS`. Data change only on clear evidence, and each change
is a note. What only looks wrong is reported by `replan.metrics.health`.
"""

from __future__ import annotations

from collections.abc import Iterator

from replan.logs.clock_offset import EQUAL_S, STEPS, on_one_clock
from replan.logs.conventions import (
    CLEARLY,
    FITS_ALONE,
    MOST,
    TURNED_RAD,
    WIDER,
    check_headings,
    check_positions,
    in_world_axes,
    with_sides,
    with_steering,
    without_ego,
)
from replan.logs.ego_columns import EGO_COLUMNS
from replan.logs.heights import ABOVE_M, BELOW_M
from replan.logs.log_checks import CheckAction, LogCheck, Step, of_scenario

COMPARISONS: tuple[LogCheck[Step], ...] = (
    LogCheck(
        "times of a table without a unit",
        "their steps, or the time since 1970",
        "steps of 10 and more are no seconds",
        CheckAction.REFUSE,
        "ms, us or ns, with a note; refused if most are equal after rounding",
        "columns (t [ms])",
    ),
    LogCheck(
        "velocity of an odometry",
        "displacement of its poses",
        f"misfit below {FITS_ALONE:g} times that in its own axes, and {CLEARLY:g} less",
        CheckAction.REPAIR,
        "read in the axes in which it fits, with a note",
        "ego_axes",
    ),
    LogCheck(
        "heights of road users",
        "heights of the ego's way",
        f"{ABOVE_M:g} m above, {BELOW_M:g} m below",
        CheckAction.REPAIR,
        "left out by name; unused, with a note, where the zeros differ",
        'columns (z = "-")',
    ),
    LogCheck(
        "times of the road users",
        "times of the ego",
        f"equal shifts at both ends within {EQUAL_S:g} s or {STEPS:g} intervals",
        CheckAction.REFUSE,
        "shifted by a known difference of clocks, with a note; else refused",
        "clock_ahead_s",
        lambda scenario, settings, is_table: on_one_clock(scenario, settings.clock_ahead_s),
    ),
    LogCheck(
        "positions",
        "speeds and headings",
        "a factor of 2",
        CheckAction.REFUSE,
        "degrees of latitude and longitude are refused",
        "",
        of_scenario(check_positions),
    ),
    LogCheck(
        "headings",
        "direction of motion",
        f"the spread of the directions, at most {TURNED_RAD:g} rad",
        CheckAction.REFUSE,
        "other conventions, and headings across the motion, are refused",
        "ego_heading, agents_heading",
        lambda scenario, settings, is_table: check_headings(scenario, is_table=is_table),
    ),
    LogCheck(
        "steering angle",
        "headings",
        f"misfit of {EGO_COLUMNS['steer'].denied:g}",
        CheckAction.REPAIR,
        "converted from another sign, degrees or the steering wheel, else left out, with a note",
        "columns (steer), topics (steering)",
        of_scenario(with_steering),
    ),
    LogCheck(
        "places of a road user",
        "the ego's box",
        f"{MOST:.0%} of its samples",
        CheckAction.REPAIR,
        "it is the ego, and left out with a note",
        "ego",
        of_scenario(without_ego),
    ),
    LogCheck(
        "length and width of vehicles",
        "their direction of motion",
        f"wider than long by a factor of {WIDER:g}",
        CheckAction.REPAIR,
        "exchanged, with a note",
        "columns (length, width)",
        of_scenario(with_sides),
    ),
    LogCheck(
        "velocities of road users",
        "their displacement",
        f"misfit below {FITS_ALONE:g} times that in the world, and {CLEARLY:g} less",
        CheckAction.REPAIR,
        "read in the axes in which they fit, else derived, with a note",
        "agents_axes",
        lambda scenario, settings, is_table: in_world_axes(scenario, settings.agents_axes),
    ),
)


def rows() -> Iterator[tuple[str, str, str, str, str]]:
    """Yield the rows of the table for the documentation, of `COMPARISONS` and `EGO_COLUMNS`."""
    for comparison in COMPARISONS:
        yield comparison.row()
    for name, column in EGO_COLUMNS.items():
        if name == "steer":
            continue
        readings = ", ".join(column.readings)
        yield (
            f"{column.word} of the ego",
            column.shown_by,
            f"misfit of {column.denied:g}",
            f"read {readings} where that fits, else derived, with a note",
            f"columns ({name})" + (f", topics ({column.word})" if name != "kappa" else ""),
        )
