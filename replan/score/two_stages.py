"""NAVSIM v2's two stages: a plan counts as much as what follows from where it ends
(pseudo-simulation).

A window of stage one has follow-up scenes, each the window of a log that begins where a drive may
be 4 s later. With d from the plan's last pose to the begin of scene k, in the map's plane,

(1) w_k = exp(-d_k^2 / (2 `SIGMA2_M2`)), divided by their sum; where that is 0, all are equal
(2) combined = mean over the windows of stage one of (score x sum_k w_k score_k)

The windows of both stages come in pairs 0.5 s apart; both of a pair have the same EC. Source:
navsim 0a380a90, scene_aggregator.py and run_pdm_score.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from replan.core.arrays import FloatArray
from replan.core.errors import ConfigError
from replan.logs.scenario import Scenario
from replan.score.submitted_plans import SubmittedPlan, ego_at

SIGMA2_M2 = 0.1
"""Variance of (1), m2."""
LEAST_SUM = 1e-8
"""A smaller sum of the weights of (1) is 0."""
STAGE = "stage"
"""The column of the stage, 1 or 2."""
FOLLOWS = "stage_one"
"""The column of the token of the window that a scene follows."""
WEIGHT = "weight"
"""The column of w_k."""
STAGE_ONE = "extended_pdm_score_stage_one"
"""The token of the summary's row of stage one."""
STAGE_TWO = "extended_pdm_score_stage_two"
"""The token of the summary's row of stage two."""
COMBINED = "extended_pdm_score_combined"
"""The token of the summary's row of (2)."""


def weights(end: FloatArray, begins: FloatArray) -> FloatArray:
    """Return the weights (1) `(n,)` of scenes: the plan ends at `end` `(2,)`, they begin at
    `begins` `(n, 2)`.
    """
    near = np.exp(-((begins - end) ** 2).sum(axis=1) / (2.0 * SIGMA2_M2))
    return near / near.sum() if near.sum() > LEAST_SUM else np.full(len(begins), 1.0 / len(begins))


def with_weights(
    rows: pd.DataFrame, plans: Sequence[SubmittedPlan], logs: Mapping[str, Scenario]
) -> pd.DataFrame:
    """Return the rows of plans with their stage, the token that they follow, and their weight.

    ConfigError if two plans of an agent have one token; a plan follows none of stage one.
    """
    rows = rows.copy()
    rows[FOLLOWS] = [plan.stage_one for plan in plans]
    rows[WEIGHT] = 1.0
    rows[STAGE] = np.where(rows[FOLLOWS] == "", 1, 2)
    twice = rows[rows.duplicated(["agent", "token"])]
    if len(twice):
        raise ConfigError(
            f"token {twice['token'].iloc[0]}: two windows have it; stage_one needs tokens that "
            "differ"
        )
    first = {
        (plan.drive, token): plan
        for plan, token in zip(plans, rows["token"], strict=True)
        if not plan.stage_one
    }
    for key, group in rows[rows[STAGE] == 2].groupby(["agent", FOLLOWS], sort=False):
        agent, token = map(str, key)
        if (agent, token) not in first:
            raise ConfigError(
                f"stage_one: {agent or 'the agent'} has no window of stage one with the token "
                f"{token}"
            )
        earlier = first[agent, token]
        scenes = [(logs[plans[k].log], plans[k].t) for k in group.index]
        starts = [(ego_at(log, t), log.origin) for log, t in scenes]
        end = earlier.poses[-1, :2] + logs[earlier.log].origin
        rows.loc[group.index, WEIGHT] = weights(
            end, np.array([(ego.x + x, ego.y + y) for ego, (x, y) in starts])
        )
    return rows


def stage_means(rows: pd.DataFrame, parts: Sequence[str]) -> pd.DataFrame:
    """Return three rows for each agent: the means of the columns `parts` over stage one and over
    stage two, and the product (2).
    """
    parts = list(parts)
    summary = []
    for agent, group in rows.groupby("agent", sort=False):
        first, second = (group[group[STAGE] == stage] for stage in (1, 2))
        scenes = second[parts].mul(second[WEIGHT], axis=0)
        followed = scenes.groupby(second[FOLLOWS]).sum(min_count=1)
        product = (first.set_index("token")["score"] * followed["score"]).mean()
        summary += [
            {"token": STAGE_ONE, "agent": agent, **first[parts].mean()},
            {"token": STAGE_TWO, "agent": agent, **followed.mean()},
            {"token": COMBINED, "agent": agent, "score": product},
        ]
    return pd.DataFrame(summary)
