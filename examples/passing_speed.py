"""A metric: how fast the ego drives beside people on foot or on two wheels.

    replan evaluate LOGS --metric passing_speed:passing_speed

(1) value(t) = v(t) where the middle of such a road user is within REACH_M of the ego's middle line,
        beside its body; NaN in every other step
"""

from __future__ import annotations

import numpy as np

from replan import MAX, Scenario, Series, Trace, Unavailable, metric

REACH_M = 3.0
"""Half of a car's width and the 2 m that German law asks for beside riders out of town (StVO, 5
(4)).
"""
STEP_S = 0.1
"""Steps at which agents are tested, s."""


@metric(
    unit="m/s",
    better="lower",
    reductions=(MAX,),
    parameters=(f"beside: within {REACH_M} m",),
    needs="someone on foot or on two wheels",
)
def passing_speed(trace: Trace, scenario: Scenario) -> Series | Unavailable:
    """Speed while someone on foot or on two wheels is beside the ego, within 3 m.

    Formula: v where one is beside the body, at most 3 m from the middle line
    """
    if not any(kind.is_vulnerable for kind in trace.agents.kinds):
        return Unavailable("no one on foot or on two wheels in the log")
    ego, car = trace.ego, scenario.vehicle
    t = np.arange(ego.t[0], ego.t[-1], STEP_S)
    rows = np.searchsorted(ego.t, t)
    value, labels = np.full(len(t), np.nan), [""] * len(t)
    for step, i in enumerate(rows):
        agents = trace.agents.truth(float(ego.t[i]))
        dx, dy = agents.x - ego.x[i], agents.y - ego.y[i]
        ahead = dx * np.cos(ego.yaw[i]) + dy * np.sin(ego.yaw[i])
        side = dy * np.cos(ego.yaw[i]) - dx * np.sin(ego.yaw[i])
        soft = np.array([kind.is_vulnerable for kind in agents.kinds], bool)
        near = (
            soft
            & (ahead > -car.rear_overhang)
            & (ahead < car.axle_to_front)
            & (np.abs(side) < REACH_M)
        )
        if near.any():  # (1)
            value[step] = ego.v[i]
            labels[step] = agents.ids[int(np.flatnonzero(near)[0])]
    return Series(ego.t[rows], value, tuple(labels), missing="no one was passed")
