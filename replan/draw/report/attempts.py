"""Parts of a report that may fail: an error in one removes that part, never the report."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from replan.core.errors import ConfigError, LogError, OutputError, raised

T = TypeVar("T")


class Attempts:
    """Makes parts of a report, and records the parts that fail."""

    def __init__(self) -> None:
        self.broken: list[str] = []  # a sentence for each part that could not be made

    def __call__(self, part: str, make: Callable[[], T], instead: T) -> T:
        """The result of `make`; if it raises, `instead`, and a sentence in `broken`.

        ConfigError as `make`: the user named something that does not exist; OutputError as `make`:
        nothing can be written.
        """
        try:
            return make()
        except (ConfigError, OutputError):
            raise
        except Exception as error:
            why = str(error) if isinstance(error, LogError) else raised(error)
            self.broken.append(f"{part} could not be made: {why}")
            return instead
