"""The contracts of planners, metrics and readers, as checks for their authors:
`replan.check_planner` and the like.

Each check returns None, or raises one `ContractError` that names every broken rule, where it was
broken first, and the remedy. The rules are those of `replan.planners.base`, `replan.metrics.metric`
and `replan.logs.readers.base`; a rule that can only be examined where another holds (equal plans
without memory: deterministic) is examined only there.

A check runs the code in this process, without the limits in time and memory that a run has.
"""

from replan.contract.breaches import ContractError
from replan.contract.metric_rules import METRIC_RULES, check_metric
from replan.contract.planner_rules import PLANNER_RULES, check_planner
from replan.contract.reader_rules import READER_RULES, check_reader

__all__ = [
    "METRIC_RULES",
    "PLANNER_RULES",
    "READER_RULES",
    "ContractError",
    "check_metric",
    "check_planner",
    "check_reader",
]
