"""Tracks cut at a time."""

from __future__ import annotations

import numpy as np

from logs import Tracks


def until(agents: Tracks, time: float) -> Tracks:
    """The tracks cut at `time`: what is later is gone, agents that come later too."""
    keep = agents.t <= time + 1e-9
    first = np.zeros(len(agents.t), bool)
    first[agents.offsets[:-1]] = True
    keep |= first & np.repeat(agents.static, np.diff(agents.offsets))
    sizes = np.array([keep[agents.samples(i)].sum() for i in range(len(agents))], int)
    kept = np.flatnonzero(sizes)
    return Tracks(
        tuple(agents.ids[i] for i in kept), tuple(agents.kinds[i] for i in kept),
        agents.length[kept], agents.width[kept], agents.static[kept], np.r_[0, np.cumsum(sizes[kept])],
        *(getattr(agents, n)[keep] for n in ("t", "x", "y", "yaw", "vx", "vy")),
    )  # fmt: skip
