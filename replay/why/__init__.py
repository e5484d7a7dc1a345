"""Why a plan slows down or stands, from what is known to all; docs/why.md says what each sentence means."""

from replay.why.causes import Account, Cause, CauseKind, accounts
from replay.why.course import Action, Course
from replay.why.sentences import sentences

__all__ = ["Account", "Action", "Cause", "CauseKind", "Course", "accounts", "sentences"]
