"""Judging: gates (`gates`), their verdicts (`verdicts`), what a gate is judged by (`cases`),
excuses for broken bounds (`excuses`), and marginal outcomes (`marginality`).

`aggregate` summarises many logs. `verdicts` also adds rows about ensembles and gates to the table,
and judges late plans.
"""

from replan.metrics.judge.cases import CAREFUL, DRIVER, FOLLOWER, IMPACT, REFERENCE, REPLAY_CONTACT
from replan.metrics.judge.gates import Gate, Gates, Outcome, load_gates
from replan.metrics.judge.verdicts import Verdict, judge, outcomes, worst

__all__ = [
    "CAREFUL",
    "DRIVER",
    "FOLLOWER",
    "IMPACT",
    "REFERENCE",
    "REPLAY_CONTACT",
    "Gate",
    "Gates",
    "Outcome",
    "Verdict",
    "judge",
    "load_gates",
    "outcomes",
    "worst",
]
