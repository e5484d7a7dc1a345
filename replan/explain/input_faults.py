"""What is wrong with the input that a drive's plans used, from all its frames.

One change is searched that makes the outlines of what was shown those that the planner drew (sizes
in steps of `GRIDS`): agents older by some frames, displacements predicted at a share of their
length, or agents shifted, in the ego's frame or in their own. It must explain `MOST` of the agents
whose outlines are off by more than `AgentUse.allowed_m`, in at least `LEAST` frames: noise of
single frames is no fault. Changes that the drive does not tell apart are all named. Differences
that no such change explains may be predictions or margins of the planner's own, and are no fault.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from operator import itemgetter

import numpy as np

from replan.core.arrays import FloatArray
from replan.explain.input_outlines import MISSED_M, expected_slices
from replan.explain.input_use import MARGINS_M, AgentUse, InputUse, UsedFrame
from replan.logs.frame import Predictions
from replan.logs.plan import PlanStart
from replan.logs.scenario import Scenario
from replan.logs.trace import Mode
from replan.results.load import StoredDrive

LEAST = 5
"""Fewer frames are no evidence."""
MOST = 0.75
"""A change explains a drive if it explains this share of what is off."""
SAMPLED = 24
"""Agents of frames with which changes are tried."""
EQUAL_M = 0.005
"""Of sizes whose mean differences differ by less than this the middle one is taken, m."""
SAME_M = 0.1
"""Changes whose mean differences differ by less than this are not separated, m."""
SHARE_OFF, PLACE_OFF_M = 0.05, 0.3
"""Least errors of the start: share of the ego's speed, and its place."""
RARE = 0.05
RARE_IN_NOISE = 0.5
"""A change is none where fewer S-T outlines than this share are off, in noise of all outlines."""
LEFT_OUT = 0.1
"""Agents are left out if it is this share of those that take the way soon."""
PURE = 0.95
"""A property tells two groups apart if it is right for this share of each."""


PROPERTIES = (
    ("aside_m", "m beside the ego"),
    ("distance_m", "m away"),
    ("ahead_m", "m ahead"),
    ("left_m", "m to the left"),
    ("speed", "m/s fast"),
    ("frame", "frames after the first"),
)
"""Fields of `AgentUse` by which agents may have been chosen."""


class ChangeKind(Enum):
    """Changes of the agents and their predictions; the values complete "the planner used ..."."""

    AGE = "agents and predictions {:.2f} s older than shown"
    SHARE = "{:.2f} of the predicted displacements"
    ALONG = "agents {:+.1f} m along the ego's heading"
    ACROSS = "agents {:+.1f} m across the ego's heading (left is positive)"
    AHEAD = "agents {:+.1f} m along their own heading"
    BESIDE = "agents {:+.1f} m across their own heading (left is positive)"


_SHIFTS_M = (np.arange(-5.0, 5.01, 0.5), 0.1)
GRIDS = {
    ChangeKind.AGE: (np.arange(1.0, 31.0), 0.0),
    ChangeKind.SHARE: (np.arange(0.0, 2.51, 0.1), 0.02),
}
"""Sizes that are tried, frames and shares, and steps around the best, 0: none; of shifts
`_SHIFTS_M`.
"""


AS_SHOWN = {ChangeKind.SHARE: 1.0}
"""The sizes of no change; 0 for the others."""
LEAST_SIZES = {ChangeKind.AGE: 1.0, ChangeKind.SHARE: 0.1}
LEAST_SHIFT_M = 0.75
"""Smaller sizes are no fault: margins of planners need not be the same on both sides."""


@dataclass(frozen=True, slots=True)
class InputFault:
    """A fault of the input.

    Attributes:
        claim: What the planner used, with its size.
        count: In how many frames, or agents of frames, of how many (`of`).
        first_s: When first, s since the scenario's start.
    """

    claim: str
    count: int
    of: int
    first_s: float

    @property
    def sentence(self) -> str:
        """The fault in words."""
        return (
            f"The planner used {self.claim}: {self.count} of {self.of}, first at "
            f"{self.first_s:.2f} s. The settings of perception do not explain it."
        )


def input_faults(use: InputUse) -> list[InputFault]:
    """The faults of the input of a drive's plans, the start first; empty if there is none, and for
    planners that show nothing (`InputUse.is_blind`).
    """
    changed = _changed(use)
    faults = [*_of_start(use), *changed, *([] if changed else _unused(use))]
    return [*faults, *_of_lights(use)]


def use_of(drive: StoredDrive) -> InputUse:
    """What the plans of a stored drive used."""
    return InputUse.of(drive.trace, drive.scenario, drive.result.run.drive_loop, drive.log)


def describe_input(use: InputUse) -> list[str]:
    """The faults of the input in sentences, or that the artefacts show none of it."""
    if use.is_blind:
        return ["Its plans have no S-T graph: what they used of the agents is not known."]
    return [fault.sentence for fault in input_faults(use)]


def _of_start(use: InputUse) -> Iterator[InputFault]:
    """The speed and the place at which plans start that start at the ego."""
    starts = use.starts
    if len(starts) < LEAST:
        return
    shares = np.array([start.share for start in starts])
    ahead = float(np.median([start.ahead_m for start in starts]))
    left = float(np.median([start.left_m for start in starts]))
    share, first = float(np.median(shares)), use.times[starts[0].frame]
    is_share = np.abs(shares - share) < SHARE_OFF
    if abs(share - 1.0) > SHARE_OFF and is_share.mean() >= MOST:
        plans = (frame.read.planned.plan for frame in use.frames)
        stitched = any(
            plan.start is PlanStart.PREVIOUS_PLAN and not plan.status.is_fallback for plan in plans
        )
        lost = "" if stitched or use.trace.mode is Mode.OPEN else ", and no previous plan"
        claim = f"{share:.2f} of the ego's speed{lost}"
        yield InputFault(claim, int(is_share.sum()), len(starts), first)
    if np.hypot(ahead, left) > PLACE_OFF_M:
        claim = f"a start {ahead:+.1f} m ahead of the ego and {left:+.1f} m to its left"
        yield InputFault(claim, len(starts), len(starts), first)


def _of_lights(use: InputUse) -> Iterator[InputFault]:
    """The red lights whose stop lines no artefact names."""
    for line in dict.fromkeys(light.line for light in use.lights):
        of_line = [light for light in use.lights if light.line == line]
        missed = [light for light in of_line if not light.named]
        if len(missed) >= LEAST:
            claim = f"no red light at {line}"
            yield InputFault(claim, len(missed), len(of_line), use.times[missed[0].frame])


def _unused(use: InputUse) -> Iterator[InputFault]:
    """The agents that take the way of a plan soon, and that no artefact names."""
    needed = [agent for agent in use.agents if agent.needed]
    unused = [agent for agent in needed if not agent.named]
    named = [agent for agent in use.agents if agent.named]
    group = selector(unused, named) if unused else ""
    # Without a property that tells them from others, the planner chose them
    if len(unused) >= max(2 * LEAST, LEFT_OUT * len(needed)) and (group or not named):
        claim = f"no agents{group and f' {group}'} that take its way soon"
        yield InputFault(claim, len(unused), len(needed), use.times[unused[0].frame])


class Changes:
    """Tries changes of what was shown."""

    def __init__(self, frames: Sequence[UsedFrame], scenario: Scenario) -> None:
        self._frames, self._car = frames, scenario.vehicle

    def differences(self, use: AgentUse, kind: ChangeKind, sizes: FloatArray) -> FloatArray:
        """How far the outlines of an agent are off what was shown, changed by sizes `(n,)`, m."""
        frame = self._frames[use.frame]
        vectors = _vectors(kind, sizes, frame.ego.yaw, float(frame.read.agents.yaw[use.row]))
        ages = sizes.astype(np.int64) if kind is ChangeKind.AGE else np.zeros(len(sizes), np.int64)
        off = np.zeros(len(sizes))
        for age in np.unique(ages):
            of_age = ages == age
            earlier = self._frames[max(use.frame - int(age), 0)]
            row = earlier.rows.get(use.agent)
            if row is None:
                off[of_age] = MISSED_M
                continue
            if use.shift is not None:
                old, now = earlier.read.agents, frame.read.agents
                moved = np.array([old.x[row] - now.x[use.row], old.y[row] - now.y[use.row]])
                off[of_age] = np.hypot(*(use.shift - moved - vectors[of_age]).T)
            if use.drawn is not None:
                shares = sizes[of_age] if kind is ChangeKind.SHARE else np.ones(of_age.sum())
                drawn = self._drawn(use, earlier, row, shares, vectors[of_age])
                off[of_age] = np.maximum(off[of_age], drawn)
        return np.minimum(off, MISSED_M)

    def _drawn(
        self, use: AgentUse, earlier: UsedFrame, row: int, shares: FloatArray, vectors: FloatArray
    ) -> FloatArray:
        """The difference of the S-T outline for `n` shares of displacements and shifts `(n, 2)`."""
        futures, frame = earlier.read.predictions, self._frames[use.frame]
        off = np.full(len(shares), MISSED_M)
        rows = np.flatnonzero(futures.agent == row) if futures is not None else np.empty(0, np.intp)
        if futures is None or not len(rows) or use.drawn is None:
            return off
        x, y = (
            (column[rows, :1] + shares[:, None, None] * (column[rows] - column[rows, :1]))
            + vectors[:, axis, None, None]
            for axis, column in enumerate((futures.x, futures.y))
        )
        count, steps = len(shares), len(futures.t)
        which = np.repeat(np.arange(count), len(rows))
        changed = Predictions(
            futures.t,
            which,
            np.tile(futures.probability[rows], count),
            x.reshape(-1, steps),
            y.reshape(-1, steps),
            np.tile(futures.yaw[rows], (count, 1)),
            futures.method,
        )
        copies = frame.read.agents.some(np.full(count, use.row))
        for margin in MARGINS_M:
            for i, slices, _ in expected_slices(frame.path, copies, changed, self._car, margin):
                off[i] = min(off[i], use.drawn.difference(slices, use.speed))
        return off

    def fit(self, uses: Sequence[AgentUse], kind: ChangeKind) -> tuple[float, FloatArray]:
        """The size with the least mean difference, and the differences `(uses,)` with it, m."""
        sizes, step = GRIDS.get(kind, _SHIFTS_M)
        off = np.array([self.differences(use, kind, sizes) for use in uses])
        if step > 0.0:
            sizes = sizes[int(np.argmin(off.mean(axis=0)))] + step * np.arange(-5, 6)
            off = np.array([self.differences(use, kind, sizes) for use in uses])
        means = off.mean(axis=0)
        equal = np.flatnonzero(means <= means.min() + EQUAL_M)
        best = int(equal[len(equal) // 2])
        return float(sizes[best]), off[:, best]


def _vectors(kind: ChangeKind, sizes: FloatArray, ego_yaw: float, agent_yaw: float) -> FloatArray:
    """The shifts of a change `(n, 2)`, world, m."""
    if kind in (ChangeKind.AGE, ChangeKind.SHARE):
        return np.zeros((len(sizes), 2))
    yaw = ego_yaw if kind in (ChangeKind.ALONG, ChangeKind.ACROSS) else agent_yaw
    yaw += 0.5 * np.pi if kind in (ChangeKind.ACROSS, ChangeKind.BESIDE) else 0.0
    return np.outer(sizes, [np.cos(yaw), np.sin(yaw)])


def _changed(use: InputUse) -> list[InputFault]:
    """The change that explains the agents whose outlines are off."""
    changes, times = Changes(use.frames, use.scenario), use.times
    seen = [agent for agent in use.agents if np.isfinite(agent.off_m)]
    off = [agent for agent in seen if agent.off_m > agent.allowed_m]
    drawn = [agent for agent in seen if agent.drawn is not None or agent.off_m > agent.allowed_m]
    is_exact = use.trace.perceived is None
    least = RARE * len(drawn) if is_exact else RARE_IN_NOISE * len(seen)
    if len({agent.frame for agent in off}) < LEAST or len(off) < least:
        return []
    tried = off[:: max(1, len(off) // SAMPLED)]
    allowed = [max(0.5 * agent.allowed_m, 0.25 * agent.off_m) for agent in tried]
    fits = list[tuple[float, ChangeKind, float]]()
    for kind in ChangeKind:
        size, differences = changes.fit(tried, kind)
        explains = (differences <= allowed).mean() >= MOST
        if explains and abs(size - AS_SHOWN.get(kind, 0.0)) >= LEAST_SIZES.get(kind, LEAST_SHIFT_M):
            fits.append((float(differences.mean()), kind, size))
    if not fits:
        return []
    fits.sort(key=itemgetter(0))
    least, best, size = fits[0]
    as_shown = [agent for agent in seen if agent.off_m <= agent.allowed_m]
    unchanged = [
        agent
        for agent in as_shown[:: max(1, len(as_shown) // SAMPLED)]
        if changes.differences(agent, best, np.array([size]))[0] > agent.allowed_m
    ]
    group = selector(off, unchanged)
    if unchanged and not group and len(unchanged) > (1.0 - MOST) * len(tried):
        return []  # it contradicts others of the same kind
    period = (times[-1] - times[0]) / max(len(times) - 1, 1)
    claims = [
        kind.value.format(size * (period if kind is ChangeKind.AGE else 1.0))
        for mean, kind, size in fits
        if mean <= least + SAME_M
    ]
    claim = " or ".join(claims) + (f" ({group})" if group else "")
    return [InputFault(claim, len(off), len(seen), times[off[0].frame])]


def selector(group: Sequence[AgentUse], others: Sequence[AgentUse]) -> str:
    """What tells a group of agents from others: their kinds, or, of two agents or more, a bound
    between two values; at most two such properties. "" if nothing does, or there are no others.
    """
    kinds = {use.kind for use in group}
    if not others:
        return ""
    words = []
    if not kinds & {use.kind for use in others}:
        words.append(f"of kind {', '.join(sorted(kind.value for kind in kinds))}")
    several = len({use.agent for use in group}) > 1
    for name, unit in PROPERTIES if several else ():
        chosen, left = (np.array([getattr(use, name) for use in part]) for part in (group, others))
        for more, sign in (("more", 1.0), ("less", -1.0)):
            low = sign * np.percentile(sign * left, 100.0 * PURE)
            high = sign * np.percentile(sign * chosen, 100.0 * (1.0 - PURE))
            if sign * low < sign * high:
                least, most = sorted((float(low), float(high)))
                words.append(f"{more} than {least:.1f} to {most:.1f} {unit}")
    return " or ".join(words[:2])
