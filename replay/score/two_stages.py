"""NAVSIM v2's two stages: a plan counts as much as what follows from where it ends (pseudo-simulation).

A window of stage one has follow-up scenes, each the window of a log that begins where a drive may be 4 s later. With d
from the plan's last pose to the begin of scene k, in the map's plane,

(1) w_k = exp(-d_k^2 / (2 `SIGMA2`)), divided by their sum; where that is 0, all are equal
(2) combined = mean over the windows of stage one of (score x sum_k w_k score_k)

The windows of both stages come in pairs 0.5 s apart; both of a pair have the same EC. Source: navsim 0a380a90,
scene_aggregator.py and run_pdm_score.py.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from logs.arrays import FloatArray
from logs.errors import ConfigError
from logs.scenario import Scenario
from replay.score.trajectories import Asked, ego_at

SIGMA2 = 0.1  # Variance of (1), m2
STAGE, FOLLOWS, WEIGHT = "stage", "stage_one", "weight"
STAGE_ONE, STAGE_TWO, COMBINED = (f"extended_pdm_score_{word}" for word in ("stage_one", "stage_two", "combined"))
"""Names of the summary's rows in NAVSIM's tables."""


def weights(end: FloatArray, begins: FloatArray) -> FloatArray:
    """Return the weights (1) `(n,)` of scenes: the plan ends at `end` `(2,)`, they begin at `begins` `(n, 2)`."""
    found = np.exp(-((begins - end) ** 2).sum(axis=1) / (2.0 * SIGMA2))
    return found / found.sum() if found.sum() > 1e-8 else np.full(len(begins), 1.0 / len(begins))


def two_stages(rows: pd.DataFrame, asked: Sequence[Asked], logs: Mapping[str, Scenario]) -> pd.DataFrame:
    """Return the rows of plans with their stage, the token that they follow, and their weight.

    ConfigError if two plans of an agent have one token; a plan follows none of stage one.
    """
    rows = rows.copy()
    rows[FOLLOWS], rows[WEIGHT] = [one.stage_one for one in asked], 1.0
    rows[STAGE] = np.where(rows[FOLLOWS] == "", 1, 2)
    twice = rows[rows.duplicated(["agent", "token"])]
    if len(twice):
        raise ConfigError(f"token {twice['token'].iloc[0]}: two windows have it; stage_one needs tokens that differ")
    first = {(one.drive, token): one for one, token in zip(asked, rows["token"], strict=True) if not one.stage_one}
    for key, group in rows[rows[STAGE] == 2].groupby(["agent", FOLLOWS], sort=False):
        agent, token = map(str, key)
        if (agent, token) not in first:
            raise ConfigError(f"stage_one: {agent or 'the agent'} has no window of stage one with the token {token}")
        before = first[agent, token]
        scenes = [(logs[asked[k].log], asked[k].t) for k in group.index]
        starts = [(ego_at(log, t), log.origin) for log, t in scenes]
        end = before.poses[-1, :2] + logs[before.log].origin
        rows.loc[group.index, WEIGHT] = weights(end, np.array([(ego.x + x, ego.y + y) for ego, (x, y) in starts]))
    return rows


def with_stages(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the rows with three more for each agent: the means of stage one and of stage two, and the product (2)."""
    parts = [name for name in rows.columns if rows[name].dtype == np.float64 and name not in ("start_time", WEIGHT)]
    summary = []
    for agent, own in rows.groupby("agent", sort=False):
        one, two = (own[own[STAGE] == stage] for stage in (1, 2))
        after = two[parts].mul(two[WEIGHT], axis=0).groupby(two[FOLLOWS]).sum(min_count=1)
        product = (one.set_index("token")["score"] * after["score"]).mean()
        summary += [
            {"token": STAGE_ONE, "agent": agent, **one[parts].mean()},
            {"token": STAGE_TWO, "agent": agent, **after.mean()},
            {"token": COMBINED, "agent": agent, "score": product},
        ]
    return pd.concat([rows, pd.DataFrame(summary)], ignore_index=True)[list(rows.columns)]
