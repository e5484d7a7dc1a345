"""Many logs: select (`sources`), evaluate in workers (`evaluate`, `pool`, `one_log`), judge and
write (`judging`).

`resume` continues an interrupted run; `replan.results.log_result` reads its finished logs from
disk. Several machines may each drive a part of a run; `shards` merges the parts. The result folder
is locked while it is written, and may be at a URL (`output`).

from replan.run import evaluate_logs
from replan.config import RunConfig

results = evaluate_logs(["my_logs/"], RunConfig(planners=("dp_qp", "logged")), "results/mine")
results.metrics       # pandas: one row per log, planner, mode and metric
results.gates         # a row per gate: pass, fail or inconclusive, with the reason
"""

from replan.results.version import replan_version
from replan.run.evaluate import evaluate_logs

__all__ = ["evaluate_logs", "replan_version"]
