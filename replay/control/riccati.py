"""The discrete algebraic Riccati equation, by structured doubling.

(1) P = Q + A' P (I + G P)^-1 A,    G = B R^-1 B'
(2) A <- A (I + G H)^-1 A
    G <- G + A (I + G H)^-1 G A'
    H <- H + A' H (I + G H)^-1 A        from H = Q; H -> P, its error squared in each round

Source: Chu, Fan, Lin, Wang, Structure-preserving algorithms for periodic discrete-time algebraic Riccati equations,
Int. J. Control 77 (2004), section 3. A kernel of small matrices, since the library solvers take a hundred times longer
where the threads of their linear algebra find the cores busy.
"""

from __future__ import annotations

import numpy as np

from logs.kernel import FloatArray, kernel

MAX_ROUNDS = 60


@kernel
def solve_riccati(A: FloatArray, B: FloatArray, Q: FloatArray, R: FloatArray) -> FloatArray:
    """The stabilising P `(n, n)` of (1), for A `(n, n)`, B `(n, m)`, Q `(n, n)` >= 0, R `(m, m)` > 0.

    All NaN where the rounds do not converge: (A, B) cannot be stabilised, or Q does not see an unstable mode.
    """
    eye = np.eye(len(A))
    G = B @ np.linalg.solve(R, np.ascontiguousarray(B.T))
    H = Q.copy()
    for _ in range(MAX_ROUNDS):
        W = np.linalg.solve(eye + G @ H, eye)
        WA = W @ A
        more = np.ascontiguousarray(A.T) @ (H @ WA)
        G = G + A @ (W @ G) @ np.ascontiguousarray(A.T)
        A = A @ WA
        H = H + more
        H = 0.5 * (H + H.T)
        G = 0.5 * (G + G.T)
        if not np.isfinite(H).all():
            break
        if np.abs(more).max() <= 1e-13 * np.abs(H).max():
            return H
    return np.full_like(H, np.nan)
