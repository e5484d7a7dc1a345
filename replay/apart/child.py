"""A Python planner in its process: it is built of a context, and answers frames with plans.

Its stdin and stdout carry the messages of `replay.apart.schema`. They are taken away from the planner's code: what it
prints goes to stderr, of which the last lines are shown where it fails.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from logs.errors import ConfigError, ReplanError, raised
from logs.states import Trajectory
from logs.trace import Plan
from planners.base import Planner
from replay.apart import schema
from replay.apart.channel import Channel, GoneError
from replay.apart.convert import context_of, frame_of, plan_sent
from replay.planner_config import check_keywords, planner_keywords, prepared, resolved_table
from replay.stopwatch import Stopwatch


def main() -> None:
    """Answer what comes on stdin until it closes."""
    channel: Channel[Any] = Channel(os.dup(1), os.dup(0), schema.Question, patient=True)
    _settle_in()
    try:
        Seat(channel).serve()
    except GoneError:
        pass
    finally:
        sys.stdout.flush()


def load(planner: str, settings: bytes) -> None:
    """What all drives of a planner have in common: its module, and what its class loads (`prepared`).

    Args:
        planner: "module:Class".
        settings: Its table in the configuration, MessagePack.
    """
    _settle_in()
    try:
        prepared(planner, planner_keywords(planner, msgspec.msgpack.decode(settings)))
    finally:
        sys.stdout.flush()


def _settle_in() -> None:
    """Nothing to read on stdin, stdout is stderr, and the working directory is searched last."""
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.dup2(2, 1)
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    sys.argv = ["planner"]
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)


def warm() -> None:
    """Load the kernel that every plan needs: the compiler takes 0.2 s to wake, once and not in each process."""
    Trajectory(*np.arange(14.0).reshape(7, 2))


class Seat:
    """One planner and its clock."""

    def __init__(self, channel: Channel[Any]) -> None:
        self._channel, self._watch = channel, Stopwatch()
        self._planner: Planner | None = None
        self._keep = False

    def serve(self) -> None:
        """Answer every message; what the planner raises becomes an answer, too."""
        while True:
            question = self._channel.receive()
            try:
                answer = self._answer(question)
            except ReplanError as error:
                answer = schema.Failed(str(error), "config" if isinstance(error, ConfigError) else "load")
            except BaseException as error:  # also SystemExit: the planner has raised, and no more
                answer = schema.Failed(raised(error), "raised" if isinstance(question, schema.Frame) else "build")
            self._send(answer)

    def _send(self, answer: msgspec.Struct) -> None:
        try:
            self._channel.send(answer)
        except (TypeError, ValueError, OverflowError) as error:
            self._channel.send(schema.Failed(f"what it returned cannot be sent: {raised(error)}", "contract"))

    def _answer(self, question: Any) -> msgspec.Struct:
        if isinstance(question, schema.Frame):
            return self._planned(question)
        if isinstance(question, schema.Describe):
            table = resolved_table(question.planner, question.config)
            check_keywords(question.planner, table)
            return schema.Described(table)
        keywords = planner_keywords(question.planner, question.config)
        context = context_of(question.context, self._watch.lap)
        self._planner = prepared(question.planner, keywords)(context, **keywords)
        self._keep = question.keep_internals
        return schema.Ready()

    def _planned(self, message: schema.Frame) -> msgspec.Struct:
        assert self._planner is not None, "a frame came before the context"
        frame = frame_of(message)
        self._watch.start()
        try:
            plan: object = self._planner.plan(frame)
        finally:
            self._watch.stop(frame.t)
        if not isinstance(plan, Plan):
            return schema.Failed(f"it returned {type(plan).__name__} instead of a Plan", "contract")
        return plan_sent(plan.recorded(keep=self._keep), self._watch.laps, inside=True)
