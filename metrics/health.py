"""Checks a log before it is driven: kind of each fault, road user, time, size, and its effect on
metrics.

`CHECKS` is the table of what is compared with what; formulas stand at the functions. A log with
findings is evaluated like any other; only phantoms change the metrics (`replan.metrics.boxes`).
`rows` has all checks of a log, also those that refuse or repair it while it is read
(`replan.logs.log_checks`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace

import pandas as pd

from replan.logs import comparisons
from replan.logs.chords import ENOUGH_M
from replan.logs.conventions import TURNED_RAD
from replan.logs.log_checks import CheckAction, LogCheck
from replan.logs.observed import MAX_AGE_S
from replan.logs.readers import admission
from replan.logs.scenario import Scenario
from replan.metrics import agent_faults, ego_faults, road_faults
from replan.metrics.boxes import DEEP_M
from replan.metrics.log_faults import FaultKind, Finding, Report

SHOWN = 5
"""Findings of one kind that a report lists."""
COLUMNS = ("log", "kind", "topic", "who", "t_from_s", "t_to_s", "value", "unit", "text", "effect")


def _reported(
    subject: str, against: str, tolerance: str, run: Report, *kinds: FaultKind
) -> LogCheck[Report]:
    """Return the row of a check that makes findings of these kinds."""
    words = " or ".join(kind.value for kind in kinds)
    return LogCheck(subject, against, tolerance, CheckAction.REPORT, f"reported: {words}", run=run)


CHECKS = (
    _reported(
        "boxes of road users",
        "the ego's box",
        f"overlaps deeper than {DEEP_M:g} m",
        agent_faults.ghosts,
        FaultKind.PHANTOM,
    ),
    _reported(
        "times of the ego's states",
        "their usual interval",
        f"{ego_faults.GAP_S:g} s, and {ego_faults.RARE:g} intervals",
        ego_faults.gaps,
        FaultKind.EGO_GAP,
    ),
    _reported(
        "steps of the ego",
        "its speed",
        f"{ego_faults.JUMP_M:g} m beyond hard braking",
        ego_faults.jumps,
        FaultKind.EGO_JUMP,
    ),
    _reported(
        "speed of the ego",
        "its positions",
        f"{ego_faults.SPEED_OFF:.0%} over {ego_faults.DISTANCE_M:g} m",
        ego_faults.speeds,
        FaultKind.EGO_SPEED,
        FaultKind.UNITS,
    ),
    _reported(
        "headings of the ego",
        "direction of motion",
        f"{TURNED_RAD:g} rad over {ego_faults.ASKEW_M:g} m",
        ego_faults.headings,
        FaultKind.EGO_HEADING,
    ),
    _reported(
        "positions of the ego",
        "its headings in bends",
        f"{ego_faults.POINT_M:g} m from the rear axle",
        ego_faults.point,
        FaultKind.EGO_POINT,
    ),
    _reported(
        "samples of a road user",
        "their usual interval",
        "a gap of the track",
        agent_faults.flickering,
        FaultKind.AGENT_GAP,
    ),
    _reported(
        "end of a track",
        "begin of another",
        f"within {agent_faults.SWITCH_S:g} s and {agent_faults.SWITCH_M:g} m",
        agent_faults.id_switches,
        FaultKind.ID_SWITCH,
    ),
    _reported(
        "steps of a road user",
        "their speed",
        f"{agent_faults.JUMP_M:g} m",
        agent_faults.teleports,
        FaultKind.TELEPORT,
    ),
    _reported(
        "speeds of road users",
        "their positions",
        f"{agent_faults.SPEED_OFF:.0%} over {agent_faults.DISTANCE_M:g} m",
        agent_faults.speeds,
        FaultKind.AGENT_SPEED,
        FaultKind.UNITS,
    ),
    _reported(
        "headings of a vehicle",
        "the sample before",
        f"{agent_faults.FLIP_RAD:g} rad within {agent_faults.FLIP_S:g} s",
        agent_faults.heading_flips,
        FaultKind.HEADING_FLIP,
    ),
    _reported(
        "headings of a vehicle",
        "direction of motion",
        f"{TURNED_RAD:g} rad in the median",
        agent_faults.headings,
        FaultKind.AGENT_HEADING,
    ),
    _reported(
        "velocity of a road user",
        "direction of motion",
        f"{TURNED_RAD:g} rad in the median over {ENOUGH_M:g} m",
        agent_faults.velocity_directions,
        FaultKind.VELOCITY,
    ),
    _reported(
        "a step of a vehicle",
        "the axis of its box",
        f"{agent_faults.ACROSS_RAD:g} rad over {agent_faults.ACROSS_M:g} m",
        agent_faults.across,
        FaultKind.ACROSS,
    ),
    _reported(
        "lengths of tracks",
        "what passing vehicles show",
        f"{agent_faults.SHORT_SHARE:.0%} below {agent_faults.SHORT} samples",
        agent_faults.short_tracks,
        FaultKind.SHORT,
    ),
    _reported(
        "centres of two road users",
        "each other",
        f"within {agent_faults.TWIN_M:g} m for {agent_faults.TWIN_S:g} s",
        agent_faults.twins,
        FaultKind.TWIN,
    ),
    _reported(
        "sizes of road users",
        "their kind",
        f"vehicles of {agent_faults.LONGEST_M:g} m by {agent_faults.WIDEST_M:g} m, people of "
        f"{agent_faults.PERSON_M:g} m",
        agent_faults.sizes,
        FaultKind.SIZE,
    ),
    _reported(
        "times with observed traffic",
        "the log's duration",
        f"{MAX_AGE_S:g} s",
        road_faults.unrecorded,
        FaultKind.TRAFFIC,
    ),
    _reported(
        "positions of the ego",
        "drivable lanes",
        f"{road_faults.OFF_SHARE:.0%} of its states",
        road_faults.off_map,
        FaultKind.OFF_MAP,
    ),
    _reported(
        "begin of a lane",
        "end of the lane before",
        f"{road_faults.APART_M:g} m",
        road_faults.lane_graph,
        FaultKind.LANE_GRAPH,
    ),
    _reported(
        "lights",
        "stop lines of the map",
        "none names the light",
        road_faults.lights,
        FaultKind.LIGHT,
    ),
    _reported(
        "goal",
        "the road, and the log's drive",
        "not reachable, or passed almost at once",
        road_faults.goal,
        FaultKind.GOAL,
    ),
)
"""What is reported, in the order of the report."""


def rows() -> Iterator[tuple[str, str, str, str, str]]:
    """Yield the rows of all checks of a log for the documentation: those that refuse or repair it
    while it is read, then those that report.
    """
    yield from comparisons.rows()
    for check in (*admission.CLOCKS, *admission.CHECKS, *admission.ROAD_CHECKS):
        yield check.row()
    yield from (check.row() for check in CHECKS)


def findings(scenario: Scenario) -> tuple[Finding, ...]:
    """Return all faults, in the order of `CHECKS`."""
    short = scenario.short_names
    runs = (check.run for check in CHECKS if check.run is not None)
    return tuple(
        replace(finding, text=short(finding.text)) for run in runs for finding in run(scenario)
    )


def sentences(faults: Iterable[Finding]) -> tuple[str, ...]:
    """Return one sentence for each kind: its first finding, the number of further ones, and the
    effect.
    """
    texts = []
    for kind, (first, *others) in _by_kind(faults).items():
        number = f" ({len(others)} more of this kind)" if others else ""
        when = f"{first.t_from:.2f} to {first.t_to:.2f} s"
        texts.append(f"Health, {kind.value}: {first.text}, {when}{number}; {kind.effect}.")
    return tuple(texts)


def report(scenario: Scenario, raw: Scenario | None = None) -> list[str]:
    """Return the findings as text for `replan inspect`: the first `SHOWN` of each kind, and the
    kind's effect.

    `raw` is the same log without the repair of its tracks, for comparison.
    """
    faults = findings(scenario)
    result = f"{len(faults)} findings" if faults else "nothing found"
    lines = [f"health: {result} by {len(CHECKS)} checks"]
    if raw is not None:
        before = Counter(finding.kind.value for finding in findings(raw))
        kinds = ", ".join(f"{count} {kind}" for kind, count in before.most_common())
        lines += [
            f"repair: {len(raw.tracks)} tracks and {before.total()} findings before,"
            f" {len(scenario.tracks)} and {len(faults)} after",
            f"    before: {kinds or 'nothing found'}",
        ]
    for kind, same in _by_kind(faults).items():
        lines.append(f"  {kind.value}: {kind.effect}")
        lines += [
            f"    {fault.t_from:.2f} to {fault.t_to:.2f} s, {fault.topic}: {fault.text}"
            for fault in same[:SHOWN]
        ]
        lines += [f"    and {len(same) - SHOWN} more"] if len(same) > SHOWN else []
    return lines


def table(log: str, faults: Iterable[Finding]) -> pd.DataFrame:
    """Return the findings as a table with `COLUMNS`."""
    rows = [
        (
            log,
            fault.kind.value,
            fault.topic,
            fault.who,
            fault.t_from,
            fault.t_to,
            fault.value,
            fault.unit,
            fault.text,
            fault.kind.effect,
        )
        for fault in faults
    ]
    return pd.DataFrame(rows, columns=list(COLUMNS)).astype(
        {"t_from_s": float, "t_to_s": float, "value": float}
    )


def _by_kind(faults: Iterable[Finding]) -> dict[FaultKind, list[Finding]]:
    """Group findings by kind, in the order of the first finding of each kind."""
    kinds: dict[FaultKind, list[Finding]] = {}
    for fault in faults:
        kinds.setdefault(fault.kind, []).append(fault)
    return kinds
