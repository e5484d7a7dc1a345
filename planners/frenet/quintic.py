"""The quintic between two states at rest in its second derivative: the shape of every lateral move.

(1) x(d) = x0 + x0' d + x0'' d^2 / 2 + c3 d^3 + c4 d^4 + c5 d^5    with (x, x', x'')(length) = (x1, 0, 0)

(Werling et al., "Optimal Trajectory Generation for Dynamic Street Scenarios in a Frenet Frame", ICRA 2010)
"""

from __future__ import annotations

from logs.kernel import kernel


@kernel
def quintic(l0: float, dl0: float, ddl0: float, l1: float, length: float) -> tuple[float, float, float]:
    """Coefficients c3, c4, c5 of the quintic from (l0, l0', l0'') to (l1, 0, 0) over `length` m."""
    h = length
    delta = l1 - l0 - dl0 * h - 0.5 * ddl0 * h * h
    slope = -dl0 - ddl0 * h
    bend = -ddl0
    c3 = (10.0 * delta - 4.0 * slope * h + 0.5 * bend * h * h) / h**3
    c4 = (-15.0 * delta + 7.0 * slope * h - bend * h * h) / h**4
    c5 = (6.0 * delta - 3.0 * slope * h + 0.5 * bend * h * h) / h**5
    return c3, c4, c5
