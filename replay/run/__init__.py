"""Many logs: select (`sources`), evaluate in workers (`pool`, `one_log`), judge, write the tables (`run`, `tables`).

A run that was interrupted goes on where it was (`resume`); what it takes from disk is in `log_result`. A run may be
driven in parts on several machines (`shard`), which are put together again (`merge`).

from replay.run import evaluate_logs
from replay.config import RunConfig

result = evaluate_logs(["my_logs/"], RunConfig(planners=("dp_qp", "logged")), "results/mine")
result.table          # pandas: one row per log, planner, mode and metric
result.verdicts       # gates: PASS, FAIL or INCONCLUSIVE, with reasons
"""

from replay.results.version import replan_version
from replay.run.evaluate import RunResult, evaluate_logs

__all__ = ["RunResult", "evaluate_logs", "replan_version"]
