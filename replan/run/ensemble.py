"""The ensemble of a log: worlds in which a verdict should be the same.

    again    the very same log: a planner that is not deterministic drives differently
    turned   the world turned about the ego's start by a random angle
    clock    the log's clock set forward, by up to a day
    tiny     errors of 1e-9 on all measured values
    start    the ego's log moved by up to 5 cm along each axis
    noise    Gaussian errors of 2 cm on the agents' positions
    rate     ego and agents sampled at 5 Hz, the rate of the slowest logs of recorded traffic in use

A member's random numbers are seeded by the log's name and the member's number, so that they are the
same in every run.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from replan.logs.edit.transform import jittered, rotated, sampled, shifted_clock
from replan.logs.scenario import Scenario

START_M = 0.05
NOISE_M = 0.02
TINY = 1e-9
RATE_HZ = 5.0
DAY_NS = 86_400_000_000_000


def _turn_world(scenario: Scenario, rng: np.random.Generator) -> Scenario:
    start = scenario.ego.state(0)
    return rotated(scenario, float(rng.uniform(-np.pi, np.pi)), (start.x, start.y))


def _start(scenario: Scenario, rng: np.random.Generator) -> Scenario:
    dx, dy = rng.uniform(-START_M, START_M, 2)
    return scenario.with_ego(lambda ego: replace(ego, x=ego.x + dx, y=ego.y + dy))


def noisy(scenario: Scenario, rng: np.random.Generator, size: float = NOISE_M) -> Scenario:
    """Gaussian errors of `size` m on the positions of the agents that move."""
    tracks = scenario.tracks
    moves = np.repeat(~tracks.static, np.diff(tracks.offsets))
    x, y = (
        column + moves * rng.normal(0.0, size, len(tracks.t)) for column in (tracks.x, tracks.y)
    )
    return replace(scenario, tracks=replace(tracks, x=x, y=y))


PERTURBATIONS: Mapping[str, Callable[[Scenario, np.random.Generator], Scenario]] = MappingProxyType(
    {
        "again": lambda scenario, rng: scenario,
        "turned": _turn_world,
        "clock": lambda scenario, rng: shifted_clock(scenario, int(rng.integers(DAY_NS))),
        "tiny": lambda scenario, rng: jittered(scenario, TINY, int(rng.integers(2**31))),
        "start": _start,
        "noise": noisy,
        "rate": lambda scenario, rng: sampled(scenario, RATE_HZ),
    }
)


def perturbed(scenario: Scenario, member: int) -> tuple[str, Scenario]:
    """Member `member` (from 1) of a log's ensemble: the name of the perturbation and the scenario;
    kinds alternate.
    """
    name = list(PERTURBATIONS)[(member - 1) % len(PERTURBATIONS)]
    seed = int.from_bytes(hashlib.sha256(f"{scenario.name} {member}".encode()).digest()[:8], "big")
    return name, PERTURBATIONS[name](scenario, np.random.default_rng(seed))
