"""What a report shows of a drive, and of all drives of a planner: which metrics, how written, what deserves colour."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Column:
    """One metric of the table of drives.

    Attributes:
        title: With the unit, lines short.
        metric: Row of the metric table.
        mode: Loop in which it was measured.
        show: Value to text.
        bad: Whether the value deserves colour.
    """

    title: str
    metric: str
    mode: str
    show: Callable[[float], str]
    bad: Callable[[float], bool] = lambda value: False

    @property
    def words(self) -> str:
        """The title on one line."""
        return self.title.replace("fall\nback", "fallback").replace("\n", " ")


def _fixed(digits: int) -> Callable[[float], str]:
    return lambda value: f"{value:.{digits}f}"


def percent(value: float) -> str:
    """A share as "12%"; never 0% of what is there."""
    return f"{100.0 * value:.0f}%" if value == 0.0 or value >= 0.01 else "<1%"


COLUMNS = (
    Column("ADE\n3 s\n[m]", "ade.3s.mean", "open", _fixed(2)),
    Column("fall\nback", "fallback.rate", "open", percent, lambda value: value > 0.0),
    Column("route\ndone", "route_progress.final", "closed", percent, lambda value: value < 0.5),
    Column("goal", "goal.final", "closed", lambda value: "yes" if value else "no", lambda value: value == 0.0),
    Column("hits\nat\nfault", "collision_at_fault.count", "closed", _fixed(0), lambda value: value > 0.0),
    Column("least\ngap\n[m]", "gap.min", "closed", _fixed(2), lambda value: value < 0.2),
    Column("off\nplan\n[m]", "tracking_lateral.max_abs", "closed", _fixed(2)),
    Column("TTC\n[s]", "ttc.min", "closed", _fixed(1), lambda value: value < 0.95),
    Column("jerk\n[s]", "lon_jerk_state.time_out_of_bounds", "closed", _fixed(1), lambda value: value > 2.0),
    Column("fall\nback", "fallback.rate", "closed", percent, lambda value: value > 0.0),
)
"""Open loop first; the closed loop's columns come after how its drive ended."""

LEGEND = (
    ("open", "open loop: the log drives, plans are compared with it; ADE 3 s: mean distance of plan and log over 3 s."),
    (
        "closed",
        "closed loop: the planner drives; route done: of what the log's driver, else the route follower, does in all;",
    ),
    (
        "closed",
        "TTC: least time to a collision; off plan: largest lateral distance; jerk: seconds beyond 4.13 m/s3.",
    ),
    (
        "",
        "verdict: the worst outcome of the gates, and how many of them were asked; inconclusive: no evidence.",
    ),
    ("", "fall back: share of frames in which the planner could not plan.  - : not available (why: metrics.csv)."),
)
"""Loop ("": either) and line."""


def legend(columns: Sequence[Column]) -> list[str]:
    """What some columns mean, and what stands beside them."""
    loops = {"", *(column.mode for column in columns)}
    return [line for loop, line in LEGEND if loop in loops]


def _mean(digits: int) -> Callable[[list[float]], str]:
    return lambda values: f"{sum(values) / len(values):.{digits}f}"


def _sum(values: list[float]) -> str:
    return f"{sum(values):.0f}"


def _mean_percent(values: list[float]) -> str:
    return percent(sum(values) / len(values))


COMPARED: tuple[tuple[str, str, str, Callable[[list[float]], str]], ...] = (
    ("ADE over 3 s, mean [m] (open)", "open", "ade.3s.mean", _mean(2)),
    ("frames with fallback, mean (open)", "open", "fallback.rate", _mean_percent),
    ("goal reached (closed)", "closed", "goal.final", lambda v: f"{sum(v):.0f} of {len(v)}"),
    ("collisions at fault (closed)", "closed", "collision_at_fault.count", _sum),
    ("least gap [m] (closed)", "closed", "gap.min", lambda v: f"{min(v):.2f}"),
    ("off plan, worst [m] (closed)", "closed", "tracking_lateral.max_abs", lambda v: f"{max(v):.2f}"),
    ("least TTC [s] (closed)", "closed", "ttc.min", lambda v: f"{min(v):.1f}"),
    ("run into by the replay (closed)", "closed", "replay_contact.final", _sum),
    (
        "jerk beyond 4.13 m/s3, worst [s] (closed)",
        "closed",
        "lon_jerk_state.time_out_of_bounds",
        lambda v: f"{max(v):.1f}",
    ),
    ("frames with fallback, mean (closed)", "closed", "fallback.rate", _mean_percent),
)
"""Label, loop, metric, and how its values over the logs become one."""
