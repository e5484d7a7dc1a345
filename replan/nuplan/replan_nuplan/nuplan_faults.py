"""What replan says of an exception of a planner: the call, the error, its place, and a remedy."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable
from typing import Any


class CallError(Exception):
    """A call of a planner raised; the error is its cause."""


def called(name: str, call: Callable[..., Any], *arguments: Any, **keywords: Any) -> Any:
    """The answer of a planner's call; CallError, which names the call, if it raises."""
    try:
        return call(*arguments, **keywords)
    except Exception as error:
        raise CallError(name) from error


def describe(error: Exception) -> str:
    """One sentence about an exception."""
    cause = error.__cause__ if isinstance(error, CallError) else None
    raised = _origin(cause or error)
    place = _place(raised)
    call = f"{error} raised " if cause else ""
    return f"{call}{type(raised).__name__}: {raised} ({place}){_remedy(raised)}"


def _origin(error: BaseException) -> BaseException:
    """The error from which an error was raised: hydra wraps those of what it builds."""
    while error.__cause__:
        error = error.__cause__
    return error


def _place(error: BaseException) -> str:
    """File and line of the last step that is not in an installed package; the last step, if all
    are.
    """
    steps = traceback.extract_tb(error.__traceback__)
    own = [step for step in steps if "site-packages" not in step.filename]
    last = (own or steps)[-1]
    return f"{last.filename}:{last.lineno}"


def _remedy(error: BaseException) -> str:
    """The remedy of an error whose cause is in the settings or the environment; else nothing."""
    if isinstance(error, ModuleNotFoundError):
        where = "install it there, or add the folder that holds it to the planner's path"
        return f"; imported by {sys.executable}: {where}"
    if type(error).__name__ == "MissingMandatoryValue":
        return "; give this key in the planner's table"
    return ""
