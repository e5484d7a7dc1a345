"""Who drives the recorded car: its stack, a person, or each on one axis; and when that changes.

(1) the mode at t = that of the last change up to t; before the first change it is unknown
(2) a take-over   = the stack drives an axis, then a person does (or the stack has given up), for at
                    least `LASTS_S`; a shorter one is a flicker
(3) its time t_0  = the first input of the driver within `INPUT_S` before the mode's change, else
                    the change less the source's latency
(4) an episode    = take-overs that begin less than `EPISODE_S` after the one before

The end of a recording is no take-over. It is planned where the car stood for `STOOD_S` before it;
the stack's where its mode says that it has given up; else the driver's.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import pairwise

import numpy as np

from replan.core.arrays import FloatArray, IntArray, frozen
from replan.core.errors import LogError
from replan.core.names import counted
from replan.logs.states import Controls, Trajectory

LASTS_S = 0.5
INPUT_S = 1.0
EPISODE_S = 10.0
STOOD_S, STANDS_MPS = 1.0, 0.1
PRESSED = 0.05
"""A pedal position above this is an input, of 1."""
SAME_S = 1e-6


class DrivingMode(Enum):
    """Who drives."""

    AUTONOMOUS = "autonomous"
    MANUAL = "manual"
    STEERED = "autonomous steering only"
    PACED = "autonomous speed only"
    GIVEN_UP = "the stack has given up"
    UNKNOWN = "unknown"

    @property
    def axes(self) -> frozenset[str]:
        """The axes that the stack drives: "lateral", "longitudinal"."""
        return _AXES.get(self, frozenset())

    @property
    def is_known(self) -> bool:
        """Whether it is known who drives."""
        return self is not DrivingMode.UNKNOWN


_AXES = {
    DrivingMode.AUTONOMOUS: frozenset(("lateral", "longitudinal")),
    DrivingMode.STEERED: frozenset(("lateral",)),
    DrivingMode.PACED: frozenset(("longitudinal",)),
}


NAMES = {
    "autonomous": DrivingMode.AUTONOMOUS,
    "manual": DrivingMode.MANUAL,
    "steering": DrivingMode.STEERED,
    "speed": DrivingMode.PACED,
    "given up": DrivingMode.GIVEN_UP,
    "unknown": DrivingMode.UNKNOWN,
}
"""The modes by the names that settings have for them."""
WORDS = NAMES | {
    **dict.fromkeys(("auto", "1", "true", "engaged"), DrivingMode.AUTONOMOUS),
    **dict.fromkeys(("0", "false", "human", "driver"), DrivingMode.MANUAL),
    "": DrivingMode.UNKNOWN,
}
"""The modes by words of logs."""


def modes_of_words(words: Sequence[str], given: Mapping[str, str]) -> list[DrivingMode]:
    """Return the mode of each word of a log; `given` are the user's names of modes by word.

    Raises:
        LogError: A word is not known; all that are not are named.
    """
    known = WORDS | {word.lower(): NAMES[name] for word, name in given.items()}
    texts = [word.strip().lower().removesuffix(".0") for word in words]
    unknown = sorted(set(texts) - set(known))
    if unknown:
        example = ", ".join(f'"{word}" = "manual"' for word in unknown[:6])
        raise LogError(
            f"who drives is {', '.join(map(repr, unknown[:6]))}",
            topic="driver",
            remedy=f"name the mode in [log]: driver = {{{example}}}; modes: {', '.join(NAMES)}",
        )
    return [known[text] for text in texts]


@dataclass(frozen=True, eq=False, slots=True)
class DrivingModes:
    """Who drives over time.

    Attributes:
        t: `(n,)` times, s, from which a mode holds, increasing.
        modes: The modes `(n,)`; two successive ones differ.
        source: Topic or column that says it.
        latency_s: The greatest delay of a change: the interval of the source's samples, s; 0 for a
            source that is written at each change.

    Raises:
        ValueError: The columns differ in length, or the times do not increase.
    """

    t: FloatArray
    modes: tuple[DrivingMode, ...]
    source: str
    latency_s: float = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "t", frozen(self.t))
        if len(self.t) != len(self.modes) or not len(self.modes):
            raise ValueError(f"driving modes: {len(self.t)} times and {len(self.modes)} modes")
        if not (np.diff(self.t) > 0.0).all():
            raise ValueError("driving modes: the times do not increase")

    @classmethod
    def of_samples(
        cls, t: FloatArray, modes: list[DrivingMode], source: str, latency_s: float = 0.0
    ) -> DrivingModes:
        """Make modes of samples: only changes are kept."""
        changes = [n for n, mode in enumerate(modes) if n == 0 or mode is not modes[n - 1]]
        return cls(t[changes], tuple(modes[n] for n in changes), source, latency_s)

    def at(self, t: float) -> DrivingMode:
        """The mode at a time, (1)."""
        place = int(np.searchsorted(self.t, t + SAME_S, side="right")) - 1
        return self.modes[place] if place >= 0 else DrivingMode.UNKNOWN

    def spans(self, begin: float, end: float) -> list[tuple[float, float, DrivingMode]]:
        """The spans of the modes between two times, in order."""
        within = self.t[(self.t > begin + SAME_S) & (self.t < end - SAME_S)]
        bounds = [begin, *within.tolist(), end]
        return [(first, last, self.at(first)) for first, last in pairwise(bounds)]

    def steady(self) -> DrivingModes:
        """The modes without flickers: what lasts less than `LASTS_S` between two spans of one mode
        is part of them.
        """
        steady: list[int] = []
        for n, mode in enumerate(self.modes):
            is_back = len(steady) > 1 and mode is self.modes[steady[-2]]
            if is_back and self.t[n] - self.t[steady[-1]] < LASTS_S - SAME_S:
                steady.pop()
            elif not steady or mode is not self.modes[steady[-1]]:
                steady.append(n)
        return replace(self, t=self.t[steady], modes=tuple(self.modes[n] for n in steady))

    def described(self, begin: float, end: float) -> str:
        """The spans between two times in words, and the number of flickers in all."""
        steady = self.steady()
        flickers = (len(self.modes) - len(steady.modes)) // 2
        spans = steady.spans(begin, end)
        words = ", ".join(f"{mode.value} from {a:.1f} to {b:.1f} s" for a, b, mode in spans)
        left_out = f"; {counted(flickers, 'flicker')} of less than {LASTS_S} s" if flickers else ""
        return words + left_out

    def between(self, begin: float, end: float) -> DrivingModes | None:
        """The modes from the one in force at `begin` on, up to `end`; None if there are none."""
        first = max(int(np.searchsorted(self.t, begin + SAME_S, side="right")) - 1, 0)
        rows = np.arange(first, int(np.searchsorted(self.t, end, side="right")))
        if not len(rows):
            return None
        modes = tuple(self.modes[row] for row in rows)
        return replace(self, t=np.maximum(self.t[rows], begin), modes=modes)

    def shifted(self, seconds: float) -> DrivingModes:
        """The modes, `seconds` later."""
        return replace(self, t=self.t + seconds)


class TakeoverKind(Enum):
    """Whose act a take-over is."""

    DRIVER = "by the driver"
    STACK = "the stack gave up"
    PLANNED = "planned"


@dataclass(frozen=True, slots=True)
class Takeover:
    """A take-over (2).

    Attributes:
        t: Its time (3), s.
        changed: Time of the mode's change, s.
        until: Time at which the stack drives the axis again, or the recording ends, s.
        axis: "lateral", "longitudinal" or "both".
        kind: Whose act it is.
        input: The driver's first input: "brake", "accelerator" or ""; unknown inputs are "".
        episode: Number of its episode (4), from 1.
    """

    t: float
    changed: float
    until: float
    axis: str
    kind: TakeoverKind
    input: str
    episode: int


@dataclass(frozen=True, slots=True)
class Flicker:
    """A change like a take-over that is shorter than `LASTS_S`."""

    t: float
    lasts_s: float


def takeovers(
    driving: DrivingModes, ego: Trajectory, controls: Controls | None
) -> tuple[list[Takeover], list[Flicker]]:
    """The take-overs and the flickers of a recording, in order."""
    events: list[Takeover] = []
    flickers: list[Flicker] = []
    for changed, until, axes, lost_to in _losses(driving, float(ego.t[-1])):
        ended = until < ego.t[-1] - SAME_S
        if until - changed < LASTS_S - SAME_S:
            flickers += [Flicker(changed, until - changed)] if ended else []
            continue
        t, pressed = _first_input(changed, controls)
        if not pressed:
            t = max(changed - driving.latency_s, float(ego.t[0]))
        episode = events[-1].episode if events else 0
        is_new = not events or t - events[-1].t >= EPISODE_S
        events.append(
            Takeover(
                t,
                changed,
                until,
                axes.pop() if len(axes) == 1 else "both",
                _kind(lost_to, ego, changed),
                pressed,
                episode + is_new,
            )
        )
    return events, flickers


def _losses(
    driving: DrivingModes, end: float
) -> Iterator[tuple[float, float, set[str], DrivingMode]]:
    """The times at which the stack loses axes, until it has one of them again, the axes, and the
    mode that follows.
    """
    for n in range(1, len(driving.modes)):
        before, after = driving.modes[n - 1], driving.modes[n]
        lost = set(before.axes - after.axes)
        if not lost or not after.is_known:
            continue
        later = zip(driving.t[n + 1 :].tolist(), driving.modes[n + 1 :], strict=True)
        again = next((t for t, mode in later if mode.axes & lost), end)
        yield float(driving.t[n]), again, lost, after


def _first_input(changed: float, controls: Controls | None) -> tuple[float, str]:
    """Time and name of the first pedal that is pressed within `INPUT_S` before a change and was not
    before; the change and "" without one.
    """
    if controls is None:
        return changed, ""
    inputs = []
    for name, column in (("brake", controls.brake), ("accelerator", controls.throttle)):
        pressed = np.nan_to_num(column) > PRESSED
        rises: IntArray = np.flatnonzero(pressed[1:] & ~pressed[:-1]) + 1
        times = controls.t[rises]
        near = times[(times >= changed - INPUT_S) & (times <= changed + SAME_S)]
        inputs += [(float(near[0]), name)] if len(near) else []
    return min(inputs, default=(changed, ""))


def _kind(after: DrivingMode, ego: Trajectory, changed: float) -> TakeoverKind:
    if after is DrivingMode.GIVEN_UP:
        return TakeoverKind.STACK
    recent = (ego.t >= changed - STOOD_S) & (ego.t <= changed)
    stood = recent.any() and float(np.abs(ego.v[recent]).max()) < STANDS_MPS
    return TakeoverKind.PLANNED if stood else TakeoverKind.DRIVER
