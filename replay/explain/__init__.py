"""Why a plan slows down or stands, from what is known to all; docs/why.md says what each sentence means."""

from replay.explain.causes import Account, Cause, CauseKind, accounts
from replay.explain.course import Action, Course
from replay.explain.sentences import sentences

__all__ = ["Account", "Action", "Cause", "CauseKind", "Course", "accounts", "sentences"]
