"""A log: the ego's drive, the tracks of the other road users, the road, the goal.

What reference drivers do in it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from math import nan
from types import MappingProxyType

import numpy as np

from replan.core.names import ShortNames
from replan.logs.agents import ObjectClass
from replan.logs.driving import DrivingModes
from replan.logs.observed import Spans, inferred
from replan.logs.repair.detections import Detections, Repair
from replan.logs.road import Goal, Road
from replan.logs.rules import TrafficLight
from replan.logs.states import Controls, OnboardPlan, Trajectory, joined
from replan.logs.tracks import Tracks
from replan.logs.vehicle import VehicleParameters

EGO_POSE, CENTRE = "ego_pose", "box centre"
"""Metadata entry, and its value if the log has poses of the ego's box centre instead of its rear
axle.
"""


class Avoidability(Enum):
    """Whether a reference driver avoids a collision."""

    AVOIDABLE = "avoidable"
    UNAVOIDABLE = "unavoidable"
    NOT_APPLICABLE = "not applicable"


@dataclass(frozen=True, slots=True)
class DriverVerdict:
    """The verdict of a reference driver ("cc" or "fsm") on a scenario, and its reason."""

    driver: str
    outcome: Avoidability
    reason: str
    # When it begins to brake with more than 1 m/s2, s since the scenario's start; NaN: never
    brakes: float = nan
    meets: float = nan  # when it touches an agent, s; NaN: never
    speed: float = nan  # speed at the touch, else at the end, m/s
    # id of the agent that the driver touches, else of the one that it would touch without braking;
    # "": none
    agent: str = ""
    margin: float = nan  # (1) of `replan.metrics.reference_drivers`, m; NaN without an agent
    marginal: bool = False  # whether a small change would change the verdict


@dataclass(frozen=True, slots=True)
class References:
    """The reference drives of a scenario."""

    # by driver ("cc", "fsm"); empty: the drivers did not judge the scenario
    verdicts: Mapping[str, DriverVerdict] = field(default_factory=dict)
    # How far the route follower gets along the route, m; None: it was not driven
    follower_gain: float | None = None


@dataclass(frozen=True, eq=False)
class Scenario:
    """One log: the drive, the road, and the other road users.

    Attributes:
        name: Short and unique within a run ("paper/free_road").
        ego: The driven states; one state if only the start is known.
        tracks: The other road users.
        road: The road; `road.source` tells whether the log has lanes.
        duration: Duration of the log from t = 0, s; not less than the time of the ego's last state.
        goal: The goal; None if the log has none.
        vehicle: The ego's parameters.
        controls: Logged steering and pedals, or None.
        tags: Words by which gates and reports group scenarios ("pedestrian", "recorded").
        source: Origin of the log; `licence` is its licence.
        origin: World offset `(x, y)` that the reader subtracted, m.
        start_ns: Log time of t = 0, nanoseconds.
        metadata: Other data of the log (generator, parameters, seed).
        notes: Assumptions of the reader, one sentence each, which are shown to the user.
        lights: The traffic lights that the road's stop lines name, sorted by id. A light that a
            stop line names and that is not among them was not observed.
        onboard: Plans of the on-board planner, in order of the times at which they became known.
        traffic: Spans in which the other road users were observed, if the log states them
            (`traffic_spans`).
        detections: Raw boxes, of which `replan.logs.readers` makes tracks; None: the tracks are
            complete.
        repair: The repair that made the tracks from detections; None: the tracks are the log's own.
        references: What reference drivers do in it; the replay adds them, no log holds them.
        before: States of the ego before its first one in `ego`, for the past of planners; None if
            the log has none.
        driving: Who drove the recorded car over time; None if the log does not say it.
        object_classes: What the objects among the tracks are (cone, barrier, sign), by id, where
            the log says it.

    Raises:
        ValueError: The scenario is shorter than its ego log, two lights have one id, or a traffic
            span is invalid.
    """

    name: str
    ego: Trajectory
    tracks: Tracks
    road: Road
    duration: float
    goal: Goal | None = None
    vehicle: VehicleParameters = field(default_factory=VehicleParameters)
    controls: Controls | None = None
    tags: tuple[str, ...] = ()
    source: str = ""
    licence: str = ""
    origin: tuple[float, float] = (0.0, 0.0)
    start_ns: int = 0
    metadata: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    lights: tuple[TrafficLight, ...] = ()
    onboard: tuple[OnboardPlan, ...] = ()
    traffic: Spans | None = None
    detections: Detections | None = None
    repair: Repair | None = None
    references: References = field(default_factory=References)
    before: Trajectory | None = None
    driving: DrivingModes | None = None
    object_classes: Mapping[str, ObjectClass] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "metadata", MappingProxyType(dict(self.metadata)))
        if self.duration < self.ego.t[-1] - 1e-9:
            raise ValueError(
                f"scenario lasts {self.duration} s, shorter than its ego log ({self.ego.t[-1]} s)"
            )
        object.__setattr__(self, "lights", tuple(sorted(self.lights, key=lambda light: light.id)))
        if len({light.id for light in self.lights}) < len(self.lights):
            raise ValueError("two traffic lights have the same id")
        if not all(-np.inf < first <= last < np.inf for first, last in self.traffic or ()):
            raise ValueError(
                f"traffic was observed in {self.traffic}: each span needs a finite begin and "
                "end, in order"
            )

    def in_vehicle(self, vehicle: VehicleParameters) -> Scenario:
        """Replace the ego vehicle.

        The rear axle keeps its place, or the box centre if the log has poses of it.
        """
        ahead = self.vehicle.axle_to_center - vehicle.axle_to_center
        if self.metadata.get(EGO_POSE) != CENTRE or ahead == 0.0:
            return replace(self, vehicle=vehicle)

        def shifted(ego: Trajectory) -> Trajectory:
            x, y = ego.x + ahead * np.cos(ego.yaw), ego.y + ahead * np.sin(ego.yaw)
            return replace(ego, x=x, y=y)

        return replace(self.with_ego(shifted), vehicle=vehicle)

    def with_ego(self, change: Callable[[Trajectory], Trajectory]) -> Scenario:
        """Return the scenario with a change of the ego's states, also of those before the start."""
        return replace(self, ego=change(self.ego), before=self.before and change(self.before))

    @property
    def whole_ego(self) -> Trajectory:
        """The states of the ego, with those before the start."""
        return self.ego if self.before is None else joined(self.before, self.ego)

    @cached_property
    def short_names(self) -> ShortNames:
        """The short names of its road users, for sentences and pictures."""
        return ShortNames(self.tracks.ids)

    @cached_property
    def traffic_spans(self) -> Spans:
        """Spans in which the others were observed: as stated, else inferred from the tracks
        (`replan.logs.observed`).

        They are empty for a recorded log without road users, or if all traffic ends before t = 0 or
        begins after the log's end. A log with only static road users, or a synthetic one without
        any, is observed throughout.
        """
        if self.traffic is not None:
            return self.traffic
        if self.tracks.static.all() and (len(self.tracks) or not self.is_recorded):
            return ((0.0, self.duration),)
        spans = inferred(self.tracks.offsets, self.tracks.static, self.tracks.t)
        return tuple(span for span in spans if span[1] >= 0.0 and span[0] <= self.duration)

    @property
    def family(self) -> str:
        """The group in reports: the family of the catalogue, or the group that the format defines;
        "": none.
        """
        return self.metadata.get("family", "")

    @property
    def dataset(self) -> str:
        """The data set, or else the generator or the source."""
        return self.metadata.get("dataset") or self.metadata.get("generator") or self.source

    @property
    def is_recorded(self) -> bool:
        """Whether a person drove the ego in the real world, so that a planner can be compared with
        the drive.

        The tags "recorded" and "synthetic" decide. Without them, a log that names a generator, or a
        CommonRoad file, is not recorded; any other log is recorded if it has more than one ego
        state.
        """
        if "recorded" in self.tags or "synthetic" in self.tags:
            return "synthetic" not in self.tags
        return (
            "generator" not in self.metadata and "commonroad" not in self.tags and len(self.ego) > 1
        )
