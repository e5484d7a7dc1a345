"""The public names of replan in one place: `import replan` (docs/api.md). Each is imported at its first use.

result = replan.evaluate("my_logs", planners=["dp_qp", "my_planner:Mine"], out="results/mine")
result = replan.load("results/mine")            the tables and drives of a run (docs/results.md)
replan.compare("results/main", result)          what got better, what worse, and since when

scenario = replan.from_frames(ego, agents)      a team's own log from pandas tables, in ten lines
scenario = replan.read_log("drive.mcap")        a log of any format (`replan convert --formats`)
replan.write_log("drive.mcap", scenario)        as native MCAP, for `evaluate`

replan.check_planner("my_planner:Mine")         the contract of a planner; check_metric, check_reader

The nouns of a planner (Frame, Plan, Trajectory), a metric (Trace, Scenario, Series) and all else that can be added
(docs/extend.md) have their names here, too. `python -m replan` is the command line.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

import replan.own  # noqa: F401  # our packages before others of their names

if TYPE_CHECKING:
    from logs.agents import AgentKind, Agents
    from logs.catalogue.family import Family
    from logs.errors import ConfigError, LogError, OutputError, PlannerError, ReplanError
    from logs.frame import Frame, PlannerContext, Predictions, Visibility
    from logs.mcap.writer import write_scenario as write_log
    from logs.plan import Decision, DecisionKind, Plan, PlanStatus
    from logs.readers import LogSettings, Reader, read_log
    from logs.readers.table import from_frames
    from logs.road import Goal, Lane, ReferenceLine, Road
    from logs.scenario import Scenario
    from logs.states import Command, EgoState, Trajectory
    from logs.trace import Mode, Trace
    from logs.tracks import Tracks
    from logs.vehicle import VehicleParameters
    from metrics.comparison import Comparison
    from metrics.metric import Metric, Reduction, Series, Unavailable
    from planners.base import Planner
    from replay.api import compare, evaluate
    from replay.config import LoopConfig, RunConfig
    from replay.contract import ContractError, check_metric, check_planner, check_reader
    from replay.draw.charts.canvas import Chart
    from replay.draw.charts.subject import Subject
    from replay.draw.drawn_results import DriveResult, Results, load
    from replay.mine.driven_log import Event, EventKind
    from replay.prediction import LaneMap
    from replay.traffic import Traffic
    from replay.vehicle.base import Controller, Vehicle
    from replay.world import World

__all__ = [
    "AgentKind",
    "Agents",
    "Chart",
    "Command",
    "Comparison",
    "ConfigError",
    "ContractError",
    "Controller",
    "Decision",
    "DecisionKind",
    "DriveResult",
    "EgoState",
    "Event",
    "EventKind",
    "Family",
    "Frame",
    "Goal",
    "Lane",
    "LaneMap",
    "LogError",
    "LogSettings",
    "LoopConfig",
    "Metric",
    "Mode",
    "OutputError",
    "Plan",
    "PlanStatus",
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
    "RunConfig",
    "Scenario",
    "Series",
    "Subject",
    "Trace",
    "Tracks",
    "Traffic",
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
    "from_frames",
    "load",
    "read_log",
    "write_log",
]

_NAMES = {
    "logs.agents": "AgentKind Agents",
    "logs.errors": "ConfigError LogError OutputError PlannerError ReplanError",
    "logs.catalogue.family": "Family",
    "logs.frame": "Frame PlannerContext Predictions Visibility",
    "logs.plan": "Decision DecisionKind Plan PlanStatus",
    "logs.readers": "LogSettings Reader read_log",
    "logs.readers.table": "from_frames",
    "logs.road": "Goal Lane ReferenceLine Road",
    "logs.scenario": "Scenario",
    "logs.states": "Command EgoState Trajectory",
    "logs.trace": "Mode Trace",
    "logs.tracks": "Tracks",
    "logs.vehicle": "VehicleParameters",
    "metrics.comparison": "Comparison",
    "metrics.metric": "Metric Reduction Series Unavailable",
    "planners.base": "Planner",
    "replay.api": "compare evaluate",
    "replay.config": "LoopConfig RunConfig",
    "replay.contract": "ContractError check_metric check_planner check_reader",
    "replay.prediction": "LaneMap",
    "replay.draw.charts.canvas": "Chart",
    "replay.draw.charts.subject": "Subject",
    "replay.draw.drawn_results": "DriveResult Results load",
    "replay.mine.driven_log": "Event EventKind",
    "replay.traffic": "Traffic",
    "replay.vehicle.base": "Controller Vehicle",
    "replay.world": "World",
}
_FROM = {name: (module, name) for module, names in _NAMES.items() for name in names.split()}
_FROM["write_log"] = ("logs.mcap.writer", "write_scenario")


def __getattr__(name: str) -> Any:
    """A public name, from where it stands."""
    if name not in _FROM:
        raise AttributeError(f"module 'replan' has no attribute {name!r}")
    module, own = _FROM[name]
    globals()[name] = value = getattr(import_module(module), own)
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
