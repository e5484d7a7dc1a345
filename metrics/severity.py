"""Severity of collisions, closed loop: how fast the ego hits, and how much its velocity changes.

At the first touch of each road user, with the velocity vectors v, the ego's mass m_e and that of
the other's class m_o (`MASS_KG`; an object is immovable; nuPlan assumes 2000 kg for both). Not
measured for FROM_START (`collisions`):

(1) impact speed = |v_e - v_o|, m/s
(2) delta-v of the ego = m_o / (m_o + m_e) |v_e - v_o|:
        the change of its velocity if both stick together
"""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from types import MappingProxyType

import numpy as np

from replan.logs.agents import AgentKind
from replan.logs.scenario import Scenario
from replan.logs.trace import Trace
from replan.metrics.collisions import ContactKind, contacts, impact_speed, label
from replan.metrics.metric import Parts, Series, metric
from replan.metrics.reductions import MAX

PERSON_KG = 75.0  # A driver: Regulation (EU) No 1230/2012
MASS_KG: Mapping[AgentKind, float] = MappingProxyType(
    {
        AgentKind.CAR: 1500.0,  # EN 1317-1, test vehicle of TB 32
        AgentKind.TRUCK: 10_000.0,  # EN 1317-1, rigid heavy goods vehicle of TB 42
        AgentKind.BUS: 13_000.0,  # EN 1317-1, bus of TB 51
        AgentKind.MOTORCYCLE: PERSON_KG + 200.0,  # a middle-weight motorcycle, rounded
        AgentKind.BICYCLE: PERSON_KG + 15.0,  # a city bicycle, rounded
        AgentKind.PEDESTRIAN: PERSON_KG,
        AgentKind.OBJECT: np.inf,
    }
)
PARTS = ("impact_speed", "delta_v")


def delta_v(speed: float, mass: float, other_mass: float) -> float:
    """Return the delta-v of the ego (2), m/s."""
    return speed if np.isinf(other_mass) else speed * other_mass / (other_mass + mass)


_MASSES = ", ".join(f"{kind.value} {mass:g} kg" for kind, mass in MASS_KG.items() if isfinite(mass))


@metric(
    unit="m/s",
    better="lower",
    reductions=(MAX,),
    parts=PARTS,
    parameters=("m_e: the vehicle's mass", f"m_o: {_MASSES}", "object: immovable"),
    needs="a collision",
    source="nuPlan devkit e9241677, no_ego_at_fault_collisions; masses: EN 1317-1, "
    "Regulation (EU) No 1230/2012",
)
def collision_severity(trace: Trace, scenario: Scenario) -> Parts:
    """Impact speed of a collision, and the change of the ego's velocity if both stick together.

    Formula: impact_speed = |v_e - v_o|; delta_v = m_o / (m_o + m_e) |v_e - v_o|
    """
    speeds, changes = np.full((2, len(trace.ego)), np.nan)
    labels = [""] * len(trace.ego)
    for contact in contacts(trace, scenario):
        step, mass = contact.step, MASS_KG[trace.agents.kinds[contact.agent]]
        speed = impact_speed(contact, trace, scenario)
        change = delta_v(speed, scenario.vehicle.mass, mass)
        if contact.kind is not ContactKind.FROM_START and not changes[step] >= change:
            speeds[step], changes[step] = speed, change
            labels[step] = label(contact, trace)
    return {
        part: Series(trace.ego.t, values, tuple(labels), "no collision")
        for part, values in zip(PARTS, (speeds, changes), strict=True)
    }
