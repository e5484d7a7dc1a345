"""The page of the public names, docs/api.md: made from their signatures and docstrings.

python -c 'from replan.page import markdown; print(markdown(), end="")' > docs/api.md
"""

from __future__ import annotations

import inspect

import replan

HEAD = """# `import replan`

The public names, on one page. Everything has types (`py.typed`); `help(replan.evaluate)` says all about one. The
packages behind (`logs`, `metrics`, `planners`, `replay`) may be imported as well; only the names here stay as they are.
Their fields and arguments are in the [API reference](reference.md).
`import replan` first: then your own `metrics.py` or `logs/` is not mistaken for one of them. This page is made from the
code (`replan/page.py`).
"""
SECTIONS = {
    "Drive, judge, compare": "evaluate compare load Results DriveResult Comparison RunConfig LoopConfig",
    "Logs": "read_log from_frames write_log Scenario Trace LogSettings",
    "What a planner sees and answers": "Planner PlannerContext Frame Plan Trajectory EgoState Agents AgentKind Tracks "
    "Predictions Visibility Road Lane Goal ReferenceLine VehicleParameters PlanStatus Decision "
    "DecisionKind",
    "What a metric is": "Metric Series Reduction Unavailable Mode",
    "What else can be added (docs/extend.md)": "Vehicle Controller Command Traffic World LaneMap Reader Chart Subject "
    "Family Event EventKind",
    "Check your own": "check_planner check_metric check_reader ContractError",
    "Errors": "ReplanError ConfigError LogError PlannerError OutputError",
}


def markdown() -> str:
    """The page: each name with the first line of its docstring; a function also with its arguments by name."""
    lines = [HEAD]
    for title, names in SECTIONS.items():
        lines.append(f"## {title}\n")
        for name in names.split():
            thing, arguments = getattr(replan, name), list[str]()
            if inspect.isfunction(thing):
                for argument, one in inspect.signature(thing).parameters.items():
                    if one.kind is one.KEYWORD_ONLY and "*" not in arguments:
                        arguments.append("*")
                    arguments.append(argument)
            called = f"({', '.join(arguments)})" if inspect.isfunction(thing) else ""
            first_line = (inspect.getdoc(thing) or "").partition("\n")[0]
            lines.append(f"- `{name}{called}`: {first_line}")
        lines.append("")
    return "\n".join(lines)
