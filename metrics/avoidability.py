"""Would a careful driver have got through? The verdicts of `reference_drivers`, as the scenario's metadata carry them.

Replay writes them there (`replay.loop.avoidability`), since it knows the line; the same keys of a log are dropped when
it is read. Three rows per driver: `reference_cc.applies` is 1 where an ego that did not brake would meet an agent, else
0; where it applies, `reference_cc.avoids` is 1 or 0, and `reference_cc.margin` says by how many metres (negative: by
how many not). The entries, of "cc" as of "fsm":

    reference_cc            "avoidable", "unavoidable" or "not applicable"
    reference_cc.reason     a sentence, with the margin and whether it is marginal
    reference_cc.agent      id of the agent that the driver touches, else of the one that it avoids; where it applies
    reference_cc.margin     m, as a number
    reference_cc.marginal   "yes" or "no"
"""

from __future__ import annotations

from functools import partial

import numpy as np

from logs.scenario import FINDING, Scenario
from logs.trace import Mode, Trace
from metrics.metric import Measured, Metric, Reduction, Series, Unavailable
from metrics.reference_drivers import Outcome, Verdict

AVOIDS = Reduction("avoids", lambda series: (float(series.value[0] > 0.0), -1), "1", "none")
APPLIES = Reduction("applies", lambda series: (1.0, -1), "1", "none", empty=0.0)
MARGIN = Reduction("margin", lambda series: (float(series.value[0]), -1), "m", "higher")


def metadata_of(verdict: Verdict) -> dict[str, str]:
    """The metadata entries of a verdict."""
    key = f"{FINDING}{verdict.driver}"
    entries = {key: verdict.outcome.value, f"{key}.reason": verdict.reason}
    if verdict.agent:
        entries[f"{key}.agent"] = verdict.agent
    return {**entries, f"{key}.margin": repr(verdict.margin), f"{key}.marginal": "yes" if verdict.marginal else "no"}


def _reference(trace: Trace, scenario: Scenario, *, driver: str) -> Measured:
    key = f"{FINDING}{driver}"
    found = scenario.metadata.get(key)
    if found not in {outcome.value for outcome in Outcome}:
        return Unavailable("the reference drivers were not asked")
    reason = scenario.metadata[f"{key}.reason"]
    applies = Outcome(found) is not Outcome.NOT_APPLICABLE
    value = np.array([float(scenario.metadata[f"{key}.margin"]) if applies else np.nan])
    return Series(trace.ego.t[:1], value, (reason,), f"not applicable: {reason}")


CC, FSM = (
    Metric(
        f"reference_{driver}", "m", "higher", (Mode.CLOSED,), partial(_reference, driver=driver),
        (AVOIDS, APPLIES, MARGIN), meaning, source, 2,
        formula="the reference driver, braking on the ego's line among the tracks as logged",
        needs="avoids and margin: an agent that the ego would meet at constant speed",
    )
    for driver, source, meaning in (
        ("cc", "UN R157, Annex 4, Appendix 3",
         "Least distance that the competent and careful driver leaves to the agent that one who does not brake would "
         "touch, negative where it touches it; it evaluates a cut-in from 0.375 m on, JRC's code from the ego's width "
         "on."),
        ("fsm", "Mattas et al., Accid. Anal. Prev. 148 (2020) 105794",
         "Least distance that the driver of the fuzzy safety model leaves to the agent that one who does not brake "
         "would touch, negative where it touches it."),
    )
)  # fmt: skip
