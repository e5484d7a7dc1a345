"""A systematic sample of logs that a search does not see.

Logs are put in the order of their stratum (the family, else the dataset, else none), then of the
SHA-256 of their name. The k-th log in this order, from 0, is held out if

(1) floor((k + 1) share) > floor(k share)

Every stratum gives about its share, and floor(n share) logs are held out in all. The sample does
not depend on time, seed or order of arguments. Adding a log may change which logs of its stratum
and of later strata are held out.
"""

from __future__ import annotations

from collections.abc import Mapping
from hashlib import sha256
from math import floor

from replan.metrics.judge.aggregate import LogLabels

SLACK = 1e-9
"""Tolerance so that rounding does not change floor(): 0.3 of ten logs are three."""


def held_out(labels: Mapping[str, LogLabels], share: float) -> frozenset[str]:
    """The names of the logs that are held out (1), from the labels of each by name."""
    order = sorted(labels, key=lambda name: (stratum(labels[name]), sha256(name.encode()).digest()))
    return frozenset(
        name
        for k, name in enumerate(order)
        if floor((k + 1) * share + SLACK) > floor(k * share + SLACK)
    )


def stratum(labels: LogLabels) -> str:
    """The stratum of a log: its family, else its dataset."""
    return labels.family or labels.dataset
