"""Made-up crowds on the roads of logs, for benchmarks.

Imports nothing that moves between versions but the nouns.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from replan.logs.agents import AgentKind
from replan.logs.scenario import Scenario
from replan.logs.tracks import Tracks

CROWDS = (50, 200, 500)
LASTS_S = 3.0


def crowded(scenario: Scenario, n: int) -> Scenario:
    """The log's road and ego among `n` agents that drive and walk straight on from places on its
    lanes for 3 s.
    """
    rng, t = np.random.default_rng(0), np.linspace(0.0, LASTS_S, 31)
    lanes = [lane for lane in scenario.road.lanes.values() if lane.drivable]
    rows = []
    for lane in (lanes[i] for i in rng.integers(len(lanes), size=n)):
        k = rng.integers(len(lane.center) - 1)
        heading = np.arctan2(*(lane.center[k + 1] - lane.center[k])[::-1]) + rng.normal(0.0, 0.05)
        vx, vy = rng.uniform(0.0, 12.0) * np.array([np.cos(heading), np.sin(heading)])
        x, y = lane.center[k] + rng.normal(0.0, 0.6, 2)
        rows.append(
            np.vstack([t, x + vx * t, y + vy * t, *np.array([[heading], [vx], [vy]]) + 0.0 * t])
        )
    kinds = tuple(
        AgentKind.CAR if on_wheels else AgentKind.PEDESTRIAN
        for on_wheels in rng.uniform(size=n) > 0.1
    )
    sizes, offsets = (np.full(n, 4.5), np.full(n, 1.8)), len(t) * np.arange(n + 1)
    return replace(
        scenario,
        tracks=Tracks(
            tuple(map(str, range(n))), kinds, *sizes, np.zeros(n, bool), offsets, *np.hstack(rows)
        ),
    )
