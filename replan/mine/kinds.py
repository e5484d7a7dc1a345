"""The table of event kinds, the events of a planner over a log, and their page docs/events.md.

A planner plans open loop: events say where its plans differ from the recorded drive, fall back, or
flip, by the metrics of plans (`replan.metrics.accuracy`, `replan.metrics.plans`). A frame differs
if its plan misses the recorded drive within 3 s (`miss.3s`), and flips if it is more than
`FLIP_M` to the side of the plan before it (`plan_change_lateral`).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from types import MappingProxyType

import numpy as np

from replan.config import RunConfig
from replan.core.errors import PlannerError
from replan.core.extension import ExtensionKind, an_instance
from replan.logs.trace import EndReason
from replan.metrics.accuracy import MISS_M, fde, miss
from replan.metrics.metric import Series
from replan.metrics.plans import plan_change_lateral
from replan.mine.conflicts import CONFLICTS
from replan.mine.driven_log import DrivenLog, Event, EventKind, runs
from replan.mine.ego_and_road import EGO_AND_ROAD
from replan.mine.road_users import ROAD_USERS
from replan.replay.loop.open_loop import run_open_loop

KINDS: Mapping[str, EventKind] = MappingProxyType(
    {each.name: each for each in (*ROAD_USERS, *EGO_AND_ROAD, *CONFLICTS)}
)
"""The built-in event kinds by name."""
EVENT_KIND: ExtensionKind[EventKind] = ExtensionKind(
    "event kind", "events", KINDS, an_instance(EventKind, "replan.EventKind")
)
"""Finds event kinds by name: the built-in ones and those of users."""
HORIZON_S = 3
FLIP_M = 1.0


def _of_planners(log: DrivenLog) -> tuple[Event, ...]:
    """Return no events: `plan_events`, which needs a planner, finds these kinds."""
    return ()


PLAN_KINDS: Mapping[str, EventKind] = MappingProxyType(
    {
        kind.name: kind
        for kind in (
            EventKind(
                "plan_differs",
                _of_planners,
                f"The plan is more than {MISS_M[HORIZON_S]:g} m from what was driven within "
                f"{HORIZON_S} s.",
                f"greatest distance at {HORIZON_S} s",
                "m",
                "nuPlan, planner_miss_rate_within_bound",
            ),
            EventKind(
                "plan_falls_back", _of_planners, "The planner falls back; `what` is its reason."
            ),
            EventKind(
                "plan_flips",
                _of_planners,
                f"A plan is more than {FLIP_M:g} m to the side of the plan before it.",
                "greatest lateral distance",
                "m",
                "after Autoware's stability",
            ),
        )
    }
)


def plan_events(log: DrivenLog, planner: str, run: RunConfig) -> Iterator[tuple[str, Event]]:
    """The kinds and events of a planner over a log.

    Raises:
        ReplanError: The planner failed, or cannot be built.
    """
    keywords = run.planner_keywords(planner)
    drive = run_open_loop(
        log.scenario, planner, planner_config=keywords, config=run.drive_loop, keep_internals=False
    )
    trace = drive.trace
    if trace.end is EndReason.PLANNER_FAILURE:
        raise PlannerError(trace.detail)
    t = np.array([frame.t for frame in trace.frames])
    fallback = np.array([frame.plan.status.is_fallback for frame in trace.frames])
    for first, last in runs(fallback):
        reason = trace.frames[first].plan.reason or trace.frames[first].plan.status.value
        yield "plan_falls_back", Event(float(t[first]), float(t[last]), np.nan, what=reason)
    for name, metric, part, bound in (
        ("plan_differs", miss, f"{HORIZON_S}s", 0.5),
        ("plan_flips", plan_change_lateral, "", FLIP_M),
    ):
        found = metric.measured(trace, log.scenario).get(
            f"{metric.name}.{part}" if part else metric.name
        )
        value = fde.measured(trace, log.scenario).get(f"fde.{part}") if part else found
        if isinstance(found, Series) and isinstance(value, Series):
            for first, last in runs(found.value > bound, hole=2):
                most = float(np.nanmax(value.value[first : last + 1]))
                yield name, Event(float(found.t[first]), float(found.t[last]), most)


HEAD = """# Events: what `replan mine` finds

<!-- written by `replan mine --markdown`; do not edit -->

Each kind is one small function over a log that is laid out on a grid of 0.1 s (`replan/mine/driven_log.py`). *The path*
is the way that the recorded ego took, *the band* a strip along it as wide as the ego. A column of
[events.parquet](results.md) says what a kind measures. Where a log lacks what a kind needs, or holds no drive, the kind
is not looked for, and `logs.parquet` says so.
"""  # noqa: E501
OWN = """
## A kind of your own

```python
# my_kinds.py
import replan


def _creeps(log):
    from replan.mine.driven_log import runs

    for first, last in runs((log.ego.v > 0.1) & (log.ego.v < 1.0), least=30):
        yield replan.Event(log.t[first], log.t[last], float(log.ego.v[first : last + 1].max()))


CREEPS = replan.EventKind(
    "creeps", _creeps, "The ego drives below 1 m/s for 3 s.", "greatest speed", "m/s"
)
```

It is named on the command line, or found by an entry point of the group
`project.entry-points."replan.events"`:

```sh
replan synth everyday/crosswalk -o my_logs
replan mine my_logs --kind my_kinds:CREEPS -o results/mined
```
"""


def page() -> str:
    """The text of docs/events.md."""
    planners = "\n## Of a planner (`--planner`)\n"
    return "\n".join(
        [HEAD, *_rows(KINDS.values()), planners, *_rows(PLAN_KINDS.values()), OWN]
    ).rstrip()


def _rows(kinds: Iterable[EventKind]) -> Iterator[str]:
    yield from ("| kind | what it is | value | in doubt | source |", "|---|---|---|---|---|")
    for kind in kinds:
        value = (
            f"{kind.measures}, {kind.unit}" if kind.measures and kind.unit != "1" else kind.measures
        )
        yield (
            f"| `{kind.name}` | {kind.meaning} | {value} | {kind.doubted} | "
            f"{kind.source or 'replan'} |"
        )
