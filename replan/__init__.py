"""The public names of replan in one place: `import replan` (docs/api.md). Each is imported at its
first use.

result = replan.evaluate("my_logs", planners=["dp_qp", "my_planner:Mine"], out="results/mine")
result = replan.load("results/mine")            the tables and drives of a run (docs/results.md)
replan.compare("results/main", result)          what got better, what worse, and since when

scenario = replan.from_frames(ego, agents)      a team's own log from pandas tables, in ten lines
scenario = replan.read_log("drive.mcap")        a log of any format (`replan convert --formats`)
replan.write_log("drive.mcap", scenario)        as native MCAP, for `evaluate`

replan.check_planner("my_planner:Mine")         the contract of a planner; check_metric,
                                                check_reader

The nouns of a planner (Frame, Plan, Trajectory), a metric (Trace, Scenario, Series) and all else
that can be added (docs/extend.md) have their names here, too. `python -m replan` is the command
line.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from replan.core.former_names import explain_former_names

if TYPE_CHECKING:
    from replan.api import compare, evaluate
    from replan.config import RunConfig
    from replan.contract import ContractError, check_metric, check_planner, check_reader
    from replan.core.errors import ConfigError, LogError, OutputError, PlannerError, ReplanError
    from replan.draw.charts.chart import Chart
    from replan.draw.charts.subject import Subject
    from replan.draw.drawn_results import DriveResult, Results, load
    from replan.features import Features, FeatureSizes, features_of
    from replan.logs.agents import AgentKind, Agents
    from replan.logs.catalogue.family import Family
    from replan.logs.frame import Frame, PlannerContext, Predictions, Visibility
    from replan.logs.mcap.writer import write_scenario as write_log
    from replan.logs.past import Past, PastSource
    from replan.logs.plan import (
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
    from replan.logs.readers import LogSettings, Reader, read_log
    from replan.logs.readers.table import from_frames
    from replan.logs.reference_line import ReferenceLine
    from replan.logs.road import Goal, Lane, Road, RoadSource
    from replan.logs.rules import Colour, Crosswalk, StopLine, TrafficLight
    from replan.logs.scenario import Scenario
    from replan.logs.states import Alternative, Command, Controls, EgoState, Trajectory
    from replan.logs.trace import EndReason, Mode, PlannedFrame, Trace
    from replan.logs.tracks import Tracks
    from replan.logs.vehicle import VehicleParameters
    from replan.metrics.comparison import Comparison
    from replan.metrics.metric import Metric, Reduction, Series, Unavailable, metric
    from replan.metrics.reductions import COUNT, FINAL, MAX, MEAN, MIN, RATE, RMS, SHARE
    from replan.mine.driven_log import Event, EventKind
    from replan.planners.base import Planner
    from replan.replay.loop_config import LoopConfig
    from replan.replay.prediction import LaneMap
    from replan.replay.traffic import Traffic
    from replan.replay.vehicle.base import Controller, Vehicle
    from replan.replay.world import World

__all__ = [
    "COUNT",
    "FINAL",
    "MAX",
    "MEAN",
    "MIN",
    "RATE",
    "RMS",
    "SHARE",
    "AgentKind",
    "Agents",
    "Alternative",
    "Candidates",
    "Chart",
    "Colour",
    "Command",
    "Comparison",
    "ConfigError",
    "ContractError",
    "Controller",
    "Controls",
    "Corridor",
    "CostTerms",
    "Crosswalk",
    "Decision",
    "DecisionKind",
    "DriveResult",
    "EgoState",
    "EndReason",
    "Event",
    "EventKind",
    "Family",
    "FeatureSizes",
    "Features",
    "Frame",
    "Goal",
    "GraphObstacle",
    "GridCost",
    "Lane",
    "LaneMap",
    "LaneOption",
    "LogError",
    "LogSettings",
    "LoopConfig",
    "Metric",
    "Mode",
    "OutputError",
    "Past",
    "PastSource",
    "Plan",
    "PlanStart",
    "PlanStatus",
    "PlannedFrame",
    "Planner",
    "PlannerContext",
    "PlannerError",
    "Predictions",
    "Reader",
    "Reduction",
    "ReferenceLine",
    "ReplanError",
    "Results",
    "Road",
    "RoadSource",
    "RunConfig",
    "Scenario",
    "Series",
    "SlGraph",
    "SolverReport",
    "StGraph",
    "StopLine",
    "Subject",
    "Trace",
    "Tracks",
    "Traffic",
    "TrafficLight",
    "Trajectory",
    "Unavailable",
    "Vehicle",
    "VehicleParameters",
    "Visibility",
    "World",
    "check_metric",
    "check_planner",
    "check_reader",
    "compare",
    "evaluate",
    "features_of",
    "from_frames",
    "load",
    "metric",
    "read_log",
    "write_log",
]

_NAMES = {
    "replan.api": "compare evaluate",
    "replan.config": "RunConfig",
    "replan.contract": "ContractError check_metric check_planner check_reader",
    "replan.core.errors": "ConfigError LogError OutputError PlannerError ReplanError",
    "replan.draw.charts.chart": "Chart",
    "replan.draw.charts.subject": "Subject",
    "replan.draw.drawn_results": "DriveResult Results load",
    "replan.features": "FeatureSizes Features features_of",
    "replan.logs.agents": "AgentKind Agents",
    "replan.logs.catalogue.family": "Family",
    "replan.logs.frame": "Frame PlannerContext Predictions Visibility",
    "replan.logs.past": "Past PastSource",
    "replan.logs.plan": (
        "Candidates Corridor CostTerms Decision DecisionKind GraphObstacle "
        "GridCost LaneOption Plan PlanStart PlanStatus SlGraph SolverReport StGraph"
    ),
    "replan.logs.readers": "LogSettings Reader read_log",
    "replan.logs.readers.table": "from_frames",
    "replan.logs.reference_line": "ReferenceLine",
    "replan.logs.road": "Goal Lane Road RoadSource",
    "replan.logs.rules": "Colour Crosswalk StopLine TrafficLight",
    "replan.logs.scenario": "Scenario",
    "replan.logs.states": "Alternative Command Controls EgoState Trajectory",
    "replan.logs.trace": "EndReason Mode PlannedFrame Trace",
    "replan.logs.tracks": "Tracks",
    "replan.logs.vehicle": "VehicleParameters",
    "replan.metrics.comparison": "Comparison",
    "replan.metrics.metric": "Metric Reduction Series Unavailable metric",
    "replan.metrics.reductions": "COUNT FINAL MAX MEAN MIN RATE RMS SHARE",
    "replan.mine.driven_log": "Event EventKind",
    "replan.planners.base": "Planner",
    "replan.replay.loop_config": "LoopConfig",
    "replan.replay.prediction": "LaneMap",
    "replan.replay.traffic": "Traffic",
    "replan.replay.vehicle.base": "Controller Vehicle",
    "replan.replay.world": "World",
}
_FROM = {name: (module, name) for module, names in _NAMES.items() for name in names.split()}
_FROM["write_log"] = ("replan.logs.mcap.writer", "write_scenario")

explain_former_names()


if not TYPE_CHECKING:  # with `__getattr__` visible, a type checker would accept any name

    def __getattr__(name: str) -> Any:
        """Import a public name at its first use."""
        if name not in _FROM:
            raise AttributeError(f"module 'replan' has no attribute {name!r}")
        module, own = _FROM[name]
        globals()[name] = value = getattr(import_module(module), own)
        return value


def __dir__() -> list[str]:
    return sorted(__all__)
