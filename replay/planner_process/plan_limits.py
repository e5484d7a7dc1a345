"""How large a plan may be. Plans are kept for a whole drive, sent to the planner again, written and drawn."""

from __future__ import annotations

MOST_POINTS = 10_000
"""States of a trajectory: 100 s at 100 Hz. A longer plan is refused (`replay.loop.plan_check`)."""
LONGEST_REASON = 1000
"""Characters of a reason or an error message. A longer one is cut, and says so."""
LARGEST_INSIDE_BYTES = 8 << 20
"""What a planner in another process shows of one plan, with its timings, as MessagePack: `dp_qp` shows some 10 KiB."""


def shortened(text: str) -> str:
    """The text, or its beginning and how long it was: at most `LONGEST_REASON` characters."""
    if len(text) <= LONGEST_REASON:
        return text
    mark = f" ... (cut, {len(text)} characters)"
    return text[: LONGEST_REASON - len(mark)] + mark
