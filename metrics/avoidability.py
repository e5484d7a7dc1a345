"""Would a careful driver have got through? The verdicts of `reference_drivers`, as the scenario's metadata carry them.

Replay writes them there, since it knows the line; a metric is given the trace and the scenario only. Two rows per
driver count the three outcomes: `reference_cc.applies` is 1 where the ego would meet somebody if nobody braked, else 0;
where it applies, `reference_cc.avoids` is 1 or 0, else it is unavailable and says why.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from logs.scenario import Scenario
from logs.trace import Mode, Trace
from metrics.metric import Measured, Metric, Reduction, Series, Unavailable
from metrics.reference_drivers import Outcome, Verdict

ABSENT = "the log carries no verdict of a reference driver"
_VALUE = {Outcome.AVOIDABLE: 1.0, Outcome.UNAVOIDABLE: 0.0, Outcome.NOT_APPLICABLE: np.nan}

AVOIDS = Reduction("avoids", lambda series: (float(series.value[0]), -1), direction="none")
APPLIES = Reduction("applies", lambda series: (1.0, -1), direction="none", empty=0.0)


def metadata_of(verdict: Verdict) -> dict[str, str]:
    """The metadata entries of a verdict."""
    key = f"reference_{verdict.driver}"
    return {key: verdict.outcome.value, f"{key}.reason": verdict.reason}


def _reference(trace: Trace, scenario: Scenario, *, driver: str) -> Measured:
    told = scenario.metadata.get(f"reference_{driver}")
    if told not in {outcome.value for outcome in Outcome}:
        return Unavailable(ABSENT)
    reason = scenario.metadata.get(f"reference_{driver}.reason", "")
    value = np.array([_VALUE[Outcome(told)]])
    return Series(trace.ego.t[:1], value, (reason,), f"not applicable: {reason}")


def _metric(driver: str, meaning: str, source: str) -> Metric:
    measure = partial(_reference, driver=driver)
    return Metric(
        f"reference_{driver}", "1", "none", (Mode.CLOSED,), measure, (AVOIDS, APPLIES), meaning, source,
        formula="the reference driver, braking on the ego's line among the tracks as logged",
        needs="the verdict in the log's metadata; avoids: somebody to meet",
    )  # fmt: skip


CC = _metric(
    "cc", "1 if the competent and careful driver stays clear where one who does not brake would meet somebody.",
    "UN R157, Annex 4, Appendix 3",
)  # fmt: skip
FSM = _metric(
    "fsm", "1 if the driver of the fuzzy safety model stays clear where one who does not brake would meet somebody.",
    "Mattas et al., Accid. Anal. Prev. 148 (2020) 105794",
)  # fmt: skip
