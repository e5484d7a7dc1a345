"""The fuzzy safety model: how critical a gap is, and how hard to brake for it.

u is the leader's speed along the line m/s, v the driver's, a the driver's acceleration m/s2, gap m. Source: Mattas et
al., Accid. Anal. Prev. 148 (2020) 105794; UN R157.01, Annex 3.

(1) deceleration = 4 + 2 CFS m/s2 where CFS > 0, else 4 PFS
(2) PFS of gap - 2 m: 0 above safe = 0.75 v + v^2 / 8 - u^2 / 14 + 2 m, 1 below unsafe = 0.75 v + v^2 / 12 - u^2 / 14
(3) CFS of the gap, with a' = max(a, -4), v' = v + 0.75 a': 0 where v <= u; where v' < u: 1 if gap <
    (v - u)^2 / (2 |a'|), else 0; else 0 above safe and 1 below unsafe = (v + 0.375 a' - u) 0.75 + (v' - u)^2 / 8, / 12

Between safe and unsafe both are linear.
"""

from __future__ import annotations

from logs.kernel import inner_kernel, kernel

FSM_REACT_S, FSM_COMFORT_MPS2, FSM_HARDEST_MPS2, FSM_LEAD_MPS2 = 0.75, 4.0, 6.0, 7.0
FSM_MARGIN_M, FSM_SAFE_M = 2.0, 2.0


@inner_kernel
def fsm_fuzzy(gap: float, safe: float, unsafe: float) -> float:
    """0 from `safe` on, 1 up to `unsafe`, linear between; a step where both are the same."""
    if gap >= safe:
        return 0.0
    if gap <= unsafe or safe - unsafe < 1e-9:
        return 1.0
    return (safe - gap) / (safe - unsafe)


@kernel
def fsm_proactive(gap: float, v: float, u: float) -> float:
    """PFS (2)."""
    reach = v * FSM_REACT_S - u * u / (2.0 * FSM_LEAD_MPS2)
    safe = reach + v * v / (2.0 * FSM_COMFORT_MPS2) + FSM_SAFE_M
    return fsm_fuzzy(gap - FSM_MARGIN_M, safe, reach + v * v / (2.0 * FSM_HARDEST_MPS2))


@kernel
def fsm_critical(gap: float, v: float, u: float, a: float) -> float:
    """CFS (3)."""
    if v <= u:
        return 0.0
    a = max(a, -FSM_COMFORT_MPS2)
    v_then = v + FSM_REACT_S * a
    if v_then < u:  # so a < 0
        return 1.0 if gap < (v - u) ** 2 / (2.0 * abs(a)) else 0.0
    reach = (v + 0.5 * a * FSM_REACT_S - u) * FSM_REACT_S
    square = (v_then - u) ** 2
    return fsm_fuzzy(gap, reach + square / (2.0 * FSM_COMFORT_MPS2), reach + square / (2.0 * FSM_HARDEST_MPS2))


@inner_kernel
def fsm_deceleration(gap: float, v: float, u: float, a: float) -> float:
    """(1), m/s2."""
    critical = fsm_critical(gap, v, u, a)
    if critical > 0.0:
        return FSM_COMFORT_MPS2 + (FSM_HARDEST_MPS2 - FSM_COMFORT_MPS2) * critical
    return FSM_COMFORT_MPS2 * fsm_proactive(gap, v, u)
