"""How fast the ego swings out round a road user that it could follow instead.

(1) v <= sqrt(`SWERVE_MPS2` / |kappa - kappa_r|)      where the path swerves from the reference line
"""

from __future__ import annotations

import numpy as np

from planners.dp_qp.scene.caps import PathView, SpeedCap

SWERVE_MPS2 = 1.6
"""Lateral acceleration of such a swerve, m/s2."""


def caps(view: PathView) -> tuple[SpeedCap, ...]:
    """(1) at each point of a path that passes an agent that moves, where it is below the road's limit."""
    if not view.is_pass:
        return ()
    path, line = view.path, view.scene.reference.line
    swerved = np.abs(path.kappa - np.interp(path.s, line.s, line.kappa))
    v = np.sqrt(SWERVE_MPS2 / np.maximum(swerved, 1e-6))  # (1)
    before = np.r_[-np.inf, path.sigma[:-1]]
    return tuple(
        SpeedCap(float(before[i]), float(path.sigma[i]), float(v[i]), is_bound=False)
        for i in np.flatnonzero(v < view.limit)
    )
