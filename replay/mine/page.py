"""docs/events.md: the kinds of events, made of their table."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from replay.mine.events import EventKind
from replay.mine.kinds import KINDS
from replay.mine.plan_events import PLAN_KINDS

HEAD = """# Events: what `replan mine` finds

<!-- written by `replan mine --markdown`; do not edit -->

Each kind is one small function over a log that is laid out on a grid of 0.1 s (`replay/mine/driven_log.py`). *The path*
is the way that the recorded ego took, *the band* a strip along it as wide as the ego. A column of
[events.parquet](results.md) says what a kind measures. Where a log lacks what a kind needs, or holds no drive, the kind
is not looked for, and `logs.parquet` says so.
"""
OWN = """
## A kind of your own

```python
# my_kinds.py
import replan


def _creeps(log):
    from replay.mine.driven_log import runs

    for first, last in runs((log.ego.v > 0.1) & (log.ego.v < 1.0), least=30):
        yield replan.Event(log.t[first], log.t[last], float(log.ego.v[first : last + 1].max()))


CREEPS = replan.EventKind("creeps", _creeps, "The ego drives below 1 m/s for 3 s.", "greatest speed", "m/s")
```

It is named on the command line, or found by an entry point of the group `replan.events`:

```sh
replan synth everyday/crosswalk -o my_logs
replan mine my_logs --kind my_kinds:CREEPS -o results/mined
```
"""


def page() -> str:
    """docs/events.md."""
    planners = "\n## Of a planner (`--planner`)\n"
    return "\n".join([HEAD, *_rows(KINDS.values()), planners, *_rows(PLAN_KINDS.values()), OWN]).rstrip()


def _rows(kinds: Iterable[EventKind]) -> Iterator[str]:
    yield from ("| kind | what it is | value | source |", "|---|---|---|---|")
    for kind in kinds:
        value = f"{kind.measures}, {kind.unit}" if kind.measures and kind.unit != "1" else kind.measures
        yield f"| `{kind.name}` | {kind.meaning} | {value} | {kind.source or 'replan'} |"
