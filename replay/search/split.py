"""Logs into two sets: those that settings are searched on, and those that are held out.

Logs are put in the order of their stratum (the family, else the dataset, else none), then of the SHA-256 of their name.
Of this order the k-th, from 0, is held out where

(1) floor((k + 1) share) > floor(k share)

a systematic sample: every stratum gives about its share, and floor(n share) logs are held out in all. No clock, seed or
order of arguments has a say; a log that is added may move others of its stratum and those after it.
"""

from __future__ import annotations

from collections.abc import Mapping
from hashlib import sha256
from math import floor

from metrics.judge.aggregate import LogLabels

SLACK = 1e-9
"""0.3 of ten logs are three, rounding or not."""


def held_out(labels: Mapping[str, LogLabels], share: float) -> frozenset[str]:
    """The names of the logs that are held out (1).

    Args:
        labels: What each log belongs to, by name.
        share: Of the logs, 0 to 1.
    """
    order = sorted(labels, key=lambda name: (stratum(labels[name]), sha256(name.encode()).digest()))
    return frozenset(name for k, name in enumerate(order) if floor((k + 1) * share + SLACK) > floor(k * share + SLACK))


def stratum(labels: LogLabels) -> str:
    """What a log is drawn from."""
    return labels.family or labels.dataset
