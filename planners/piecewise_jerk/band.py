"""A symmetric positive definite matrix of four bands, stored by lower diagonals: factors and solution in O(n).

(1) M = L D L',   (2) L u = b,  D v = u,  L' x = v
"""

from __future__ import annotations

from math import isfinite

from logs.kernel import FloatArray, inner_kernel

ROUNDING, HUGE = 1e-15, 1e128
"""Pivots that are less than this share of their diagonal are rounding, and are replaced by a huge one."""


@inner_kernel
def factorise(band: FloatArray) -> bool:
    """L D L' in place: D in the first row, L below the diagonal in the others; False where a number is not finite.

    A pivot that is nothing but rounding becomes infinite, so that its coefficient does not move (Wright, "Modified
    Cholesky factorizations in interior-point algorithms for linear programming", 1999).
    """
    size = band.shape[1]
    diagonal = band[0].copy()
    for i in range(size):
        if not isfinite(band[0, i]):
            return False
        if band[0, i] < ROUNDING * diagonal[i]:
            band[0, i] = HUGE
        inverse = 1.0 / band[0, i]
        for d in range(1, min(4, size - i)):
            share = band[d, i] * inverse
            for e in range(d, min(4, size - i)):
                band[e - d, i + d] -= share * band[e, i]
        for d in range(1, 4):
            band[d, i] *= inverse
    return True


@inner_kernel
def back_substitute(band: FloatArray, x: FloatArray) -> None:
    """Replace x by (L D L')^-1 x."""
    size = len(x)
    for i in range(size):
        for d in range(1, min(4, size - i)):
            x[i + d] -= band[d, i] * x[i]
    for i in range(size):
        x[i] /= band[0, i]
    for i in range(size - 1, -1, -1):
        value = x[i]
        for d in range(min(3, size - 1 - i), 0, -1):
            value -= band[d, i] * x[i + d]
        x[i] = value
