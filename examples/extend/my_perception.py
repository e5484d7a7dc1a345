"""A perception: the planner sees the agents within a range."""

import numpy as np


def ahead(scenario, config, *, range_m: float = 50.0):
    """Agents within a range; walls hide none."""

    def see(world):
        known = world.tracks.perceived(world.ego.t)
        near = np.hypot(known.x - world.ego.x, known.y - world.ego.y) <= range_m
        shown = [name for name, is_near in zip(known.ids, near, strict=True) if is_near]
        return world.tracks.only(shown).perceived(world.ego.t), None

    return see
