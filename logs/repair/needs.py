"""Whether a log's road users are tracks already."""

from __future__ import annotations

from logs.detections import Detections


def needs_repair(detections: Detections) -> str | None:
    """Why these detections must be repaired, in a sentence; None where they are tracks already."""
    return None
