"""A metric as a user would write it."""

from replan.logs.trace import Mode
from replan.metrics import Metric, Series
from replan.metrics.reductions import MEAN

MINE = Metric(
    "mine",
    "m",
    "none",
    (Mode.CLOSED,),
    lambda trace, scenario: Series(trace.ego.t, trace.ego.v),
    (MEAN,),
    "For a test.",
)
