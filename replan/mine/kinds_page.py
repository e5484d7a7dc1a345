"""The page docs/events.md: the tables of event kinds, with the text of events_page.toml."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

from replan.core.files import read_toml
from replan.mine.driven_log import EventKind
from replan.mine.kinds import KINDS
from replan.mine.plan_kinds import PLAN_KINDS, PlanKind

TEXT = Path(__file__).with_name("events_page.toml")


def page() -> str:
    """The text of docs/events.md."""
    text = read_toml(TEXT)
    planners = "\n## Of a planner (`--planner`)\n"
    tables = [*_table(KINDS.values()), planners, *_table(PLAN_KINDS)]
    return "\n".join([text["head"], *tables, text["own"]]).rstrip()


def _table(kinds: Iterable[EventKind | PlanKind]) -> Iterator[str]:
    yield from ("| kind | what it is | value | in doubt | source |", "|---|---|---|---|---|")
    for kind in kinds:
        unit = f", {kind.unit}" if kind.measures and kind.unit != "1" else ""
        cells = (
            f"`{kind.name}`",
            kind.meaning,
            f"{kind.measures}{unit}",
            kind.doubted,
            kind.source or "replan",
        )
        yield f"| {' | '.join(cells)} |"
