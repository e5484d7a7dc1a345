"""What a long drive keeps in memory: its frames come back as they were, a part of its tracks
answers as the whole.
"""

import pickle
from dataclasses import fields, replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from differences import differences
from hypothesis import given, strategies as st

from replan.logs.agents import AgentKind
from replan.logs.catalogue import scenario
from replan.logs.frame_store import FrameStore, SpilledTrajectory, light
from replan.logs.mcap import write_trace
from replan.logs.mcap.trace_file import plan_message
from replan.logs.nearby_tracks import BACK_S, SPAN_S, NearbyTracks, Recent
from replan.logs.plan import Graph
from replan.logs.states import EgoState
from replan.logs.trace import PlannedFrame
from replan.logs.tracks import Tracks
from replan.logs.vehicle import VehicleParameters
from replan.metrics import evaluate
from replan.replay.drive import Drive
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.contacts import contact
from replan.replay.world import World


@pytest.fixture(scope="module")
def driven() -> Drive:
    return run_closed_loop(scenario("everyday/follow"), "dp_qp")


def stored(frames: tuple[PlannedFrame, ...], whole: int) -> FrameStore:
    store = FrameStore(whole)
    for frame in frames:
        store.append(frame)
    return store


def bits(frame: PlannedFrame) -> tuple[bytes, bytes, bytes]:
    assert frame.predictions is not None
    plan = msgspec.json.encode(plan_message(frame.plan, "full"))
    return plan, frame.predictions.x.tobytes(), frame.predictions.yaw.tobytes()


@pytest.mark.parametrize("whole", [0, 1, 50])
def test_frames_come_back_to_the_bit(driven: Drive, whole: int) -> None:
    frames = tuple(driven.trace.frames)
    store = stored(frames, whole)
    assert store.frames is store and len(store) == len(frames)
    for index in (*range(0, len(frames), 17), -1):
        back = store[index]
        assert bits(back) == bits(frames[index])
        assert back.t == frames[index].t
        for path in (back.plan.trajectory, light(store)[index].plan.trajectory):
            assert path.x.tobytes() == frames[index].plan.trajectory.x.tobytes()
            assert path.at(back.t + 0.55) == frames[index].plan.trajectory.at(back.t + 0.55)
            assert not path.kappa.flags.writeable
    assert [frame.t for frame in store[-3:]] == [frame.t for frame in frames[-3:]]
    with pytest.raises(IndexError):
        store[len(frames)]


def test_large_arrays_are_not_in_memory(driven: Drive) -> None:
    small = light(stored(tuple(driven.trace.frames), 0))
    assert not any(isinstance(item, Graph) for frame in small for item in frame.plan.internals)
    assert all(
        frame.predictions is None and isinstance(frame.plan.trajectory, SpilledTrajectory)
        for frame in small
    )
    assert len(pickle.dumps(small)) < 0.5 * len(pickle.dumps(tuple(driven.trace.frames)))
    assert isinstance(stored(tuple(driven.trace.frames), 10_000).frames, tuple), (
        "a short drive is a tuple as before"
    )


def test_metrics_and_trace_are_the_same(driven: Drive, tmp_path: Path) -> None:
    world, trace = scenario("everyday/follow"), driven.trace
    long = replace(trace, frames=stored(tuple(trace.frames), 20))
    assert evaluate(trace, world).equals(evaluate(long, world))
    for name, one in (("whole", trace), ("long", long)):
        write_trace(tmp_path / name, one, world, internals="full")
    assert (tmp_path / "whole").read_bytes() == (tmp_path / "long").read_bytes()


UNTIL_S = 120.0
CAR = VehicleParameters()


def come_and_go(seed: int, count: int = 12) -> Tracks:
    """Tracks that begin and end anywhere, at rates of 20 to 0.7 Hz that may change, with gaps.

    One is static.
    """
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
    return Tracks(
        ids,
        kinds,
        size,
        size,
        static,
        offsets,
        np.concatenate(t),
        x,
        y,
        rng.normal(0.0, 3.0, m),
        vx,
        vy,
    )


@given(st.integers(0, 10_000), st.floats(-2.0, UNTIL_S))
def test_perceived_agents_are_equal_to_the_bit(seed: int, begin: float) -> None:
    whole, around = come_and_go(seed), NearbyTracks(few=0)
    for time in begin + np.array([0.0, 0.05, 0.7, 3.0, SPAN_S - 0.01, SPAN_S, 3.0 * SPAN_S, 1.0]):
        part = around.of(whole, float(time), float(time))
        assert not differences(part.perceived(float(time)), whole.perceived(float(time)))
        assert not differences(part.truth(float(time)), whole.truth(float(time)))


@given(st.integers(0, 10_000), st.floats(-2.0, UNTIL_S))
def test_contacts_with_a_part_are_those_with_the_whole(seed: int, time: float) -> None:
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


def test_a_selection_of_nearby_tracks_is_that_of_the_whole() -> None:
    whole = come_and_go(2)
    now = whole.taken(whole.t >= 60.0)
    recent = Recent(
        *(getattr(now, each.name) for each in fields(Tracks)), all_of_them=lambda: whole
    )
    few = now.ids[:2]
    assert recent.only(few).ids == recent.only(few).whole.ids == few
    assert recent.only(few).t.tobytes() == now.only(few).t.tobytes()
    assert recent.only(few).whole.t.tobytes() == whole.only(few).t.tobytes()
    assert recent.only(few).only(few[1:]).whole.ids == few[1:]
