"""Why a plan slows down or stands, derived from public data; docs/why.md explains each sentence."""

from replay.explain.causes import Account, Cause, CauseKind, accounts
from replay.explain.course import Action, Course
from replay.explain.explanation import Explanation
from replay.explain.sentences import sentences

__all__ = ["Account", "Action", "Cause", "CauseKind", "Course", "Explanation", "accounts", "sentences"]
