"""What first differences have in common, and what marks of means are worth."""

import re

import pandas as pd
from hypothesis import given, strategies as st

from replan.draw.report.comparison_sections import comparison_sections
from replan.metrics.comparison import (
    FLIP_COLUMNS,
    GROUP_COLUMNS,
    PAIR_COLUMNS,
    PARTING_COLUMNS,
    Comparison,
)

WORDS = st.sampled_from(["", "car", "pedestrian"])
PARTINGS = st.lists(
    st.tuples(st.sampled_from(["S-T graph", "plan"]), WORDS, st.floats(-90.0, 90.0)),
    min_size=1,
    max_size=12,
)


def comparison(partings: pd.DataFrame, groups: pd.DataFrame) -> Comparison:
    """A comparison in which nothing but first differences and means is known."""
    pairs, flips = pd.DataFrame(columns=PAIR_COLUMNS), pd.DataFrame(columns=FLIP_COLUMNS)
    return Comparison("a", "b", (), (), (), pairs, flips, groups, partings)


@given(PARTINGS)
def test_what_is_common_counts_each_difference_once(rows: list[tuple[str, str, float]]) -> None:
    fields = [
        {"log": f"log{i}", "planner": "p", "mode": "closed", "t_s": 1.0, "stage": stage}
        | {"what": "x", "agent": kind and "one", "kind": kind, "lights": ""}
        | {"ahead_m": 10.0 if kind else float("nan"), "left_m": left if kind else float("nan")}
        for i, (stage, kind, left) in enumerate(rows)
    ]
    partings = pd.DataFrame(fields, columns=list(PARTING_COLUMNS))
    sections = comparison_sections(comparison(partings, pd.DataFrame(columns=GROUP_COLUMNS)))
    (table,) = (section for section in sections if "in common" in section.title)
    facts = {fact.fact: fact.finding for fact in table.items}
    for fact in ("stage", "about", "lights"):
        counts = map(int, re.findall(r" in (\d+)", facts[fact]))
        assert sum(counts) == len(rows)
    sides = [left for _, kind, left in rows if kind]
    if sides:
        assert sum(map(int, re.findall(r" in (\d+)", facts["side of the ego"]))) == len(sides)
        low, high = min(map(abs, sides)), max(map(abs, sides))
        assert facts["distance to the side"].startswith(f"{low:.1f}")
        assert high == low or f"to {high:.1f} m" in facts["distance to the side"]
    else:
        assert "side of the ego" not in facts and "distance to the side" not in facts


@given(st.integers(1, 300), st.integers(0, 300))
def test_marks_of_means_are_stated_beside_what_chance_gives(tested: int, marked: int) -> None:
    marked = min(marked, tested)
    row = {"kind": "suite", "group": "all", "planner": "p", "mode": "closed", "unit": "m"}
    row |= {"direction": "lower", "logs": 6, "baseline": 1.0, "candidate": 2.0, "delta": 1.0}
    row |= {"low": 0.5, "high": 1.5, "better": 0, "worse": 6}
    rows = [row | {"metric": f"m{i}.max", "significant": i < marked} for i in range(tested)]
    groups = pd.DataFrame(rows, columns=list(GROUP_COLUMNS))
    sections = comparison_sections(comparison(pd.DataFrame(columns=PARTING_COLUMNS), groups))
    means = [section for section in sections if section.title == "Means over the logs"]
    assert bool(means) is bool(marked)
    if means:
        (note,) = (remark for remark in means[0].remarks if "by chance" in remark)
        assert note.startswith(f"{marked} of {tested} mean") and "6 logs" in note
        assert f"about {0.05 * tested:.0f} would" in note
