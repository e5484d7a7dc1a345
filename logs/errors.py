"""What can go wrong, and what each of it costs: one root, few leaves.

    ReplanError                 one line that names the thing, the place and the remedy
     |- LogError                a log cannot be read or evaluated            exit code 3
     |- PlannerError            a planner cannot be loaded, or raised        exit code 3
     '- ConfigError             a wrong option, key, threshold or name       exit code 2

The command line prints `str(error)` and never a traceback for these; any other exception is a bug.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from traceback import extract_tb


class ReplanError(Exception):
    """Root of all errors that a user can cause and mend."""


class LogError(ReplanError):
    """A log cannot be used.

    Args:
        what: What is wrong, in a few words ("yaw is NaN").
        file: The log.
        topic: The channel or the part of the file where it was found.
        time_ns: Log time of the offending message, nanoseconds.
        remedy: What the user can do.
    """

    def __init__(
        self,
        what: str,
        *,
        file: str | Path | None = None,
        topic: str | None = None,
        time_ns: int | None = None,
        remedy: str | None = None,
    ) -> None:
        self.what, self.file, self.topic, self.time_ns, self.remedy = what, file, topic, time_ns, remedy
        super().__init__(what)

    def __str__(self) -> str:
        place = [str(self.file)] if self.file is not None else []
        if self.topic is not None:
            place.append(f"topic {self.topic}")
        if self.time_ns is not None:
            place.append(f"time {self.time_ns / 1e9:.3f} s")
        line = ": ".join(filter(None, [", ".join(place), self.what]))
        return " ".join((f"{line}; {self.remedy}" if self.remedy else line).split())

    def at(self, file: str | Path) -> LogError:
        """The same error with its file named; the reader of a message does not know the file."""
        return LogError(self.what, file=file, topic=self.topic, time_ns=self.time_ns, remedy=self.remedy)


class PlannerError(ReplanError):
    """A planner cannot be loaded, or broke its contract (raised, or returned something that is no plan)."""


class ConfigError(ReplanError):
    """A wrong option, configuration key, gate or name."""


def unknown_name(kind: str, name: str, known: Iterable[str]) -> ConfigError:
    """The error for a name that is not in a table: says the nearest one, or all of them."""
    names = sorted(known)
    near = get_close_matches(name, names, n=1, cutoff=0.6)
    hint = f"did you mean '{near[0]}'?" if near else f"known are: {', '.join(names) or 'none'}"
    return ConfigError(f"no {kind} is called '{name}'; {hint}")


def said(error: BaseException) -> str:
    """An exception of a user's code in one line, with the place that raised it."""
    places = extract_tb(error.__traceback__)
    place = f" ({Path(places[-1].filename).name}:{places[-1].lineno})" if places else ""
    return f"{type(error).__name__}: {' '.join(str(error).split())}{place}"
