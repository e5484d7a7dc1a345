"""Why a plan slows down or stands, derived from public data; docs/why.md explains each sentence."""

from replan.explain.causes import Account, Cause, CauseKind, accounts
from replan.explain.course import Action, Course
from replan.explain.explanation import Explanation
from replan.explain.sentences import sentences

__all__ = [
    "Account",
    "Action",
    "Cause",
    "CauseKind",
    "Course",
    "Explanation",
    "accounts",
    "sentences",
]
