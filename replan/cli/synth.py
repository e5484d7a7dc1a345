"""Catalogue -> MCAP: synthesised logs with their parameters in the metadata.

And a description of the catalogue.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from itertools import pairwise
from pathlib import Path
from typing import Any

from replan.core.errors import unknown_name
from replan.core.names import counted
from replan.logs.catalogue import (
    FAMILY,
    SEED,
    SUITES,
    Family,
    families,
    groups,
    scenario,
    scenario_name,
    suite,
)
from replan.logs.mcap import is_written_here, write_scenario
from replan.logs.scenario import Scenario
from replan.results.tables import safe_name, write_text
from replan.run.claim import claimed_files

TABLE = "suite.csv"
NATIVE, ROS2 = "native", "ros2"
FORMS = (NATIVE, ROS2)  # The forms in which logs are written
COLUMNS = ("log", "file", "family", "parameters", "seed", "tags", "accepted_decisions")


def _files(out: Path) -> AbstractContextManager[Callable[[str], Path]]:
    """The claimed files of a folder: logs of replan, and the table of a suite."""

    def is_ours(file: Path) -> bool:
        return is_written_here(file) or file.read_text().startswith(",".join(COLUMNS))

    return claimed_files(out, (".mcap", ".csv"), is_ours)


def chosen(names: Sequence[str]) -> tuple[Family, ...]:
    """The families of these names; "all" is every one, a group ("paper") all of its own,
    "module:NAME" a user's.

    ConfigError if no family or group has the name.
    """
    families_by_name: dict[str, Family] = {}
    all_families = families()
    for name in names:
        own = {name: FAMILY.find(name)} if ":" in name else {}
        matches = own or {
            key: family
            for key, family in all_families.items()
            if name in ("all", key, key.partition("/")[0])
        }
        if not matches:
            raise unknown_name("family", name, [*all_families, "all"])
        families_by_name.update(matches)
    return tuple(families_by_name.values())


def synthesise(
    families: Sequence[Family], out: Path, parameters: Mapping[str, float], form: str = NATIVE
) -> Generator[Path]:
    """Write one log per family into `out`, as GROUP/NAME.mcap or, of the form ROS2, as the bag
    GROUP/NAME.

    Yields each path when it is written. ConfigError if a family has no such parameter, its values
    allow no careful drive, or it does not exist in this form.
    """
    scenarios = [family.scenario(**parameters) for family in families]
    with _files(out) as path_of:
        paths = [path_of(_file_name(log.name)) for log in scenarios]
        for path, log in zip(paths, scenarios, strict=True):
            yield _written(log, path, form)


def write_suite(name: str, out: Path, form: str = NATIVE) -> Generator[Path]:
    """Write the logs of a suite (or of a family or group, all cells) into `out`, and last their
    table, `TABLE`.

    ConfigError if no suite, family or group has this name, or a log does not exist in this form.
    """
    rows, labels = [], suite(name)
    with _files(out) as path_of:
        table_file = path_of(TABLE)
        paths = [path_of(_file_name(scenario_name(label))) for label in labels]
        for label, log_file in zip(labels, paths, strict=True):
            log = scenario(label)
            path = _written(log, log_file, form)
            family, _, words = label.partition("@")
            file, seed = path.relative_to(out).as_posix(), log.metadata.get("parameter.seed", "")
            accepted = log.metadata.get("expected_decisions", "{}")
            rows.append(
                (label, file, family, words.replace(",", " "), seed, " ".join(log.tags), accepted)
            )
            yield path
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerows([COLUMNS, *rows])
        write_text(table_file, text.getvalue())
        yield table_file


def _file_name(name: str) -> str:
    group, _, variant = name.partition("/")
    return f"{safe_name(group)}/{safe_name(variant)}.mcap"


def _written(log: Scenario, path: Path, form: str) -> Path:
    if form == ROS2:
        from replan.cli.ros_bag import write_bag

        write_bag(path := path.with_suffix(""), log)
        return path
    write_scenario(path, log)
    return path


def listed() -> Iterator[str]:
    """Families with parameters and the size of their grids, then the suites: lines for the
    terminal.
    """
    for family in families().values():
        grid = f"\n    grid of {_count(family)}: {_grid(family)}" if family.grid else ""
        yield f"{family.name}: {family.summary}\n    {_defaults(family)}{grid}"
    for name, log_suite in SUITES.items():
        yield f"--suite {name}: {counted(log_suite.size, 'log')}; {log_suite.summary}"


def table() -> dict[str, Any]:
    """The content of `listed`, as data."""
    keys = ("name", "summary", "parameters", "grid", "tags", "source")
    families_table = [
        {key: getattr(family, key) for key in keys} | {"cells": _count(family)}
        for family in families().values()
    ]
    suites = [
        {"name": name, "size": log_suite.size, "summary": log_suite.summary}
        for name, log_suite in SUITES.items()
    ]
    return {"families": families_table, "suites": suites}


def _count(family: Family) -> int:
    return sum(1 for _ in family.cells())


def _grid(family: Family) -> str:
    """The values of each parameter; many evenly spaced ones are shown as first, second ... last."""
    parts = []
    for key, values in family.grid.items():
        steps = {round(b - a, 9) for a, b in pairwise(values)}
        shown = [f"{value:g}" for value in values]
        if len(shown) > 4 and len(steps) == 1:
            shown = [f"{shown[0]}", f"{shown[1]} ... {shown[-1]}"]
        parts.append(f"{key} {', '.join(shown)}")
    return "; ".join(parts)


def markdown_page() -> str:
    """The text of docs/catalogue.md."""
    parts = [INTRODUCTION]
    for name, group in groups().items():
        lines = [f"## {name}", "", ABOUT[name], ""]
        lines += [
            "| family | what happens | cells | grid (else the defaults) |",
            "|---|---|---|---|",
        ]
        for family in group:
            lines.append(
                f"| `{family.name}` | {family.summary} | {_count(family)} "
                f"| {_grid(family) or _defaults(family)} |"
            )
        sources = dict.fromkeys(family.source for family in group if family.source)
        parts.append("\n".join([*lines, "", *(f"Source: {source}." for source in sources)]))
    rows = [f"| `{name}` | {suite.size} | {suite.summary} |" for name, suite in SUITES.items()]
    suites = [
        "## Suites",
        "",
        SUITES_SAID.format(seed=SEED),
        "",
        "| suite | logs | for |",
        "|---|---|---|",
        *rows,
    ]
    return "\n\n".join(part.strip() for part in (*parts, "\n".join(suites)))


def _defaults(family: Family) -> str:
    return ", ".join(f"{key}={value:g}" for key, value in family.parameters.items())


INTRODUCTION = """
# The catalogue of synthesised logs

<!-- written by `replan synth --markdown`; do not edit -->

A family is a kind of scenario with named parameters (the unit is in the name) and, where one is published, a grid of
their values; a cell of the grid is a log. `replan synth --list` lists them, `replan synth FAMILY -o DIR --set ...`
writes one log, `replan synth --suite NAME -o DIR` many, and `replan evaluate --suite NAME` drives them without writing
them first; NAME is a suite, a family or a group. The same name gives the same bytes.

A log is called `family@parameter=number,...`. Its metadata hold the family, all parameters, where the numbers are from,
and under `expected_decisions` what a planner may decide about which agent. The logged driver brakes with at most 3 m/s2
and 2 m/s3, and avoids all collisions. In cells where that is not enough (the grids of UN R157 and Euro NCAP have them),
the ego's log ends before the contact, and `logged_driver_would_meet` names the agent. The reference drivers decide
whether a contact could have been avoided (`reference_cc`: the careful driver of UN R157), not the planner under test.

What is ours where a publication is silent, and what is left out, stands at the head of the family's module in
`logs/catalogue`. The logs' numbers are facts taken from the named repositories; the protocols, the regulation's text
and the standard were not read.

`python -m studies.catalogue -o OUT --suite full` drives a suite and draws, per family and cell, what became
of it beside the careful driver.
"""  # noqa: E501
SUITES_SAID = """A suite is a prefix of one order of all cells (seed {seed}), so that a smaller one is part of
a larger. Each family gives a cell first, then about as many as the root of how many it has, each the farthest in its
grid from those before it (`logs/catalogue/__init__.py`). `separating` is a group, with all its cells, and no part of
the others."""  # noqa: E501
ABOUT: Mapping[str, str] = {
    "paper": "The tests of the paper. The paper gives no numbers; these are a passenger car's.",
    "everyday": "Everyday driving and traffic rules.",
    "pedestrian": "Pedestrians who do more than cross.",
    "raw": (
        "Road users as a detector sees them: jitter with drift, gaps, ids that are no "
        "identities, twins, reversed "
        "fronts, clutter. The logs hold detections; tracks are made of them where they are read."
    ),
    "euro_ncap": (
        "An ego that keeps its speed would meet the target 6 s after the start (CCRb, "
        "which brakes: later). "
        "Not here: reversing (CPRA), pedestrians at turns (CPTA), the head-on lane change (CCFhol)."
    ),
    "unece_r157": "Automated lane keeping at up to 60 km/h. Unavoidable cells are part of it.",
    "iso3888": (
        "The lanes between the cones as one lane; wider in the gaps, where the standard has "
        "no bound."
    ),
    "faults": (
        "Logs with faults of perception (scene 0 the crossing pedestrian, 1 a lead, 2 a cut-in), "
        "of the ego's start, and of lanes."
    ),
    "separating": (
        "Situations in which a fault in what a planner is fed shows "
        "([which one where](../studies/README.md#logs-that-separate)): a suite of its own."
    ),
}
"""One or two sentences on each group."""
