"""A part of a log answers for an instant as the whole does."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from logs import AgentKind, Agents, Tracks
from logs.memory import BACK_S, SPAN_S, NearbyTracks, Recent
from logs.states import EgoState
from logs.vehicle import VehicleParameters
from replay.world import World, contact

UNTIL_S = 120.0
CAR = VehicleParameters()


def come_and_go(seed: int, count: int = 12) -> Tracks:
    """Tracks that begin and end anywhere, at rates of 20 to 0.7 Hz that may change, with gaps; one is static."""
    rng = np.random.default_rng(seed)
    t = []
    for _ in range(count):
        rates = rng.choice([0.05, 0.1, 0.5, 1.0, 1.5], 2)
        steps = np.repeat(rates, rng.integers(1, 200, 2)) * rng.uniform(0.8, 1.2)
        steps[rng.random(len(steps)) < 0.02] = rng.uniform(0.4, 4.0)
        t.append(rng.uniform(-1.0, UNTIL_S) + np.cumsum(steps))
    sizes = [len(some) for some in t]
    m = sum(sizes)
    x, y = (np.cumsum(rng.normal(0.0, 0.3, m)) for _ in range(2))
    vx, vy = (np.where(rng.random(m) < 0.3, np.nan, rng.normal(0.0, 5.0, m)) for _ in range(2))
    kinds = (*(AgentKind.CAR,) * (count - 1), AgentKind.OBJECT)
    static = np.arange(count) == count - 1
    ids, size = tuple(map(str, range(count))), np.full(count, 2.0)
    offsets = np.r_[0, np.cumsum(sizes)]
    return Tracks(ids, kinds, size, size, static, offsets, np.concatenate(t), x, y, rng.normal(0.0, 3.0, m), vx, vy)


def same(one: Agents, two: Agents) -> bool:
    names = [each.name for each in fields(Agents) if each.name not in ("ids", "kinds")]
    alike = all(getattr(one, name).tobytes() == getattr(two, name).tobytes() for name in names)
    return alike and (one.ids, one.kinds) == (two.ids, two.kinds)


@given(st.integers(0, 10_000), st.floats(-2.0, UNTIL_S))
def test_who_is_perceived_and_how_is_the_same_to_the_bit(seed: int, begin: float) -> None:
    whole, around = come_and_go(seed), NearbyTracks(few=0)
    for time in begin + np.array([0.0, 0.05, 0.7, 3.0, SPAN_S - 0.01, SPAN_S, 3.0 * SPAN_S, 1.0]):
        part = around.of(whole, float(time), float(time))
        assert same(part.perceived(float(time)), whole.perceived(float(time)))
        assert same(part.truth(float(time)), whole.truth(float(time)))


@given(st.integers(0, 10_000), st.floats(-2.0, UNTIL_S))
def test_who_is_touched_is_the_same(seed: int, time: float) -> None:
    whole = come_and_go(seed)
    part = NearbyTracks(few=0).of(whole, time, time)
    for agent in whole.truth(time).ids[:3]:
        at = whole.truth(time).ids.index(agent)
        there = whole.truth(time)
        ego = EgoState(time, float(there.x[at]), float(there.y[at]), 0.3, 1.0)
        one, two = contact(World(ego, whole), CAR), contact(World(ego, part), CAR)
        assert (one, two) != (-1, -1) and whole.ids[one] == part.ids[two]


def test_a_part_is_kept_for_its_span_and_holds_no_more_than_around_it() -> None:
    whole, around = come_and_go(1, 200), NearbyTracks(few=0)
    part = around.of(whole, 50.0, 50.0)
    assert around.of(whole, 50.0 + SPAN_S, 50.0 + SPAN_S) is part
    assert around.of(whole, 51.0, 50.5 + SPAN_S) is not part
    moving = np.repeat(~part.static, np.diff(part.offsets))
    assert len(part.t) < 0.4 * len(whole.t) and part.t[moving].max() < 50.0 + SPAN_S + 5.0
    inner = [part.t[part.samples(i)] for i in range(len(part))]
    assert all((t > 50.0 - BACK_S - 2.0).sum() >= len(t) - 12 for t in inner[:-1])
    assert NearbyTracks().of(part, 50.0, 50.0) is part


def test_some_of_those_around_now_are_some_of_the_whole() -> None:
    whole = come_and_go(2)
    now = whole.taken(whole.t >= 60.0)
    recent = Recent(*(getattr(now, each.name) for each in fields(Tracks)), all_of_them=lambda: whole)
    few = now.ids[:2]
    assert recent.only(few).ids == recent.only(few).whole.ids == few
    assert recent.only(few).t.tobytes() == now.only(few).t.tobytes()
    assert recent.only(few).whole.t.tobytes() == whole.only(few).t.tobytes()
    assert recent.only(few).only(few[1:]).whole.ids == few[1:]
