"""Rotations as quaternions q = (x, y, z, w) of unit length, rows of `(n, 4)`.

(1) heading of the rotated x axis = atan2(2 (w z + x y), 1 - 2 (y^2 + z^2))
(2) rotated vector = q p q* = p + 2 w u x p + 2 u x (u x p),   u = (x, y, z)
(3) product q r: first r, then q
"""

from __future__ import annotations

import numpy as np

from logs.kernel import BoolArray, FloatArray

ROUNDED = 0.01
"""The length of a stored quaternion may differ from 1 by this."""


def is_unit(q: FloatArray) -> BoolArray:
    """Which quaternions `(n, 4)` have unit length, but for rounding."""
    return np.asarray(np.abs(np.sqrt((q * q).sum(axis=1)) - 1.0) < ROUNDED)


def unit_of_wxyz(q: FloatArray) -> FloatArray:
    """Unit quaternions (x, y, z, w) of stored ones (w, x, y, z), `(n, 4)`.

    Raises:
        ValueError: The length of one differs from 1 by more than rounding.
    """
    if not is_unit(q).all():
        raise ValueError("an orientation is not a quaternion of unit length")
    return np.roll(q / np.sqrt((q * q).sum(axis=1, keepdims=True)), -1, axis=1)


def unit_or_identity(q: FloatArray) -> FloatArray:
    """Quaternions `(n, 4)` of length 1; those of length 0, which senders leave empty, become the identity."""
    size = np.linalg.norm(q, axis=1, keepdims=True)
    return np.where(size > 1e-9, q / np.where(size > 1e-9, size, 1.0), np.array([0.0, 0.0, 0.0, 1.0]))


def heading(q: FloatArray) -> FloatArray:
    """Direction (1) of the rotated x axis seen from above `(n,)`, rad."""
    x, y, z, w = q.T
    return np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def rotated(q: FloatArray, p: FloatArray) -> FloatArray:
    """Vectors p `(n, 3)` rotated (2) by q."""
    u, w = q[:, :3], q[:, 3:]
    twice = 2.0 * np.cross(u, p)
    return np.asarray(p + w * twice + np.cross(u, twice))


def product(q: FloatArray, r: FloatArray) -> FloatArray:
    """Products (3)."""
    ax, ay, az, aw = q.T
    bx, by, bz, bw = r.T
    columns = (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )
    return np.column_stack(columns)
