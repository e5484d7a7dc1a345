from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from drives import along, drive, grid, moving, scenario

from logs import AgentKind
from metrics import evaluate
from metrics.judge.aggregate import LogLabels
from metrics.judge.gates import Gate, Gates
from metrics.judge.rows import with_ensemble
from replay.run.perturb import NOISE_M, PERTURBATIONS, START_M, perturbed

GATES = Gates((Gate("speed.max", max=10.5, mode="closed"), Gate("ensemble.fragile", max=0.0, optional=True)), "test")


def table(*speeds: float) -> list[pd.DataFrame]:
    log = scenario(along(grid(1.0), 10.0))
    return [evaluate(drive(log, along(grid(1.0), speed)), log) for speed in speeds]


def ensemble(plain: float, *members: float) -> dict[str, tuple[float, str]]:
    rows = pd.concat([t.assign(member=i, perturbation=f"kind{i}") for i, t in enumerate(table(*members), 1)])
    found = with_ensemble(table(plain)[0], rows, GATES, {"test/log": LogLabels()})
    found = found[found["metric"].str.startswith("ensemble.")]
    assert found["available"].all()
    return {row.metric: (row.value, row.reason) for row in found.itertuples()}


@pytest.mark.parametrize(("plain", "members"), [(10.0, (10.0, 9.0)), (11.0, (12.0, 13.0))])
def test_a_verdict_that_holds_everywhere_is_not_fragile(plain: float, members: tuple[float, ...]) -> None:
    found = ensemble(plain, *members)
    assert found["ensemble.fragile"] == (0.0, "")
    assert found["ensemble.pass_share"][0] == (1.0 if plain < 10.5 else 0.0)


def test_a_verdict_that_flips_is_fragile_and_says_where() -> None:
    found = ensemble(10.0, 10.0, 11.0)
    assert found["ensemble.pass_share"][0] == pytest.approx(2.0 / 3.0)
    assert found["ensemble.fragile"] == (1.0, "kind2: pass -> fail (speed.max <= 10.5 [closed])")


def test_without_members_the_table_stays_and_says_why_there_is_no_value() -> None:
    (plain,) = table(10.0)
    assert with_ensemble(plain, pd.DataFrame(), GATES, {"test/log": LogLabels()}) is plain
    assert (
        plain.loc[plain["metric"] == "ensemble.fragile", "reason"] == "the run has no ensemble (--ensemble N)"
    ).all()


def test_the_kinds_take_turns_and_are_the_same_in_every_run() -> None:
    car = ("7", AgentKind.CAR, (4.0, 2.0), moving(30.0, 0.0, 5.0, 0.0))
    log = scenario(along(grid(1.0, 0.1), 10.0), [car])
    kinds = list(PERTURBATIONS)
    for member in range(1, len(kinds) + 2):
        name, one = perturbed(log, member)
        assert name == kinds[(member - 1) % len(kinds)]
        assert np.array_equal(one.tracks.x, perturbed(log, member)[1].tracks.x)
    worlds = dict(perturbed(log, member) for member in range(1, len(kinds) + 1))
    assert worlds["again"] is log
    assert worlds["clock"].start_ns != log.start_ns
    assert 0.0 < np.abs(worlds["tiny"].tracks.x - log.tracks.x).max() <= 1e-9
    assert (
        0.0 < np.hypot(worlds["start"].ego.x - log.ego.x, worlds["start"].ego.y - log.ego.y).max() <= START_M * 2**0.5
    )
    assert 0.3 * NOISE_M < np.std(worlds["noise"].tracks.x - log.tracks.x) < 3.0 * NOISE_M
    assert np.allclose(np.diff(worlds["rate"].tracks.t), 0.2)
    assert np.allclose(np.hypot(*(np.diff(c) for c in (worlds["turned"].ego.x, worlds["turned"].ego.y))), 1.0)
    assert not np.array_equal(perturbed(log, 2)[1].ego.yaw, perturbed(log, 2 + len(kinds))[1].ego.yaw)
