"""What several metrics ask of one drive, computed once: kept while the drive is there, and no longer.

The first argument (a trace, a scenario, a road) owns the result and is held weakly; the others are compared by value. A
result must not refer to the first argument, or it would keep it alive.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import wraps
from typing import Any, Concatenate, ParamSpec, TypeVar
from weakref import WeakKeyDictionary

K = TypeVar("K")
P = ParamSpec("P")
R = TypeVar("R")


def last(count: int) -> Callable[[Callable[Concatenate[K, P], R]], Callable[Concatenate[K, P], R]]:
    """Call a function once for the same arguments; the newest `count` results of each first argument are kept."""

    def decorate(function: Callable[Concatenate[K, P], R]) -> Callable[Concatenate[K, P], R]:
        kept: WeakKeyDictionary[Any, dict[Hashable, R]] = WeakKeyDictionary()

        @wraps(function)
        def asked(owner: K, /, *args: P.args, **kwargs: P.kwargs) -> R:
            known, key = kept.setdefault(owner, {}), (args, *kwargs.items())
            if key not in known:
                found = function(owner, *args, **kwargs)
                if len(known) >= count:
                    known.pop(next(iter(known)))
                known[key] = found
            return known[key]

        return asked

    return decorate


def once(function: Callable[Concatenate[K, P], R]) -> Callable[Concatenate[K, P], R]:
    """`last(64)`."""
    return last(64)(function)
