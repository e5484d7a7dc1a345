"""Judging: gates (`gates`), their verdicts (`verdicts`), and what excuses a broken bound (`excuses`).

`aggregate` takes logs together; `rows` adds to the table what verdicts say of it, and judges the time that plans took.
"""

from metrics.judge.excuses import CAREFUL, DRIVER, FOLLOWER, IMPACT, REFERENCE, REPLAY_CONTACT
from metrics.judge.gates import Gate, Gates, Outcome, load_gates
from metrics.judge.verdicts import Verdict, judge, outcomes, worst

__all__ = [
    "CAREFUL", "DRIVER", "FOLLOWER", "IMPACT", "REFERENCE", "REPLAY_CONTACT", "Gate", "Gates", "Outcome", "Verdict",
    "judge", "load_gates", "outcomes", "worst",
]  # fmt: skip
