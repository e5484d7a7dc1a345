"""The page of the public names, docs/api.md: made from their signatures and docstrings.

python -c 'from replan.page import markdown; print(markdown(), end="")' > docs/api.md
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any

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
    "Errors": "ReplanError ConfigError LogError PlannerError OutputError",
}


def markdown() -> str:
    """The page."""
    return "\n".join([HEAD, *(line for title, names in SECTIONS.items() for line in _section(title, names.split()))])


def _section(title: str, names: list[str]) -> Iterator[str]:
    yield f"## {title}\n"
    for name in names:
        thing = getattr(replan, name)
        says = (inspect.getdoc(thing) or "").partition("\n")[0]
        yield f"- `{name}{_called(thing)}`: {says}"
    yield ""


def _called(thing: Any) -> str:
    """Of a function its arguments, by name; those with defaults behind `*` are left out where they are many."""
    if not inspect.isfunction(thing):
        return ""
    words = []
    for name, one in inspect.signature(thing).parameters.items():
        if one.kind is one.KEYWORD_ONLY and "*" not in words:
            words.append("*")
        words.append(name)
    return f"({', '.join(words)})"
