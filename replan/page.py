"""The page of the public names, docs/api.md: made from their signatures and docstrings.

python -c 'from replan.page import markdown; print(markdown(), end="")' > docs/api.md
"""

from __future__ import annotations

import inspect

import replan
from replan.core.names import first_paragraph

HEAD = """# `import replan`

The public names, on one page. Everything has types (`py.typed`); `help(replan.evaluate)` describes one of them. The
modules behind (`replan.logs`, `replan.metrics` ...) may be imported as well; only the names here stay as they are. Their
fields and arguments are in the [API reference](reference.md). `replan` is the only name that replan installs: your own
`logs/`, `metrics.py` or `planners/` stay yours. This page is made from the code (`replan/page.py`).
"""  # noqa: E501
SECTIONS = {
    (
        "Drive, judge, compare"
    ): "evaluate compare load Results DriveResult Comparison RunConfig LoopConfig",
    "Logs": "read_log from_frames write_log Scenario Trace LogSettings",
    ("What a planner sees and answers"): (
        "Planner PlannerContext Frame Past PastSource Plan Trajectory EgoState Agents AgentKind "
        "Tracks Predictions Visibility Road RoadSource Lane Goal ReferenceLine StopLine Crosswalk "
        "TrafficLight Colour VehicleParameters PlanStart PlanStatus Decision DecisionKind"
    ),
    ("What a network gets (replan.features)"): "features_of Features FeatureSizes",
    (
        "What a plan may hold for the recording"
    ): "GridCost SlGraph StGraph GraphObstacle Corridor Candidates CostTerms "
    "LaneOption SolverReport Alternative",
    ("What a metric is"): (
        "metric Metric Series Reduction MEAN MIN MAX RMS FINAL COUNT RATE SHARE Unavailable Mode "
        "PlannedFrame EndReason"
    ),
    (
        "What else can be added (docs/extend.md)"
    ): "Vehicle Controller Command Controls Traffic World LaneMap Reader Chart Subject "
    "Family Event EventKind",
    "Check your own": "check_planner check_metric check_reader ContractError",
    "Errors": "ReplanError ConfigError LogError PlannerError OutputError",
}


def markdown() -> str:
    """The page: each name with the first line of its docstring.

    A function also with its arguments by name.
    """
    lines = [HEAD]
    for title, names in SECTIONS.items():
        lines.append(f"## {title}\n")
        for name in names.split():
            thing, arguments = getattr(replan, name), list[str]()
            if inspect.isfunction(thing):
                for argument, parameter in inspect.signature(thing).parameters.items():
                    if parameter.kind is parameter.KEYWORD_ONLY and "*" not in arguments:
                        arguments.append("*")
                    arguments.append(argument)
            called = f"({', '.join(arguments)})" if inspect.isfunction(thing) else ""
            first_line = first_paragraph(thing)
            if isinstance(thing, replan.Reduction):
                first_line = f"The reduction `{thing.name}` of a series."
            lines.append(f"- `{name}{called}`: {first_line}")
        lines.append("")
    return "\n".join(lines)
