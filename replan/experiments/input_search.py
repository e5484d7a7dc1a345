"""Which change of its input makes one planner plan what another one planned.

Suspect and reference get the same frames, those of the suspect's drives. A change of the input
(`replan.explain.input_changes`) explains the suspect's plans if the reference, fed with it, plans
the same to the bit (delta debugging of the input: Zeller and Hildebrandt 2002):

(1) plan(frame of the suspect)  =  reference(change(frame of the suspect))

The search looks at the frames in which the two differ most. Where bits differ, the nearest change
is the one of the least distance, which the artefacts make smooth: an obstacle that is half a metre
off tells the way before any plan changes,

(2) distance = d(trajectories) + d(graphs) (`plan_distance`), the mean over the frames

A planner remembers. The frames to look at are those where memory does not matter: with fresh memory
the reference plans the same as in the drive. A change that makes these plans equal is then tried on
all frames of all drives, in order, those in which nothing differs included.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, islice
from math import floor, inf, log10

import numpy as np

from replan.experiments.plan_distance import begins_alike, plan_distance, same_obstacles, same_plan
from replan.experiments.reference_planner import Change, Reference, WatchedDrive
from replan.explain.input_changes import CHANGES, EVERYBODY, InputChange
from replan.logs.agents import AgentKind
from replan.logs.plan import Plan

GLANCE = 2
"""Places at which every change of the input is tried; those that bring no plan nearer are not tried
further. A setting explains all places or none: of settings one place.
"""
PLACES = 6
"""Frames that differ at which the nearer ones are tried and refined, and as many that agree."""
SPREAD = (0.3, 0.5, 0.7, 0.15, 0.85)
"""Where in a drive frames that agree are looked for, as shares of its frames."""
WINDOW = 80
"""Frames of a drive that are looked at from the first difference on."""
APART_S = 0.8
"""Two of these frames of a drive are at least this far apart, s."""
PROMISING = 5
"""Changes that are refined."""
BETTER = 0.95
"""A change is nearer if its distance is below this share of the distance without a change."""
BEYOND = 3.0
"""How far the refinement goes beyond the last try, as multiples of the step before it."""
STEPS = 12
"""Steps of a refinement."""
BESIDE = 0.01
"""Share by which a value is another one, at least itself."""
VEHICLES = frozenset({AgentKind.CAR, AgentKind.TRUCK, AgentKind.BUS})
ON_FOOT_OR_BICYCLE = frozenset({AgentKind.PEDESTRIAN, AgentKind.BICYCLE})
VULNERABLE = frozenset(kind for kind in AgentKind if kind.is_vulnerable)


Places = tuple[tuple[int, int], ...]
"""Drive and frame of each."""


@dataclass(frozen=True, eq=False)
class TriedInput:
    """Changes, and how near to the suspect's plans they bring the reference.

    Attributes:
        distance: The mean of (2) at the places.
        same: Number of plans that are equal to the bit, `total` of how many.
        missed: The frames of all drives whose plans are not equal.
    """

    changes: tuple[Change, ...]
    distance: float
    same: int
    total: int
    missed: Places = ()

    @property
    def is_exact(self) -> bool:
        """Whether all plans are equal to the bit."""
        return self.same == self.total

    @property
    def order(self) -> tuple[float, int, int, int, int]:
        """The better one first: nearer, more equal plans, fewer changes, values and kinds."""
        values = sum(change.row.has_value for change in self.changes)
        kinds = sum(len(change.kinds) for change in self.changes)
        return self.distance, -self.same, len(self.changes), values, kinds


@dataclass(frozen=True, eq=False)
class InputSearch:
    """A search over the drives of the suspect.

    Attributes:
        reference: The planner whose input is changed.
        drives: The drives of the suspect, those that differ most first.
        unchanged: The reference's plans of all frames of each drive, without a change.
    """

    reference: Reference
    drives: Sequence[WatchedDrive]
    unchanged: Sequence[Sequence[Plan | None]]
    _tried: dict[tuple[tuple[Change, ...], Places], TriedInput] = field(default_factory=dict)

    @classmethod
    def of(cls, reference: Reference, drives: Sequence[WatchedDrive]) -> InputSearch:
        """A search over the begin of each drive: up to `WINDOW` frames after the first difference;
        of a drive without one, at most `WINDOW` frames.
        """
        begins: list[WatchedDrive] = []
        unchanged: list[list[Plan | None]] = []
        for drive in drives:
            plans: list[Plan | None] = []
            first = None
            for plan, recorded in zip(reference.plans(drive, ()), drive.plans, strict=True):
                if first is None and not same_plan(plan, recorded):
                    first = len(plans)
                plans.append(plan)
                if first is not None and len(plans) > first + WINDOW:
                    break
            plans = plans[:WINDOW] if first is None else plans
            begins.append(drive.begin(len(plans)))
            unchanged.append(plans)
        return cls(reference, begins, unchanged)

    @cached_property
    def differing(self) -> list[list[int]]:
        """The frames of each drive whose plans differ, in order of time."""
        return [
            [n for n, plan in enumerate(drive.plans) if not same_plan(plans[n], plan)]
            for drive, plans in zip(self.drives, self.unchanged, strict=True)
        ]

    @cached_property
    def places(self) -> Places:
        """The places to look at: those of `apart`, and `PLACES` where nothing differs and nothing
        may.
        """
        return (*self.apart, *islice(self._agreeing(), PLACES))

    @cached_property
    def apart(self) -> Places:
        """The places that differ, the farthest one of each drive in turns."""
        ranked = [self._places_of(row) for row in range(len(self.drives))]
        turns = chain.from_iterable(
            [(row, frames[turn]) for row, frames in enumerate(ranked) if turn < len(frames)]
            for turn in range(PLACES)
        )
        return tuple(islice(turns, PLACES))

    def _agreeing(self) -> Iterator[tuple[int, int]]:
        """Frames among road users in which the plans are equal and memory does not matter, the
        first of each drive in turns, and then others.
        """
        for share in SPREAD:
            for row, drive in enumerate(self.drives):
                n, plans = int(share * len(drive.plans)), self.unchanged[row]
                remembered = plans[n]
                if remembered is None or not len(drive.frames[n].agents):
                    continue
                is_equal = same_plan(remembered, drive.plans[n])
                if is_equal and same_plan(self.reference.plan_afresh(drive, (), n), remembered):
                    yield row, n

    def _places_of(self, row: int) -> list[int]:
        """The frames of a drive in which the plans differ most and memory does not matter."""
        drive, plans = self.drives[row], self.unchanged[row]
        far = {n: plan_distance(plans[n], drive.plans[n]) for n in self.differing[row]}
        frames: list[int] = []
        for n in sorted(far, key=lambda n: (-far[n], n)):
            t = drive.frames[n].t
            if any(abs(t - drive.frames[other].t) < APART_S for other in frames):
                continue
            afresh, remembered = self.reference.plan_afresh(drive, (), n), plans[n]
            if remembered is not None and same_plan(afresh, remembered):
                frames.append(n)
            if len(frames) == PLACES:
                break
        return frames

    @cached_property
    def is_input_same(self) -> bool:
        """Whether the plans begin alike and have the same obstacles at half of the places that
        differ, or more.
        """
        alike = []
        for row, n in self.apart:
            plan, recorded = (
                self.reference.plan_afresh(self.drives[row], (), n),
                self.drives[row].plans[n],
            )
            alike.append(
                plan is not None and begins_alike(plan, recorded) and same_obstacles(plan, recorded)
            )
        return 2 * sum(alike) >= len(alike)

    @cached_property
    def kinds(self) -> list[frozenset[AgentKind]]:
        """The groups of road users of which changes are tried: each kind that is there, those on
        foot or a bicycle, the vulnerable ones, and the vehicles.
        """
        frames = (frame for drive in self.drives for frame in drive.frames)
        present = {kind for frame in frames for kind in frame.agents.kinds}
        single = [frozenset({kind}) for kind in AgentKind if kind in present]
        groups = [ON_FOOT_OR_BICYCLE & present, VULNERABLE & present, VEHICLES & present]
        several = [group for group in dict.fromkeys(groups) if 1 < len(group) < len(present)]
        return [*single, *several] if len(single) > 1 else []

    def at(self, changes: Sequence[Change], places: Places | None = None) -> TriedInput:
        """The changes, tried at some of the places; None: at all."""
        key = tuple(changes), self.places if places is None else places
        if key not in self._tried:
            if not key[1]:  # memory matters in all frames: nothing can be compared alone
                return TriedInput(key[0], inf, 0, 0)
            pairs = [
                (
                    self.reference.plan_afresh(self.drives[row], changes, n),
                    self.drives[row].plans[n],
                )
                for row, n in key[1]
            ]
            far = [plan_distance(plan, recorded) for plan, recorded in pairs]
            same = sum(same_plan(plan, recorded) for plan, recorded in pairs)
            self._tried[key] = TriedInput(key[0], float(np.mean(far)), same, len(pairs))
        return self._tried[key]

    def _to_glance_at(self, before: Sequence[Change], most: int) -> Places:
        """The first places, at most `most`, that changes do not explain."""
        return tuple(
            islice((place for place in self.places if not self.at(before, (place,)).same), most)
        )

    def everywhere(self, changes: Sequence[Change], most_misses: float = inf) -> TriedInput:
        """The changes, tried on all frames of all drives, in order, until more than `most_misses`
        plans are not equal.
        """
        missed: list[tuple[int, int]] = []
        total = 0
        for row, drive in enumerate(self.drives):
            is_changed = self.reference.is_changed(drive, changes)
            plans = self.reference.plans(drive, changes) if is_changed else self.unchanged[row]
            for number, (plan, recorded) in enumerate(zip(plans, drive.plans, strict=True)):
                total += 1
                missed += [] if same_plan(plan, recorded) else [(row, number)]
                if len(missed) > most_misses:
                    break
        distance, same = self.at(changes).distance, total - len(missed)
        return TriedInput(tuple(changes), distance, same, total, tuple(missed))

    def corrected(self, tried: TriedInput) -> tuple[Change, ...]:
        """The changes with values that are the best in a few of the frames that they missed."""
        changes, step = tried.changes, max(1, len(tried.missed) // GLANCE)
        for place in (n for n, change in enumerate(changes) if change.row.has_value):
            changes = self._best_value(changes, place, tried.missed[::step][:GLANCE]).changes
        return changes

    def inputs(self) -> list[Change]:
        """All changes of the input, each with a first value."""
        return [
            InputChange(name, row.tries[0], kinds)
            for name, row in CHANGES.items()
            for kinds in (EVERYBODY, *(self.kinds if row.of_kinds else ()))
        ]

    def nearer(
        self, candidates: Sequence[Change], before: Sequence[Change] = (), glance: int = GLANCE
    ) -> list[TriedInput]:
        """The candidates that bring the reference nearer, added to those `before`, with their best
        values, the best first. Those that do not at the first `glance` places are left out.
        """
        best: list[TriedInput] = []
        some = self._to_glance_at(before, glance)
        for change in candidates:
            tries = [(*before, replace(change, value=value)) for value in change.row.tries]
            glances = [tried for tried in tries if self._is_nearer(tried, before, some)]
            near = [self.at(tried) for tried in glances if self._is_nearer(tried, before)]
            if near:
                best.append(min(near, key=lambda tried: tried.order))
        promising = sorted(best, key=lambda tried: self.at(tried.changes, self.apart).order)
        refined: list[TriedInput] = []
        for tried in promising[:PROMISING]:
            refined.append(self.refined(tried.changes, len(before)))
            if refined[-1].distance == 0.0:
                break  # nothing is nearer
        left = promising[len(refined) : PROMISING]
        return sorted([*refined, *left], key=lambda tried: tried.order)

    def _is_nearer(
        self, changes: Sequence[Change], before: Sequence[Change], places: Places | None = None
    ) -> bool:
        """Whether at some of the places, at those of `apart` without, more plans are equal than
        with the changes `before`, or they are nearer.
        """
        where = self.apart if places is None else places
        tried, base = self.at(changes, where), self.at(before, where)
        return tried.same > base.same or tried.distance < BETTER * base.distance

    def finalists(
        self, count: int, most: int, kind: type[Change] = InputChange
    ) -> list[tuple[Change, ...]]:
        """The best `most` of all tries of `count` changes of a kind, and all that are as good as
        the best.
        """
        tries = [
            tried
            for (changes, places), tried in self._tried.items()
            if len(changes) == count
            and places == self.places
            and all(isinstance(change, kind) for change in changes)
        ]
        tries.sort(key=lambda tried: tried.order)
        as_good = sum(tried.order[:2] == tries[0].order[:2] for tried in tries)
        return [tried.changes for tried in tries[: max(most, as_good)]]

    def tried_anew(self, changes: Sequence[Change], place: int) -> TriedInput:
        """As `refined`, with the best one of the values that a search begins with."""
        change = changes[place]
        tries = [
            [*changes[:place], replace(change, value=value), *changes[place + 1 :]]
            for value in {**dict.fromkeys(change.row.tries), change.value: None}
        ]
        best = min(map(self.at, tries), key=lambda tried: tried.order)
        return self.refined(best.changes, place)

    def refined(self, changes: Sequence[Change], place: int) -> TriedInput:
        """The changes with the best value of the one at `place`.

        It is searched where the change alone explains most: other places may need another change.
        It is searched at all places if there are many such values, as of a limit, or none.
        """
        others = [*changes[:place], *changes[place + 1 :]]
        nearer = {
            where: self.at(changes, (where,)).distance
            for where in self.apart
            if self.at(changes, (where,)).distance < self.at(others, (where,)).distance
        }
        if not nearer or not changes[place].row.has_value:
            return self.at(changes)
        focus = (min(nearer, key=lambda where: nearer[where]),)
        best = self._best_value(changes, place, focus)
        value = best.changes[place].value
        beside = replace(best.changes[place], value=value + max(BESIDE * abs(value), BESIDE))
        other = [*changes[:place], beside, *changes[place + 1 :]]
        if not best.is_exact or self.at(other, focus).is_exact:
            best = self._best_value(best.changes, place, self.places)
        return self.at(best.changes)

    def _best_value(self, changes: Sequence[Change], place: int, places: Places) -> TriedInput:
        """As `refined`, at some of the places."""
        change = changes[place]
        row = change.row

        def tried(value: float) -> TriedInput:
            with_value = replace(change, value=value)
            return self.at([*changes[:place], with_value, *changes[place + 1 :]], places)

        best = tried(change.value)
        values = sorted({*row.tries, change.value})
        index = values.index(change.value)
        low = values[index - 1] if index else values[0] - BEYOND * (values[1] - values[0])
        high = values[-1] + BEYOND * (values[-1] - values[-2])
        high = values[index + 1] if index + 1 < len(values) else high
        low = max(low, 0.0) if values[0] >= 0.0 else low
        if row.is_whole:
            whole = [tried(float(value)) for value in range(round(low), round(high) + 1)]
            return min([best, *whole], key=lambda item: item.order)
        for _ in range(STEPS):
            if best.is_exact and best.distance == 0.0:
                break
            middle = best.changes[place].value
            halves = [tried(0.5 * (low + middle)), tried(0.5 * (middle + high))]
            if {half.distance for half in halves} == {best.distance}:
                break  # only the order of the value and those of the agents matters
            nearest = min([best, *halves], key=lambda item: item.order)
            value = nearest.changes[place].value
            if value < middle:
                high = middle
            elif value > middle:
                low = middle
            else:
                low, high = 0.5 * (low + middle), 0.5 * (middle + high)
            best = min([nearest, *map(tried, rounded(value))], key=lambda item: item.order)
        return best


def rounded(value: float) -> list[float]:
    """The value with one, two and three digits."""
    if value == 0.0 or not abs(value) < inf:
        return [value]
    order = floor(log10(abs(value)))
    return list(dict.fromkeys(round(value, digits - order) for digits in range(3)))
