"""The frames of a long drive come back from their file as they were, and what metrics look at stays in memory."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import msgspec
import pytest

from logs.catalogue import scenario
from logs.mcap import write_trace
from logs.mcap.trace import plan_message
from logs.memory import Filed, FrameStore, light
from logs.trace import Graph, PlannedFrame
from metrics import evaluate
from replay.drive import Drive
from replay.loop.closed_loop import run_closed_loop


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


def test_what_is_large_is_not_in_memory(driven: Drive) -> None:
    small = light(stored(tuple(driven.trace.frames), 0))
    assert not any(isinstance(item, Graph) for frame in small for item in frame.plan.internals)
    assert all(frame.predictions is None and isinstance(frame.plan.trajectory, Filed) for frame in small)
    assert len(pickle.dumps(small)) < 0.5 * len(pickle.dumps(tuple(driven.trace.frames)))
    assert isinstance(stored(tuple(driven.trace.frames), 10_000).frames, tuple), "a short drive is a tuple as before"


def test_metrics_and_trace_are_the_same(driven: Drive, tmp_path: Path) -> None:
    world, trace = scenario("everyday/follow"), driven.trace
    long = replace(trace, frames=stored(tuple(trace.frames), 20))
    assert evaluate(trace, world).equals(evaluate(long, world))
    for name, one in (("whole", trace), ("long", long)):
        write_trace(tmp_path / name, one, world, internals="full")
    assert (tmp_path / "whole").read_bytes() == (tmp_path / "long").read_bytes()
