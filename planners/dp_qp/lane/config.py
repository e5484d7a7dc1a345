"""Settings of the lane choice: what a lane's plan costs (`plan`), and when another one is taken (`choice`)."""

from __future__ import annotations

from dataclasses import astuple, dataclass


@dataclass(frozen=True)
class LaneConfig:
    """Settings of the lane choice; costs are seconds, what something is worth in time.

    Attributes:
        hysteresis_s: By how much another lane, or passing, must be cheaper than keeping the lane.
        look_s: Time lost to others from which the neighbours are looked at.
        dwell_s: No change back, and no passing anew, within this time, unless the lane fails.
        route_s: Cost of a lane change that the route needs.
        urgency_s: What is added to that as the change becomes due.
        due_s: A change is urgent where less than this is left to drive until it is due, per change.
        dead_end_s: Cost of a lane from which the goal cannot be reached.
        change_s: Cost of leaving the driven lane: a change pays only for a clear gain.
        hard_s: Cost where comfort cannot keep the distance.
        failed_s: Cost where nothing can, or a stage failed: more than all others together.
    """

    hysteresis_s: float = 0.5
    look_s: float = 1.0
    dwell_s: float = 3.0
    route_s: float = 1.6
    urgency_s: float = 6.0
    due_s: float = 15.0
    dead_end_s: float = 25.0
    change_s: float = 1.0
    hard_s: float = 3.0
    failed_s: float = 50.0

    def __post_init__(self) -> None:
        if not min(astuple(self)) >= 0.0:
            raise ValueError("settings of the lane choice must not be negative")
        if not self.due_s > 0.0:
            raise ValueError("due_s must be positive")
