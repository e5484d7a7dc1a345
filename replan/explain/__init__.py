"""Why a plan slows down or stands, derived from public data; docs/why.md explains each sentence."""

from replan.explain.causes import Account, Cause, CauseKind, accounts
from replan.explain.course import Course, PlanAction
from replan.explain.explanation import Explanation
from replan.explain.sentences import sentences

__all__ = [
    "Account",
    "Cause",
    "CauseKind",
    "Course",
    "Explanation",
    "PlanAction",
    "accounts",
    "sentences",
]
