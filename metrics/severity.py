"""How hard the ego's collisions are: closed loop, a value at the first touch of each road user (`safety.contacts`).

(1) impact speed = |v_e - v_o|, both velocity vectors as they meet, m/s
(2) delta-v of the ego = m_o / (m_o + m_e) |v_e - v_o|: the change of its velocity if both stick together

m_e is the mass of the ego's vehicle, m_o that of the other's class (`MASS_KG`); an object is taken as immovable, which
is the worst case (delta-v = impact speed). nuPlan takes 2000 kg for both. Who appeared where the ego was did not run
into it and has no value.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from logs.scenario import AgentKind, Scenario
from logs.trace import Mode, Trace
from metrics.metric import MAX, Measured, Metric, Series
from metrics.safety import ContactKind, contacts, impact_speed, label

PERSON_KG = 75.0
"""A driver: Regulation (EU) No 1230/2012."""
MASS_KG: Mapping[AgentKind, float] = MappingProxyType({
    AgentKind.CAR: 1500.0,  # EN 1317-1, test vehicle of TB 32
    AgentKind.TRUCK: 10_000.0,  # EN 1317-1, rigid heavy goods vehicle of TB 42
    AgentKind.BUS: 13_000.0,  # EN 1317-1, bus of TB 51
    AgentKind.MOTORCYCLE: PERSON_KG + 200.0,  # a middle-weight machine, round
    AgentKind.BICYCLE: PERSON_KG + 15.0,  # a city bicycle, round
    AgentKind.PEDESTRIAN: PERSON_KG,
    AgentKind.OBJECT: np.inf,
})  # fmt: skip
PARTS = ("impact_speed", "delta_v")


def delta_v(speed: float, mass: float, other_mass: float) -> float:
    """(2), m/s."""
    return speed if np.isinf(other_mass) else speed * other_mass / (other_mass + mass)


def _severity(trace: Trace, scenario: Scenario) -> Mapping[str, Measured]:
    found, labels = np.full((2, len(trace.ego)), np.nan), [""] * len(trace.ego)
    for contact in contacts(trace, scenario):
        k, mass = contact.step, MASS_KG[trace.agents.kinds[contact.agent]]
        speed = impact_speed(contact, trace, scenario)
        change = delta_v(speed, scenario.vehicle.mass, mass)
        if contact.kind is not ContactKind.FROM_START and not found[1, k] >= change:
            found[:, k] = speed, change
            labels[k] = label(contact, trace)
    return {
        part: Series(trace.ego.t, value, tuple(labels), "no collision")
        for part, value in zip(PARTS, found, strict=True)
    }


COLLISION_SEVERITY = Metric(
    "collision_severity", "m/s", "lower", (Mode.CLOSED,), _severity, (MAX,),
    "Impact speed of a collision, and the change of the ego's velocity if both stick together.",
    "nuPlan devkit e9241677, no_ego_at_fault_collisions; masses: EN 1317-1, Regulation (EU) No 1230/2012",
    parts=PARTS, formula="impact_speed = |v_e - v_o|; delta_v = m_o / (m_o + m_e) |v_e - v_o|", parameters=(
        "m_e: the vehicle's mass",
        "m_o: " + ", ".join(f"{kind.value} {mass:g} kg" for kind, mass in MASS_KG.items() if np.isfinite(mass)),
        "object: immovable",
    ), needs="a collision",
)  # fmt: skip
