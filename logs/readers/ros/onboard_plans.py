"""Reads the on-board plans of a bag, each known from the time of its message on, with the
alternatives that were known then.
"""

from __future__ import annotations

from bisect import bisect_right

import numpy as np

from replan.core.arrays import FloatArray
from replan.logs.readers.ros import schemas
from replan.logs.readers.ros.ego import EgoLog
from replan.logs.readers.ros.frames import describe_timing, times_of
from replan.logs.readers.ros.onboard_alternatives import KnownAlternatives, read_alternatives
from replan.logs.readers.ros.part import BagPart
from replan.logs.readers.ros.trajectories import PLAN_POINT, trajectory_of
from replan.logs.states import OnboardPlan, Trajectory

OLDEST_NS = 500_000_000
"""Older alternatives are not those of a plan, ns: selectors run at 10 Hz."""
USUAL_TOPICS = ("/scenario_planning/trajectory", "/planning/trajectory")
"""Ends of the names of Autoware's topics of the final plan: they go before others."""


def read_onboard_plans(
    part: BagPart, ego: EgoLog, t0: int, origin: FloatArray
) -> tuple[OnboardPlan, ...]:
    """Read the on-board plans, each known from the time of its message on.

    In a bag that holds no final plans, the best of the scored alternatives are the plans, as
    Autoware's adapter takes them.
    """
    alternatives = read_alternatives(part, ego, t0, origin)
    plans = _final_plans(part, ego, t0, origin)
    if plans is None:
        plans = {message.known_ns: best for message in alternatives if (best := _best(message))}
        if plans:
            part.notes.append("The on-board plans are the alternatives with the highest scores.")
    known = [message.known_ns for message in alternatives]
    onboard = []
    for known_ns, trajectory in sorted(plans.items()):
        newest = bisect_right(known, known_ns) - 1
        is_new = newest >= 0 and known_ns - known[newest] <= OLDEST_NS
        among = alternatives[newest].alternatives if is_new else ()
        onboard.append(OnboardPlan((known_ns - t0) / 1e9, trajectory, among))
    return tuple(onboard)


def _best(message: KnownAlternatives) -> Trajectory | None:
    scored = [other for other in message.alternatives if np.isfinite(other.score)]
    return max(scored, key=lambda other: other.score).trajectory if scored else None


def _final_plans(
    part: BagPart, ego: EgoLog, t0: int, origin: FloatArray
) -> dict[int, Trajectory] | None:
    """Read the plans that were driven, by the time from which they were known, ns; None: the bag
    has no topic of them.
    """
    topics, notes = part.topics(schemas.PLANS, "plan"), part.notes
    if not topics:
        return None
    usual = [topic for topic in topics if topic.name.endswith(USUAL_TOPICS)]
    topic = usual[0] if usual and "plan" not in part.settings.topics else topics[0]
    log, stamps, rows = part.read(topic, ("header.frame_id", ("points", PLAN_POINT)))
    t, keep = times_of(topic.name, log, stamps, ego.clock, notes)
    known = np.maximum(ego.clock(log[keep]), t) if len(keep) else t
    plans: dict[int, Trajectory] = {}
    for time, known_ns, k in zip(t.tolist(), known.tolist(), keep.tolist(), strict=True):
        frame, points = rows[k]
        planned = trajectory_of(frame, points, time, t0, ego, origin)
        if planned is not None:
            plans[known_ns] = planned
    notes += describe_timing(topic.name, log, stamps, int(log[0])) if len(log) else []
    if rows:
        several = f" (of {len(topics)} such topics)" if len(topics) > 1 else ""
        _, points = rows[0]
        has_times = any(sec or nanosec for sec, nanosec, *_ in points)
        timed = "by their own times" if has_times else "by their speeds"
        notes.append(
            f"{len(plans)} on-board plans are those of {topic.name}{several}, timed {timed}."
        )
    return plans
