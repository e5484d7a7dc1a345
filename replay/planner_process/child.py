"""A Python planner in its process: it is built from a context, and answers frames with plans.

Its stdin and stdout carry the messages of `replan.replay.planner_process.messages`. The planner's
code cannot use them: its output goes to stderr, whose last lines are shown if it fails.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from replan.core.errors import ConfigError, ReplanError, raised
from replan.logs.frame import Frame
from replan.logs.plan import Plan
from replan.logs.states import Trajectory
from replan.planners.base import Planner
from replan.replay.drive import Stopwatch
from replan.replay.planner_process import messages
from replan.replay.planner_process.channel import Channel, GoneError
from replan.replay.planner_process.coordinates import context_in_map, coordinates_of
from replan.replay.planner_process.past_messages import ReceivedPast, past_s_of
from replan.replay.planner_process.planner_config import of_class, planner_part, prepared


def main() -> None:
    """Answer the messages on stdin until it closes."""
    channel: Channel[Any] = Channel(os.dup(1), os.dup(0), messages.Question, side="planner")
    _redirect_streams()
    try:
        PlannerServer(channel).serve()
    except GoneError:
        pass
    finally:
        sys.stdout.flush()


def load(planner: str, settings: bytes) -> None:
    """Load the shared parts of all drives of a planner: its module, and the data that its class
    prepares (`prepared`).

    `planner`: "module:Class". `settings`: its table in the configuration, MessagePack.
    """
    _redirect_streams()
    try:
        prepared(planner, planner_part(planner, msgspec.msgpack.decode(settings)).keywords())
    finally:
        sys.stdout.flush()


def _redirect_streams() -> None:
    """Make stdin empty and stdout the same as stderr, and search the working directory last."""
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    os.dup2(2, 1)
    sys.stdout.reconfigure(line_buffering=True)  # type: ignore[union-attr]
    sys.argv = ["planner"]
    directory = str(Path.cwd())
    if directory not in sys.path:
        sys.path.append(directory)


def warm() -> None:
    """Load the kernel that every plan needs: starting the compiler takes 0.2 s, once instead of in
    each process.
    """
    Trajectory(*np.arange(14.0).reshape(7, 2))


class PlannerServer:
    """Answers the messages to one planner, or to the planners of several logs that plan together;
    has their clock.
    """

    def __init__(self, channel: Channel[Any]) -> None:
        self._channel, self._watch = channel, Stopwatch()
        self._planners: list[Planner | None] = []
        self._pasts: list[ReceivedPast] = []
        self._together: Any = None
        self._keep = False

    def serve(self) -> None:
        """Answer every message; an exception of the planner becomes an answer, too."""
        while True:
            question = self._channel.receive()
            answer = _try_answer(self._answer, question)
            try:
                self._channel.send(answer)
            except (TypeError, ValueError, OverflowError) as error:
                self._channel.send(
                    messages.Failed(f"what it returned cannot be sent: {raised(error)}", "contract")
                )

    def _answer(self, question: Any) -> msgspec.Struct:
        if isinstance(question, messages.Frame):
            return self._sent(
                self._plan_frames(
                    lambda planners, frames: planners[0].plan(frames[0]), [0], [question]
                )
            )
        if isinstance(question, messages.Frames):
            seats = question.seats
            plans = self._plan_frames(
                lambda planners, frames: self._together(frames, planners), seats, question.each
            )
            if not isinstance(plans, list | tuple) or len(plans) != len(seats):
                returned = (
                    f"{len(plans)} plans"
                    if isinstance(plans, list | tuple)
                    else type(plans).__name__
                )
                return messages.Failed(
                    f"plan_batch returned {returned} instead of {len(seats)} plans", "contract"
                )
            return messages.Answers([self._sent(plan) for plan in plans])
        if isinstance(question, messages.Describe):
            part = planner_part(question.planner, question.config)
            table = part.resolved()
            if question.batch and of_class(part.factory, "plan_batch") is None:
                remedy = (
                    "add the class method plan_batch(cls, frames, planners), or leave out "
                    "loop.apart.batch"
                )
                raise ConfigError(f"planner '{question.planner}' has no plan_batch: {remedy}")
            return messages.Described(table)
        if isinstance(question, messages.Hellos):
            return messages.Answers(
                [_try_answer(self._build_planner, hello) for hello in question.each]
            )
        return self._build_planner(question)

    def _build_planner(self, hello: messages.Hello) -> messages.Ready:
        self._planners.append(None)
        self._pasts.append(ReceivedPast(0.0))
        keywords = planner_part(hello.planner, hello.config).keywords()
        context = messages.context_of(hello.context, self._watch.lap)
        factory: Any = prepared(hello.planner, keywords)
        coordinates = coordinates_of(factory)
        context = context_in_map(context) if coordinates == "map" else context
        self._planners[-1] = factory(context, **keywords)
        self._together, self._keep = of_class(factory, "plan_batch"), hello.keep_internals
        past_s = past_s_of(factory)
        self._pasts[-1] = ReceivedPast(past_s)
        return messages.Ready(coordinates=coordinates, past_s=past_s)

    def _plan_frames(
        self,
        plan: Callable[[list[Any], list[Frame]], Any],
        seats: list[int],
        sent: list[messages.Frame],
    ) -> Any:
        """The results of the planners in some seats for their frames; `plan` calls them."""
        planners = [self._planners[seat] for seat in seats]
        frames = [
            self._pasts[seat].frame(message) for seat, message in zip(seats, sent, strict=True)
        ]
        assert None not in planners, "a frame came before the context"
        self._watch.start()
        try:
            return plan(planners, frames)
        finally:
            self._watch.stop(frames[0].t)

    def _sent(self, plan: object) -> messages.Plan | messages.Failed:
        if isinstance(plan, BaseException):
            return messages.Failed(raised(plan), "raised")
        if not isinstance(plan, Plan):
            return messages.Failed(
                f"it returned {type(plan).__name__} instead of a Plan", "contract"
            )
        return messages.plan_message(plan.recorded(keep=self._keep), self._watch.laps, inside=True)


def _try_answer(answer: Callable[[Any], Any], question: Any) -> Any:
    try:
        return answer(question)
    except ReplanError as error:
        return messages.Failed(str(error), "config" if isinstance(error, ConfigError) else "load")
    # Also SystemExit, which is treated as an exception of the planner
    except BaseException as error:
        planning = isinstance(question, messages.Frame | messages.Frames)
        return messages.Failed(raised(error), "raised" if planning else "build")
