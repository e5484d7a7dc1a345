"""A street of 20 s: an ego that drives by, cars that drive, turn, stop and stand, people who walk
and ride.
"""

from dataclasses import dataclass

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.agents import AgentKind
from replan.logs.states import Trajectory
from replan.logs.tracks import Tracks

T = np.round(0.1 * np.arange(201), 6)


def street_ego(speed: float = 4.0) -> Trajectory:
    zero = np.zeros(len(T))
    return Trajectory(T, speed * T, zero, zero, np.full(len(T), speed), zero, zero)


@dataclass(frozen=True, eq=False)
class Drive:
    """Speed over time along a line with a constant curvature."""

    kind: AgentKind
    x: float
    y: float
    yaw: float
    speed: FloatArray
    kappa: float = 0.0
    size: tuple[float, float] = (4.5, 1.8)

    def columns(self) -> tuple[FloatArray, ...]:
        s = np.r_[0.0, np.cumsum(0.5 * (self.speed[1:] + self.speed[:-1]) * np.diff(T))]
        yaw = self.yaw + self.kappa * s
        steps = np.diff(s)[:, None] * np.c_[np.cos(yaw), np.sin(yaw)][:-1]
        place = np.array([self.x, self.y]) + np.vstack([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
        return T, place[:, 0], place[:, 1], yaw, self.speed * np.cos(yaw), self.speed * np.sin(yaw)


def street() -> Tracks:
    """Nine road users, all of them there throughout."""
    stop = np.clip(8.0 - 2.0 * (T - 4.0), 0.0, 8.0) + np.clip(1.5 * (T - 12.0), 0.0, 8.0)
    drives = [
        Drive(AgentKind.CAR, -30.0, -3.5, 0.0, np.full(len(T), 6.0)),
        Drive(AgentKind.CAR, 70.0, 3.5, np.pi, stop),
        Drive(AgentKind.CAR, 25.0, 8.0, 0.2, np.full(len(T), 5.0), kappa=0.05),
        Drive(AgentKind.CAR, 20.0, -8.0, 0.0, np.zeros(len(T))),
        Drive(AgentKind.CAR, 26.0, -8.0, np.pi, np.zeros(len(T))),
        Drive(AgentKind.TRUCK, 45.0, 12.0, 0.1, np.zeros(len(T)), size=(8.0, 2.5)),
        Drive(AgentKind.PEDESTRIAN, 15.0, 6.0, 0.0, np.full(len(T), 1.4), size=(0.6, 0.6)),
        Drive(AgentKind.PEDESTRIAN, 40.0, -5.5, 2.0, np.zeros(len(T)), size=(0.6, 0.6)),
        Drive(AgentKind.BICYCLE, 0.0, -6.0, 0.0, np.full(len(T), 4.0), size=(1.8, 0.7)),
    ]
    columns = [
        np.concatenate(each) for each in zip(*(drive.columns() for drive in drives), strict=True)
    ]
    return Tracks(
        tuple("abcdefghi"),
        tuple(drive.kind for drive in drives),
        np.array([drive.size[0] for drive in drives]),
        np.array([drive.size[1] for drive in drives]),
        np.zeros(len(drives), np.bool_),
        len(T) * np.arange(len(drives) + 1),
        *columns,
    )
