"""From the changes with which a failing drive passes to its cause.

(1) a change counts     the drive passes with it, and with no part of it that points to another cause
(2) cause               what the changes that count point to, those of the first rank of `RANKS` in which one counts;
                        "prediction or control" where they point to several
(3) fragile             it passes with a perturbation that should change nothing (`replay.run.perturb`): then no change
                        shows anything, and the cause is not found
(4) unavoidable         it passes with no change, and the careful driver of UN R157 does not avoid the contact either
(5) not found           it passes with no change, and (4) does not hold
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from replay.diagnose.changes import RANKS, ChangedRun

NOT_FOUND, UNAVOIDABLE = "not found", "unavoidable"


@dataclass(frozen=True)
class Cause:
    """Why a drive fails.

    Attributes:
        name: "prediction", "prediction or control", "unavoidable", "not found".
        changes: Names of the changes that point to it.
        fragile: Perturbations with which the drive passes.
    """

    name: str
    changes: tuple[str, ...] = ()
    fragile: tuple[str, ...] = ()


def cause_of(
    runs: Sequence[ChangedRun], passing: Collection[str], fragile: Sequence[str] = (), *, avoidable: bool = True
) -> Cause:
    """The cause of a drive.

    Args:
        runs: The changes that were driven.
        passing: Names of those with which it passes.
        fragile: Perturbations with which it passes.
        avoidable: Whether the careful driver avoids the contact, or there is none.
    """
    if fragile:
        return Cause(NOT_FOUND, fragile=tuple(fragile))  # (3)
    passed = [run for run in runs if run.change.name in passing]
    counts = [
        run.change
        for run in passed
        if not any(part.is_part_of(run) and part.change.cause != run.change.cause for part in passed)
    ]  # (1)
    for rank in RANKS:
        found = [change for change in counts if change.rank == rank]
        if found:
            causes = dict.fromkeys(change.cause for change in found)
            return Cause(" or ".join(causes), tuple(change.name for change in found))  # (2)
    return Cause(NOT_FOUND if avoidable else UNAVOIDABLE)  # (4), (5)
