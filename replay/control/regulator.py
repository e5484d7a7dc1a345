"""The linear-quadratic regulator of both lateral DLQRs, and tables of gains over speed.

(1) J = sum of x' Q x + u' R u,       R = steer_weight (1 + (v / v_0)^2)^2
(2) P = Q + A' P (I + G P)^-1 A,      G = B R^-1 B'
(3) K = (R + B' P B)^-1 B' P A,       u = -K x
(4) A <- A (I + G H)^-1 A
    G <- G + A (I + G H)^-1 G A'
    H <- H + A' H (I + G H)^-1 A      from H = Q; H -> P, its error squared in each round

R grows with the lateral acceleration that a steering angle makes: below v_0 the error decays over a distance, above it
over a time. K is tabulated over speed and interpolated; below the table's first speed, where one can hardly steer, its
first row holds.

(4) is structured doubling: Chu, Fan, Lin, Wang, Structure-preserving algorithms for periodic discrete-time algebraic
Riccati equations, Int. J. Control 77 (2004), section 3. It is a kernel of small matrices, since the library solvers
take a hundred times longer where the threads of their linear algebra find the cores busy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from logs.errors import ConfigError
from logs.kernel import FloatArray, kernel

MAX_ROUNDS = 60
SPEED_STEP_MPS = 0.5
MAX_SPEED_MPS = 60.0
SHORTEST_LAG_S = 1e-3


@dataclass(frozen=True, eq=False)
class Regulator:
    """A solved (1)-(3) at one speed: A `(n, n)`, B `(n, 1)`, Q, R, P, and the gain K `(1, n)`."""

    A: FloatArray
    B: FloatArray
    Q: FloatArray
    R: FloatArray
    P: FloatArray
    K: FloatArray


def solve_regulator(
    A: FloatArray, B: FloatArray, weights: tuple[float, ...], steer_weight: float, v: float, speed_mps: float
) -> Regulator:
    """The regulator (1)-(3) of x[k+1] = A x[k] + B u[k] at one speed.

    Args:
        A: `(n, n)`.
        B: `(n, 1)`.
        weights: The diagonal of Q, n.
        steer_weight: Of (1).
        v: m/s.
        speed_mps: v_0 of (1).

    Raises:
        ConfigError: The weights, or a speed of 0, allow no stable gain.
    """
    Q, R = np.diag(weights), np.array([[steer_weight * (1.0 + (v / speed_mps) ** 2) ** 2]])  # (1)
    P = solve_riccati(np.ascontiguousarray(A), np.ascontiguousarray(B), Q, R)  # (2)
    if not np.isfinite(P).all():
        raise ConfigError(
            f"DLQR: no stable gain at {v} m/s with the weights {weights} and steer_weight {steer_weight:g}"
        )
    return Regulator(A, B, Q, R, P, np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A))  # (3)


@kernel
def solve_riccati(A: FloatArray, B: FloatArray, Q: FloatArray, R: FloatArray) -> FloatArray:
    """The stabilising P `(n, n)` of (2), for A `(n, n)`, B `(n, m)`, Q `(n, n)` >= 0, R `(m, m)` > 0.

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


def table_speeds() -> FloatArray:
    """The speeds of all tables, m/s: SPEED_STEP_MPS, 2 SPEED_STEP_MPS, ... MAX_SPEED_MPS."""
    return SPEED_STEP_MPS * np.arange(1, round(MAX_SPEED_MPS / SPEED_STEP_MPS) + 1)


@kernel
def at_speed(table: FloatArray, v: float) -> tuple[int, float]:
    """Row of a table over `table_speeds` and share of the next row; the ends hold."""
    place = min(max(v / SPEED_STEP_MPS - 1.0, 0.0), len(table) - 1.0)
    i = min(int(place), len(table) - 2)
    return i, place - i


@kernel
def gain(gains: FloatArray, v: float, column: int) -> float:
    """An entry of K at a speed, m/s, linear between the table's rows; the ends hold."""
    i, u = at_speed(gains, v)
    return gains[i, column] + u * (gains[i + 1, column] - gains[i, column])
