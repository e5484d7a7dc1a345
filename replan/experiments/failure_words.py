"""The words of a failing drive: a row for each fault, a template for each broken gate."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType

ROAD_USER = "a road user"
_MOVES = (
    "predicted to move {0.predicted_m:.1f} m in {0.ahead_s:.1f} s, moves {0.moved_m:.1f} m, "
    "{0.off_m:.1f} m from there"
)


class DriveFault(Enum):
    """A fault of a drive, of its perception or of its prediction.

    Each has the words of the sentence, and the numbers beside it; {0} is the fact that has the
    fault (`replan.experiments.failure`).
    """

    def __init__(self, words: str, numbers: str) -> None:
        self._words, self._numbers = words, numbers

    NONE = ("", "")

    # `DriveDifference`
    DOES_NOT_BRAKE = (
        "does not brake",
        "does not brake, instead of braking at {0.would_brake_s:.1f} s",
    )
    BRAKES_LATE = (
        "brakes late",
        "brakes at {0.brakes_s:.1f} s instead of {0.would_brake_s:.1f} s",
    )
    BRAKES_WEAKLY = (
        "brakes too weakly",
        "brakes with {0.braking_mps2:.1f} m/s² instead of {0.would_braking_mps2:.1f} m/s²",
    )
    KEEPS_LEFT = (
        "keeps too far left",
        "drives {0.aside_m:.1f} m to the left of where it passes",
    )
    KEEPS_RIGHT = (
        "keeps too far right",
        "drives {0.aside_m:.1f} m to the right of where it passes",
    )

    # `GoalMiss`
    MISSES_CONDITION = (
        "misses the {0.conditions} of its goal",
        "is at its goal's place at {0.at_s:.1f} s, not by {0.conditions}",
    )
    IS_SLOW = ("is too slow", "is {0.ahead_m:.1f} m before its goal at {0.at_s:.1f} s")
    PASSES_LEFT = (
        "keeps too far left",
        "has its goal {0.aside_m:.1f} m to its right at {0.at_s:.1f} s",
    )
    PASSES_RIGHT = (
        "keeps too far right",
        "has its goal {0.aside_m:.1f} m to its left at {0.at_s:.1f} s",
    )

    # `Foresight`
    NOT_SEEN = (" not seen", "not seen at {0.at_s:.1f} s")
    SEEN_ELSEWHERE = (
        " seen elsewhere",
        "seen {0.seen_off_m:.1f} m from where they are at {0.at_s:.1f} s",
    )
    PREDICTED_TO_STAND = (" predicted to stand", _MOVES)
    PREDICTED_TO_MOVE = (" predicted to move although they stand", _MOVES)
    PREDICTED_ELSEWHERE = (" predicted elsewhere", _MOVES)

    def words(self, fact: object) -> str:
        """The words of a fact's fault."""
        return self._words.format(fact)

    def numbers(self, fact: object) -> str:
        """The numbers of a fact's fault."""
        return self._numbers.format(fact)


BRAKING = (DriveFault.DOES_NOT_BRAKE, DriveFault.BRAKES_LATE, DriveFault.BRAKES_WEAKLY)
"""Faults of braking, which may be meant for a road user."""
OUTCOMES: Mapping[str, str] = MappingProxyType(
    {
        "collision_at_fault": "collides with {}",
        "collision": "collides with {}",
        "gap_kept": "comes too near to {}",
        "gap_kept_vulnerable": "comes too near to {}",
        "passing_room": "passes {} too closely",
        "ttc": "comes close to a collision with {}",
        "ttc_vulnerable": "comes close to a collision with {}",
        "thw": "follows {} too closely",
        "forced_braking": "forces {} to brake",
        "braked_behind": "brakes for nothing before {}",
        "priority_gap": "leaves too little time to {}",
        "yielding": "crosses too shortly before {}",
        "crosswalk": "does not let {} go first at a crosswalk",
        "completed": "does not drive to the end",
        "goal": "does not reach the goal",
        "route_progress": "makes too little progress",
        "off_road": "leaves the road",
        "wrong_way": "drives against the direction of a lane",
        "lane_line": "straddles the line of its lane",
        "speed_excess": "exceeds the speed limit",
        "assumed_limit_excess": "exceeds the assumed speed limit",
        "red_light": "runs a red light",
        "yellow_light": "runs a yellow light at which it could have stopped",
        "stop_sign": "does not stop at a stop sign",
        "needless_braking": "brakes where nothing ahead calls for it",
        "needless_standing": "stands although the road is free",
        "needless_steering": "weaves where nothing calls for it",
        "needless_lane_change": "changes lanes where nothing calls for it",
        "lane_offset": "keeps beside the middle of its lane",
        "speed_swing": "swings its speed where nothing calls for it",
        "lon_accel": "accelerates or brakes too hard",
        "lat_accel": "takes a curve too fast",
        "curve_accel": "takes a curve too fast",
        "lon_jerk_nuplan": "accelerates or brakes too abruptly",
        "lat_jerk_r79": "steers too abruptly",
        "pedals_together": "uses both pedals at once",
        "tracking_lateral": "leaves its planned path",
        "tracking_speed": "does not keep its planned speed",
        "fallback": "lives on fallback plans",
        "plan_refused": "makes plans that cannot be driven",
        "plan_corrected": "makes plans that contradict themselves",
        "plan_complete": "makes plans that are too short",
        "plan_collision": "plans to collide with {}",
        "plan_off_road": "plans to leave the road",
        "plan_change": "changes its plans too much",
        "plan_change_lateral": "changes its plans too much to the side",
        "plan_kept": "does not do what it planned",
        "plan_kept_lateral": "does not drive where it planned",
        "plan_score": "makes plans of a low score",
    }
)
"""The meaning of a broken gate, by the first part of its metric; {} is the road user."""
