"""What is wrong with a log, before anything is driven: what, who, when, how much, and what it does to which metric.

A log with findings is evaluated as any other; only a phantom changes what is counted (`metrics.phantoms`). A new check
is one function in `CHECKS`.

Modules:
    finding.py   a finding, the kinds and their effects
    ego.py       gaps, jumps, speed and heading of the ego's log
    agents.py    flickering, id switches, teleports, speeds, headings, twins, sizes
    road.py      the map under the drive, the lane graph, lights
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from math import isfinite

import pandas as pd

from logs.scenario import Scenario
from metrics.health import agents, ego, road
from metrics.health.finding import EFFECT, Finding, Kind
from metrics.phantoms import phantoms

__all__ = ["CHECKS", "COLUMNS", "EFFECT", "Finding", "Kind", "findings", "report", "sentences", "table"]


def ghosts(scenario: Scenario) -> Iterator[Finding]:
    """Boxes in which the recorded ego stood."""
    for phantom in phantoms(scenario):
        begin = phantom.t_from if isfinite(phantom.t_from) else 0.0
        end = phantom.t_to if isfinite(phantom.t_to) else scenario.duration
        text = f"the logged ego stands in {phantom.name}, which is left out for {end - begin:.1f} s"
        yield Finding(Kind.PHANTOM, "agents", phantom.agent, begin, end, end - begin, "s", text)


CHECKS: tuple[Callable[[Scenario], Iterable[Finding]], ...] = (
    ghosts, ego.gaps, ego.jumps, ego.speed, ego.heading, agents.flickering, agents.id_switches, agents.teleports,
    agents.speeds, agents.heading_flips, agents.twins, agents.sizes, agents.unrecorded,
    road.off_map, road.lane_graph, road.lights,
)  # fmt: skip
"""All that is looked for, in the order of the report."""
SHOWN = 5
"""Findings of one kind that a report lists."""
COLUMNS = ("log", "kind", "topic", "who", "t_from_s", "t_to_s", "value", "unit", "text", "effect")


def findings(scenario: Scenario) -> tuple[Finding, ...]:
    """All that is wrong, in the order of `CHECKS`."""
    return tuple(finding for check in CHECKS for finding in check(scenario))


def sentences(found: Iterable[Finding]) -> tuple[str, ...]:
    """One sentence for each kind: the first of it, how many more there are, and what that does."""
    first: dict[Kind, Finding] = {}
    counts: Counter[Kind] = Counter()
    for finding in found:
        first.setdefault(finding.kind, finding)
        counts[finding.kind] += 1
    out = []
    for kind, finding in first.items():
        more = f" ({counts[kind] - 1} more of this kind)" if counts[kind] > 1 else ""
        when = f"{finding.t_from:.2f} to {finding.t_to:.2f} s"
        out.append(f"Health, {kind.value}: {finding.text}, {when}{more}; {EFFECT[kind]}.")
    return tuple(out)


def report(scenario: Scenario) -> list[str]:
    """All findings in words, for `replan inspect`: the first `SHOWN` of each kind, and what the kind does."""
    found = findings(scenario)
    if not found:
        return [f"health: nothing found by {len(CHECKS)} checks"]
    out = [f"health: {len(found)} findings by {len(CHECKS)} checks"]
    for kind in dict.fromkeys(one.kind for one in found):
        same = [one for one in found if one.kind is kind]
        out.append(f"  {kind.value}: {EFFECT[kind]}")
        out += [f"    {one.t_from:.2f} to {one.t_to:.2f} s, {one.topic}: {one.text}" for one in same[:SHOWN]]
        out += [f"    and {len(same) - SHOWN} more"] if len(same) > SHOWN else []
    return out


def table(log: str, found: Iterable[Finding]) -> pd.DataFrame:
    """The findings as rows of `COLUMNS`."""
    rows = [
        (log, one.kind.value, one.topic, one.who, one.t_from, one.t_to, one.value, one.unit, one.text, one.effect)
        for one in found
    ]
    return pd.DataFrame(rows, columns=list(COLUMNS)).astype({"t_from_s": float, "t_to_s": float, "value": float})
