"""When a message is from: the log time of its record, or the stamp that its sender put into its header.

Stamps say when something was measured; records are later by what the computation took, and jitter: differences of
positions by log time are useless where several messages are written at once. So a stamp counts wherever a topic's
messages all have one; a topic whose stamps are of another clock than the ego's counts by log time.

(1) t_stamp(log) = the ego's stamp, interpolated over the ego's log time: for messages without a stamp
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.kernel import FloatArray, IntArray

OTHER_CLOCK_S = 1.0
"""Topics whose median offset differs by more from the ego's are stamped by another clock; messages by more from their
topic's median are stale."""
SAID_S = 0.1
"""Offsets from here on are reported."""
DROPOUT_S, DROPOUT_INTERVALS = 0.3, 5.0
"""A gap counts as a drop-out from so many s on, if it is also so many times the usual interval."""
_DROPOUTS_SHOWN = 3


@dataclass(frozen=True, eq=False)
class Clock:
    """How log times become times of the scenario's clock, ns: samples (1) of both, rising; empty: they are the same."""

    log: IntArray
    stamp: IntArray

    def __call__(self, log: IntArray) -> IntArray:
        """Log times `(n,)` as times of the scenario's clock."""
        if not len(self.log):
            return log
        since = np.interp(log - self.log[0], self.log - self.log[0], self.stamp - self.stamp[0])
        inner = self.stamp[0] + np.rint(since).astype(np.int64)  # whole: times since an epoch are no floats
        out = np.where(log < self.log[0], log - self.log[0] + self.stamp[0], inner)
        return np.where(log > self.log[-1], log - self.log[-1] + self.stamp[-1], out)


LOG_CLOCK = Clock(np.empty(0, np.int64), np.empty(0, np.int64))


def offsets(log: IntArray, stamps: IntArray) -> FloatArray:
    """How much later than stamped the messages were recorded `(n,)`, s."""
    return (log - stamps) / 1e9


def stamped(stamps: IntArray) -> bool:
    """Whether all messages of a topic have a stamp."""
    return bool(len(stamps) and (stamps > 0).all())


def clock_of(log: IntArray, stamps: IntArray, choice: str) -> Clock:
    """The scenario's clock by the ego's messages: their stamps, unless the choice is "log" or there are none."""
    if choice == "log" or not stamped(stamps):
        return LOG_CLOCK
    rising = np.flatnonzero(np.diff(log, prepend=log[0] - 1) > 0)
    return Clock(log[rising], np.maximum.accumulate(stamps)[rising])


def times_of(topic: str, log: IntArray, stamps: IntArray, clock: Clock, notes: list[str]) -> tuple[IntArray, IntArray]:
    """Times of a topic's messages `(k,)` ns, rising strictly, and which messages they are `(k,)`.

    Stale ones (by (1) more than `OTHER_CLOCK_S` later than the topic's usual) are left out, and of several with one
    time all but the last recorded.
    """
    keep = np.arange(len(log))
    if not len(clock.log) or not stamped(stamps):
        times = clock(log)
    else:
        late = offsets(clock(log), stamps)
        usual = float(np.median(late))
        near = np.flatnonzero(np.abs(late - usual) <= OTHER_CLOCK_S)
        if abs(usual) > OTHER_CLOCK_S or not len(near):
            notes.append(
                f"The stamps of {topic} are of another clock than the ego's ({usual:+.1f} s): its log times count."
            )
            times = clock(log)
        else:
            keep = near
            if len(keep) < len(log):
                worst = float(np.abs(late - usual).max())
                notes.append(
                    f"{len(log) - len(keep)} of {len(log)} messages of {topic} are stale, by up to {worst:.1f} s, and"
                    " left out."
                )
            times = stamps[keep]
    order = np.argsort(times, kind="stable")
    last = np.append(np.diff(times[order]) > 0, True)
    return times[order][last], keep[order][last]


def said(topic: str, log: IntArray, stamps: IntArray, start_ns: int) -> list[str]:
    """Sentences on a topic's clock and its drop-outs; none where there is nothing to say."""
    out = []
    if stamped(stamps):
        late = offsets(log, stamps)
        usual, worst = float(np.median(late)), float(late[np.argmax(np.abs(late))])
        if max(abs(usual), abs(worst)) > SAID_S:
            out.append(f"{topic} is recorded {usual:.3f} s after its stamps (median), at most {worst:.3f} s.")
    if len(log) > 2:
        apart = np.diff(log) / 1e9
        usual = float(np.median(apart))
        lost = np.flatnonzero(apart > max(DROPOUT_S, DROPOUT_INTERVALS * usual))
        if len(lost):
            places = ", ".join(
                f"{apart[i]:.2f} s from {(log[i] - start_ns) / 1e9:.2f} s" for i in lost[:_DROPOUTS_SHOWN]
            )
            more = f" and {len(lost) - _DROPOUTS_SHOWN} more" if len(lost) > _DROPOUTS_SHOWN else ""
            out.append(f"{topic} drops out: nothing for {places}{more} (usually every {usual:.3f} s).")
    return out
