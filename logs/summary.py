"""Summarises a log: its content, the times of its traffic, and the evaluations that it allows.

For damaged or unknown files, the summary has the topics up to the damage and the error of reading
the log.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from replan.core.errors import LogError
from replan.core.files import check_regular
from replan.core.names import counted
from replan.logs.forward import described as described_reversals, forward_part, reversals
from replan.logs.observed import ENOUGH, MAX_AGE_S, clipped, described
from replan.logs.readers import LogSettings, read_log, reader_of
from replan.logs.readers.base import LogContents, TopicSummary
from replan.logs.road import Goal, RoadSource
from replan.logs.route import goal_fault
from replan.logs.scenario import Scenario
from replan.logs.vehicle import VEHICLE_ASSUMED, VehicleParameters


@dataclass(frozen=True)
class Evaluation:
    """One evaluation: whether it is possible, and the data that it uses or lacks."""

    name: str
    possible: bool
    reason: str


@dataclass(frozen=True)
class LogSummary:
    """Summary of a log; `scenario` has the facts about `read`.

    If it cannot be read, both are None: `error` is why.
    """

    path: Path
    profile: str
    size_bytes: int
    topics: tuple[TopicSummary, ...]
    scenario: dict[str, Any] | None
    evaluations: tuple[Evaluation, ...]
    error: LogError | None
    read: Scenario | None = None

    def lines(self) -> list[str]:
        """Return the summary as lines of text."""
        lines = [f"{self.path.name}: {self.profile}, {self.size_bytes / 1024:.0f} KiB"]
        for topic in self.topics:
            line = (
                f"  {topic.topic}: {topic.messages} x {topic.schema or 'no schema'} "
                f"({topic.encoding})"
            )
            if topic.first_ns is not None and topic.last_ns is not None:
                line += f", {topic.first_ns / 1e9:.3f} to {topic.last_ns / 1e9:.3f} s"
            lines.append(line)
        if self.scenario is not None:
            lines += _describe_facts(self.scenario)
        lines += [
            f"{'yes' if e.possible else 'no ':3}  {e.name}: {e.reason}" for e in self.evaluations
        ]
        if self.error is not None:
            lines.append(f"error: {self.error}")
        return lines


def summarise(path: Path, settings: LogSettings | None = None) -> LogSummary:
    """Summarise a log of any format.

    Damage and unknown formats are reported in `error`, never raised.
    """
    reader, scenario, error = reader_of(path, settings), None, None
    contents, files = LogContents("not a log that replan reads"), tuple[Path, ...]((path,))
    try:
        if reader is not None:
            contents, files = LogContents(), reader.files(path)
            check_regular(*files)
            contents = reader.contents(path)
        scenario = read_log(path, settings)
    except LogError as refusal:
        error = refusal if refusal.file is not None else refusal.at(path)
    has_vehicle = False
    if scenario is not None and not any(
        note.startswith(VEHICLE_ASSUMED) for note in scenario.notes
    ):
        in_log = any(topic.topic == "/vehicle" for topic in contents.topics)
        has_vehicle = in_log or scenario.vehicle != VehicleParameters()
    return LogSummary(
        path,
        contents.profile or (reader.summary if reader is not None else ""),
        sum(file.stat().st_size for file in files if file.is_file()),
        contents.topics,
        None if scenario is None else _facts(scenario),
        () if scenario is None else evaluations(scenario, has_vehicle=has_vehicle),
        error,
        scenario,
    )


def _facts(scenario: Scenario) -> dict[str, Any]:
    """Return what a scenario holds; speeds in m/s, times in s, rates in Hz (NaN for one state),
    lengths of lanes in km.

    `traffic` are the spans in which the others were observed, `agents` the numbers of moving ones
    by kind, `obstacles` that of static ones. Of the stop lines, `with_light` obey a light, and
    `must_stop` a stop sign.
    """
    ego, tracks, road = scenario.ego, scenario.tracks, scenario.road
    lanes, span = road.lanes.values(), float(ego.t[-1] - ego.t[0])
    kinds = Counter(
        kind.value for kind, static in zip(tracks.kinds, tracks.static, strict=True) if not static
    )
    return {
        "name": scenario.name,
        "source": scenario.source,
        "licence": scenario.licence,
        "tags": scenario.tags,
        "duration": scenario.duration,
        "origin": scenario.origin,
        "traffic": scenario.traffic_spans,
        "ego_samples": len(ego),
        "ego_span": (float(ego.t[0]), float(ego.t[-1])),
        "ego_rate": (len(ego) - 1) / span if span > 0.0 else float("nan"),
        "ego_speed": (float(ego.v.min()), float(ego.v.max())),
        "driving": (
            f"{scenario.driving.described(*ego.t[[0, -1]])} ({scenario.driving.source})"
            if scenario.driving is not None
            else ""
        ),
        "agents": dict(kinds.most_common()),
        "obstacles": int(tracks.static.sum()),
        "road": {
            "source": road.source.value,
            "lanes": len(lanes),
            "drivable": sum(lane.drivable for lane in lanes),
            "length_km": sum(lane.length for lane in lanes) / 1000.0,
            "without_speed_limit": sum(not np.isfinite(lane.speed_limit) for lane in lanes),
            "default_speed_limit": road.default_speed_limit,
            "stop_lines": len(road.stop_lines),
            "with_light": sum(line.light is not None for line in road.stop_lines),
            "must_stop": sum(line.must_stop for line in road.stop_lines),
            "crosswalks": len(road.crosswalks),
            "giving_way": sum(bool(lane.yields_to) for lane in lanes),
        },
        "lights": len(scenario.lights),
        "goal": None if scenario.goal is None else _describe_goal(scenario.goal),
        "controls": 0 if scenario.controls is None else len(scenario.controls),
        "metadata": scenario.metadata,
        "notes": scenario.notes,
    }


def _describe_facts(found: dict[str, Any]) -> list[str]:
    road, agents = (
        found["road"],
        ", ".join(counted(count, kind) for kind, count in found["agents"].items()),
    )
    ego = (
        f"{counted(found['ego_samples'], 'state')} from {found['ego_span'][0]:.2f} to "
        f"{found['ego_span'][1]:.2f} s"
    )
    if found["ego_samples"] > 1:
        ego += (
            f" ({found['ego_rate']:.1f} Hz), {found['ego_speed'][0]:.1f} to "
            f"{found['ego_speed'][1]:.1f} m/s"
        )
    signs = f"{road['with_light']} with a light, {road['must_stop']} with a stop sign"
    return [
        f"name: {found['name']}" + (f" [{', '.join(found['tags'])}]" if found["tags"] else ""),
        f"source: {found['source'] or 'not stated'}; licence: {found['licence'] or 'not stated'}",
        f"duration: {found['duration']:.2f} s",
        "origin: {:.12g}, {:.12g} m, subtracted from all positions".format(*found["origin"]),
        f"ego: {ego}",
        *([f"driven: {found['driving']}"] if found["driving"] else []),
        f"agents: {agents or 'none'}; obstacles: {found['obstacles']}; recorded "
        f"{described(found['traffic'])} of {found['duration']:.1f} s",
        f"road: {counted(road['lanes'], 'lane')} ({road['drivable']} drivable), "
        f"{road['length_km']:.2f} km,"
        f" {road['without_speed_limit']} without speed limit; {road['source']}",
        f"rules: {counted(road['stop_lines'], 'stop line')} ({signs}), "
        f"{counted(found['lights'], 'light')}, {counted(road['crosswalks'], 'crosswalk')}, "
        f"{counted(road['giving_way'], 'lane')} giving way",
        f"goal: {found['goal'] or 'none'}",
        *(f"metadata {key}: {value}" for key, value in found["metadata"].items()),
        *(f"note: {note}" for note in found["notes"]),
    ]


def _describe_goal(goal: Goal) -> str:
    if goal.alternatives:
        return "; or ".join(map(_describe_goal, goal.alternatives))
    parts = [f"in {len(goal.regions)} region(s)" if goal.regions else "at any place"]
    for word, interval, unit in (
        ("time", goal.t, "s"),
        ("speed", goal.v, "m/s"),
        ("heading", goal.yaw, "rad"),
    ):
        if interval is not None:
            parts.append(f"{word} {interval[0]:g} to {interval[1]:g} {unit}")
    return ", ".join(parts)


def evaluations(scenario: Scenario, *, has_vehicle: bool) -> tuple[Evaluation, ...]:
    """Return all evaluations with whether the scenario allows them; `has_vehicle`: the log
    describes the vehicle.
    """
    ego, tracks, road = scenario.ego, scenario.tracks, scenario.road
    lanes = road.source is RoadSource.LANES
    unlimited = sum(not np.isfinite(lane.speed_limit) for lane in road.lanes.values())
    compared = (
        f"{len(ego)} ego states to compare with"
        if len(ego) > 1
        else "one ego state only: nothing to compare"
    )
    lasting = (
        f"{scenario.duration:.1f} s to drive" if scenario.duration > 0.0 else "the log lasts 0 s"
    )
    backward = reversals(ego) if road.source is RoadSource.DRIVEN_PATH else ()
    part = forward_part(ego, backward)
    if backward:
        span = f"from {ego.t[part[0]]:.1f} to {ego.t[part[1]]:.1f} s" if part else "nowhere"
        lasting = f"forward {span}; the log reverses from {described_reversals(ego, backward)}"
    alone = "no other road users in the log: only comfort, progress and lanes"
    recorded = clipped(scenario.traffic_spans, 0.0, scenario.duration)
    others = counted(len(tracks), "other") if len(tracks) else alone
    known_s = sum(last - first for first, last in recorded)
    met = known_s >= ENOUGH * scenario.duration
    if known_s < scenario.duration - MAX_AGE_S:
        others += f"; traffic is recorded {described(recorded)} of {scenario.duration:.1f} s"
    limits = (
        f"{unlimited} of {len(road.lanes)} lanes have none: {road.default_speed_limit:.1f} "
        "m/s is assumed there"
    )
    vehicle = "the log's vehicle" if has_vehicle else "vehicle partly or all assumed"
    controls = scenario.controls is not None
    shown = {light.id for light in scenario.lights}
    counts = {
        "stop line": sum(line.light in shown for line in road.stop_lines),
        "stop sign": sum(line.must_stop for line in road.stop_lines),
        "crosswalk": len(road.crosswalks),
        "lane": sum(bool(lane.yields_to) for lane in road.lanes.values()),
    }
    detail = {"stop line": " with a light", "lane": " giving way"}
    rules = ", ".join(
        f"{counted(count, name)}{detail.get(name, '')}" for name, count in counts.items() if count
    )
    goal = scenario.goal
    fault = goal and goal_fault(road, ego, goal, scenario.vehicle.axle_to_center)
    goal_text = "no goal" if goal is None else "named in the log"
    if fault:
        goal_text = fault.value
    return (
        Evaluation("open loop against the driven ego", len(ego) > 1 and part is not None, compared),
        Evaluation("closed loop", scenario.duration > 0.0 and part is not None, lasting),
        Evaluation("collisions, gaps, time to collision", len(tracks) > 0 and met, others),
        Evaluation("goal reached", goal is not None and fault is None, goal_text),
        Evaluation("off road, lane keeping", lanes, road.source.value),
        Evaluation(
            "speed limits", lanes and unlimited < len(road.lanes), limits if lanes else "no lanes"
        ),
        Evaluation(
            "lights, stop signs, crosswalks, right of way",
            bool(rules),
            rules or "the log names none",
        ),
        Evaluation("tracking", scenario.duration > 0.0, vehicle),
        Evaluation(
            "steering and pedals against the log",
            controls,
            "logged" if controls else "no /controls",
        ),
    )
