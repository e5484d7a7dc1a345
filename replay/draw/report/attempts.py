"""Parts of a report that fail by themselves: an error in one of them costs that part, never the report."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from logs.errors import ConfigError, LogError, OutputError, raised

T = TypeVar("T")


class Attempts:
    """Makes parts of a report, and keeps what could not be made.

    Attributes:
        broken: A sentence for each part that could not be made.
    """

    def __init__(self) -> None:
        self.broken: list[str] = []

    def __call__(self, what: str, make: Callable[[], T], instead: T) -> T:
        """What `make` returns; where it raises, `instead`, and a sentence in `broken`.

        Raises:
            ConfigError: As `make`: the user named something that does not exist.
            OutputError: Likewise: nothing can be written.
        """
        try:
            return make()
        except (ConfigError, OutputError):
            raise
        except Exception as error:
            why = str(error) if isinstance(error, LogError) else raised(error)
            self.broken.append(f"{what} could not be made: {why}")
            return instead
