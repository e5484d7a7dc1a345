"""What the planner is allowed to see: a Frame, made of the World.

Ground truth for now: every agent at its last sample not later than the frame's time, carried on with its velocity
(`Tracks.perceived`). Nothing of a later sample goes in.
"""

from __future__ import annotations

from logs.frame import Frame
from logs.trace import Plan
from planners.prediction import predict
from replay.drive import LoopConfig
from replay.world import World


def perceive(world: World, previous: Plan | None, config: LoopConfig) -> Frame:
    """The frame at the world's time; `previous` is the plan being driven, None in open loop and at the start."""
    t = world.ego.t
    agents = world.tracks.perceived(t)
    predictions = predict(
        agents,
        t,
        horizon=config.prediction_horizon_s,
        step=config.prediction_step_s,
        method=config.prediction,
    )
    return Frame(t, world.ego, agents, predictions, previous)
