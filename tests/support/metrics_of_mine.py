"""A metric as a user would write it."""

from replan import MEAN, Scenario, Series, Trace, metric


@metric(unit="m/s", better="none", reductions=(MEAN,))
def mine(trace: Trace, scenario: Scenario) -> Series:
    """For a test."""
    return Series(trace.ego.t, trace.ego.v)
