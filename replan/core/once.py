"""Results that are computed once for their owner: a trace, a scenario or a road."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import wraps
from typing import Any, Concatenate, ParamSpec, TypeVar
from weakref import WeakKeyDictionary

K = TypeVar("K")
P = ParamSpec("P")
R = TypeVar("R")


def last(count: int) -> Callable[[Callable[Concatenate[K, P], R]], Callable[Concatenate[K, P], R]]:
    """Cache the results of a function: the newest `count` results for each first argument.

    The first argument (a trace, a scenario, a road) owns the results and is held weakly: its
    results live as long as it does. The other arguments are compared by value. A result must not
    refer to the first argument.
    """

    def decorate(function: Callable[Concatenate[K, P], R]) -> Callable[Concatenate[K, P], R]:
        results_by_owner: WeakKeyDictionary[Any, dict[Hashable, R]] = WeakKeyDictionary()

        @wraps(function)
        def remembered(owner: K, /, *args: P.args, **kwargs: P.kwargs) -> R:
            results, key = results_by_owner.setdefault(owner, {}), (args, *kwargs.items())
            if key not in results:
                result = function(owner, *args, **kwargs)
                if len(results) >= count:
                    results.pop(next(iter(results)))
                results[key] = result
            return results[key]

        return remembered

    return decorate


def once(function: Callable[Concatenate[K, P], R]) -> Callable[Concatenate[K, P], R]:
    """Cache a function that is called again for one drive or road, so that it runs once per
    arguments: `last(64)`.
    """
    return last(64)(function)
