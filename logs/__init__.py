"""Logs: the shared data classes, readers and writers.

Frames: world W (unsuffixed), `_ego` (x forward, y left), `_frenet` (s along, l left). The ego's reference point is its
rear axle, an agent's the centre of its box. SI units inside; units stand in names only at the edges (files, options,
tables). Time: integer nanoseconds in logs and loops, seconds since the scenario's start inside numerics.

    Scenario      a log: ego, tracks of the road users, road, goal
    EgoState      the ego at one instant           Trajectory    ego states over time
    Agents        road users at one instant        Tracks        road users over time
    Frame         the input of a planner           Predictions   predicted futures of the agents
    Plan          the output of a planner          Command       steering and pedals
    Trace         one drive of one planner
    Road, Lane, Goal, ReferenceLine                the road and the goal on it
    StopLine, Crosswalk, TrafficLight, Colour      traffic rules
    VehicleParameters                              the ego's vehicle

Each name is imported on first use, so that the command line, which needs only the errors, starts without numba.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

import replan.own

if TYPE_CHECKING:
    from logs.agents import AgentKind, Agents
    from logs.errors import ConfigError, LogError, PlannerError, ReplanError
    from logs.frame import Frame, PlannerContext, Predictions, Visibility
    from logs.plan import (
        Candidates,
        Corridor,
        CostTerms,
        Decision,
        DecisionKind,
        GraphObstacle,
        GridCost,
        LaneOption,
        Plan,
        PlanStart,
        PlanStatus,
        SlGraph,
        SolverReport,
        StGraph,
    )
    from logs.road import Goal, Lane, ReferenceLine, Road, RoadSource
    from logs.rules import Colour, Crosswalk, StopLine, TrafficLight
    from logs.scenario import Scenario
    from logs.states import Command, Controls, EgoState, Trajectory, wrap
    from logs.trace import EndReason, Mode, PlannedFrame, Trace, TrackingErrors
    from logs.tracks import Tracks
    from logs.vehicle import VehicleParameters

__all__ = [
    "AgentKind", "Agents", "Candidates", "Colour", "Command", "ConfigError", "Controls", "Corridor", "CostTerms",
    "Crosswalk", "Decision", "DecisionKind", "EgoState", "EndReason", "Frame", "Goal", "GraphObstacle", "GridCost",
    "Lane", "LaneOption", "LogError", "Mode", "Plan", "PlanStart", "PlanStatus", "PlannedFrame", "PlannerContext",
    "PlannerError", "Predictions", "ReferenceLine", "ReplanError", "Road", "RoadSource", "Scenario", "SlGraph",
    "SolverReport", "StGraph", "StopLine", "Trace", "TrackingErrors", "Tracks", "TrafficLight", "Trajectory",
    "VehicleParameters", "Visibility", "wrap",
]  # fmt: skip

_NAMES = {
    "logs.agents": "AgentKind Agents",
    "logs.errors": "ConfigError LogError PlannerError ReplanError",
    "logs.frame": "Frame PlannerContext Predictions Visibility",
    "logs.plan": "Candidates Corridor CostTerms Decision DecisionKind GraphObstacle GridCost LaneOption Plan PlanStart "
    "PlanStatus SlGraph SolverReport StGraph",
    "logs.road": "Goal Lane ReferenceLine Road RoadSource",
    "logs.rules": "Colour Crosswalk StopLine TrafficLight",
    "logs.scenario": "Scenario",
    "logs.states": "Command Controls EgoState Trajectory wrap",
    "logs.trace": "EndReason Mode PlannedFrame Trace TrackingErrors",
    "logs.tracks": "Tracks",
    "logs.vehicle": "VehicleParameters",
}
_FROM = {name: module for module, names in _NAMES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    """Import a name from its module on first use."""
    if name not in _FROM:
        return replan.own.missing("logs")(name)
    globals()[name] = value = getattr(import_module(_FROM[name]), name)
    return value
