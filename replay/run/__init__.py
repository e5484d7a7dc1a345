"""Many logs: select (`sources`), evaluate in workers (`pool`, `one_log`), judge, write the tables (`run`, `tables`).

A run that was interrupted goes on where it was (`resume`); what it takes from disk is in `log_result`. A run may be
driven in parts on several machines (`shard`), which are put together again (`merge`).

from replay.run import evaluate_logs
from replay.config import RunConfig

results = evaluate_logs(["my_logs/"], RunConfig(planners=("dp_qp", "logged")), "results/mine")
results.metrics       # pandas: one row per log, planner, mode and metric
results.gates         # a row per gate: pass, fail or inconclusive, with the reason
"""

from replay.results.version import replan_version
from replay.run.evaluate import evaluate_logs

__all__ = ["evaluate_logs", "replan_version"]
