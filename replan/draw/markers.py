"""Stretches of a log to look at, as a recording marks them."""

from __future__ import annotations

from dataclasses import dataclass

ROUNDING_S = 1e-9
"""Times that differ by less are one time, s."""


@dataclass(frozen=True)
class Marker:
    """A stretch of a log to look at."""

    begin: float  # s since the log's start
    end: float  # s since the log's start
    kind: str
    about: str  # Who takes part, and more in words; may be empty

    @property
    def words(self) -> str:
        """What happens, in a line: "cut in: car 12 (gap 3.2 m)"."""
        return ": ".join(filter(None, (self.kind.replace("_", " "), self.about)))

    def lasts_at(self, t: float) -> bool:
        """Whether a time, s, is in the stretch."""
        return self.begin <= t + ROUNDING_S and t < self.end - ROUNDING_S
