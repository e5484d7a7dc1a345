"""The smallest change of one setting with which a drive passes, by bisection, and the drives that
it breaks.

    (1) u = |value - default| / (high - low)
            of a setting with `log`: of the logarithms; of choices: 1

Each end of a setting's range is driven; if the drive passes there, the way from the default is
halved `STEPS` times. The change with the least u is driven on all logs of the run. Between the
default and an end the drive may pass, fail and pass again: the change passes, and a smaller one
may, too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import exp, log

from replan.core.names import counted
from replan.experiments.space import Setting, Value, shown

STEPS = 6
"""The last step is a 64th of the way."""


@dataclass(frozen=True)
class Remedy:
    """A change of a setting.

    Attributes:
        log: The log of the drive for which it was searched.
        key: The setting; "" if none was found.
        was: Its value in the run; `now` the changed one.
        u: The size (1).
        mended: Logs of failing drives that pass with it.
        broken: Logs whose drives did not fail, and fail with it.
        drives: Number of drives of the run that were driven with it.
    """

    log: str
    key: str = ""
    was: Value = 0.0
    now: Value = 0.0
    u: float = 1.0
    mended: tuple[str, ...] = ()
    broken: tuple[str, ...] = ()
    drives: int = 0

    def line(self) -> str:
        """The remedy in a sentence."""
        if not self.key:
            return f"Remedy: with no setting of the space alone does {self.log} pass."
        breaks = f"breaks {', '.join(self.broken)}" if self.broken else "breaks none"
        return (
            f"Remedy: {self.key} = {shown(self.now)} instead of {shown(self.was)} is the smallest "
            f"change found with which {self.log} passes; of {counted(self.drives, 'drive')} it "
            f"mends {len(self.mended)} and {breaks}."
        )


def smallest_change(
    settings: Sequence[Setting], passes: Callable[[Setting, Value], bool]
) -> tuple[Setting, Value, float] | None:
    """The setting and value with the least (1) with which a drive passes; None if there is none.

    `passes` drives with a setting at a value.
    """
    changes: list[tuple[Setting, Value, float]] = []
    for setting in settings:
        for end in setting.ends:
            if end == setting.default or not passes(setting, end):
                continue
            if setting.choices:
                changes.append((setting, end, 1.0))
                continue
            value = _smallest_value(setting, end, passes)
            changes.append((setting, value, distance(setting, value)))
    return min(changes, key=lambda change: change[2], default=None)


def _smallest_value(
    setting: Setting, end: Value, passes: Callable[[Setting, Value], bool]
) -> Value:
    """The value nearest to the default with which a drive passes, as it does at the end."""
    fails_at, passes_at = 0.0, 1.0  # shares of the way from the default to the end
    for _ in range(STEPS):
        middle = 0.5 * (fails_at + passes_at)
        value = between(setting, end, middle)
        if value in (setting.default, between(setting, end, passes_at)):
            break
        if passes(setting, value):
            passes_at = middle
        else:
            fails_at = middle
    return between(setting, end, passes_at)


def between(setting: Setting, end: Value, share: float) -> Value:
    """The value at a share of the way from the default to an end, on the setting's steps."""
    if share == 1.0:
        return end
    begin, last = float(setting.default), float(end)
    value = (
        exp(log(begin) + share * log(last / begin))
        if setting.log
        else begin + share * (last - begin)
    )
    if setting.step is not None and setting.low is not None:
        value = setting.low + setting.step * round((value - setting.low) / setting.step)
    return round(value) if setting.is_whole else float(f"{value:.6g}")


def distance(setting: Setting, value: Value) -> float:
    """The size (1) of a change."""
    assert setting.low is not None and setting.high is not None
    scale = log if setting.log else float
    change = scale(float(value)) - scale(float(setting.default))
    return abs(change) / (scale(float(setting.high)) - scale(float(setting.low)))
