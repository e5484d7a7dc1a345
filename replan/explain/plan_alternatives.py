"""The alternatives of a plan in words: score, what each does, and what replan finds in it.

(1) ahead, left = the place of an alternative `AHEAD_S` after the frame, along and across the
        heading of the plan there; of one that ends before, at its end
"""

from __future__ import annotations

from math import cos, hypot, isfinite, sin

import numpy as np

from replan.core.arrays import IntArray
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.trace import PlannedFrame, Trace
from replan.metrics.alternatives import Rows, chosen_place, judged_alternatives
from replan.metrics.metric import Unavailable
from replan.metrics.off_road import OFF_ROAD_M

AHEAD_S = 3.0
SAME_M = 0.1  # A smaller distance from the plan is not named


def describe_alternatives(
    trace: Trace, scenario: Scenario, frame: PlannedFrame
) -> list[tuple[str, str]]:
    """Return each alternative of a frame's plan as name and statement, the highest score first."""
    rows = judged_alternatives(trace, scenario)
    if isinstance(rows, Unavailable):
        return []
    index = next(i for i, other in enumerate(trace.frames) if other.t == frame.t)
    places: IntArray = np.flatnonzero(rows["frame"] == index)
    if not len(places):
        return []
    chosen, best = chosen_place(rows, places), places[np.argmax(rows["worth"][places])]
    scores = np.nan_to_num(rows["score"][places], nan=-np.inf)
    lines = []
    for k in np.argsort(-scores, kind="stable").tolist():
        alternative, place = frame.plan.alternatives[k], places[k]
        score = f"score {alternative.score:.3g}" if isfinite(alternative.score) else "no score"
        described = [
            score + " (chosen)" * bool(place == chosen),
            _difference(alternative.trajectory, frame.plan.trajectory),
            f"replan's score {rows['worth'][place]:.2f}" + " (the best)" * bool(place == best),
            *_findings(rows, int(place)),
        ]
        lines.append((alternative.name or f"alternative {k + 1}", f": {'; '.join(described)}"))
    return lines


def _difference(path: Trajectory, plan: Trajectory) -> str:
    """Say how an alternative differs from the plan, (1)."""
    t = min(plan.t[0] + AHEAD_S, plan.t[-1], path.t[-1])
    state, planned = path.at(float(t)), plan.at(float(t))
    dx, dy = state.x - planned.x, state.y - planned.y
    ahead = dx * cos(planned.yaw) + dy * sin(planned.yaw)
    left = dy * cos(planned.yaw) - dx * sin(planned.yaw)
    speed = f"{state.v:.1f} m/s after {t - plan.t[0]:.1f} s"
    if hypot(ahead, left) < SAME_M:
        return f"{speed}, where the plan is"
    differences = []
    if abs(ahead) >= SAME_M:
        differences.append(f"{abs(ahead):.1f} m {'ahead of' if ahead > 0.0 else 'behind'}")
    if abs(left) >= SAME_M:
        differences.append(f"{abs(left):.1f} m to the {'left' if left > 0.0 else 'right'} of")
    return f"{speed}, {' and '.join(differences)} the plan"


def _findings(rows: Rows, place: int) -> list[str]:
    """Say what replan finds in an alternative: a contact, the way off the road."""
    findings = []
    if isfinite(rows["contact"][place]):
        findings.append(f"contact at fault after {rows['contact'][place]:.1f} s")
    if rows["off"][place] > OFF_ROAD_M:
        findings.append(f"{rows['off'][place]:.1f} m off the road")
    return findings
