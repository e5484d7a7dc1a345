"""A metric as a user would write it."""

from logs import Mode
from metrics import Metric, Series
from metrics.metric import MEAN

MINE = Metric(
    "mine",
    "m",
    "none",
    (Mode.CLOSED,),
    lambda trace, scenario: Series(trace.ego.t, trace.ego.v),
    (MEAN,),
    "For a test.",
)
