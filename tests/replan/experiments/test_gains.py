"""Held-out logs, and gains against the defaults: directions, missing values, and chance."""

from collections import Counter
from math import floor

import numpy as np
import pytest
from hypothesis import given, strategies as st

from replan.core.errors import ConfigError
from replan.experiments.gains import Objective, gains, is_dominated, mean_gain, objectives, scales
from replan.experiments.held_out import held_out
from replan.metrics import METRICS
from replan.metrics.judge.aggregate import LogLabels
from replan.metrics.resampling import MIN_SIGNIFICANT

NAMES = st.dictionaries(
    st.text("abcdefgh", min_size=1, max_size=6), st.sampled_from(["a", "b", "c", ""]), max_size=40
)
TWO = (Objective("up", "closed", 1.0), Objective("down", "closed", -1.0))


def test_a_gain_is_the_improvement_as_a_share_of_the_defaults() -> None:
    default = np.array([[2.0, 4.0, np.nan], [1.0, 0.0, 5.0]])
    values = np.array([[3.0, 1.0, 9.0], [np.nan, 2.0, 5.0 + 1e-12]])
    assert scales(default).tolist() == [3.0, 2.0]
    expected = [[1.0 / 3.0, -1.0, 0.0], [0.0, -1.0, 0.0]]
    np.testing.assert_allclose(gains(values, default, scales(default), TWO), expected)
    assert scales(np.array([[0.0, 0.0], [np.nan, np.nan]])).tolist() == [1.0, 1.0]


@given(st.integers(0, 10_000), st.floats(0.5, 3.0))
def test_a_gain_on_every_log_is_better_and_its_mirror_is_not(seed: int, gain: float) -> None:
    drawn = gain * np.random.default_rng(seed).uniform(0.5, 1.5, (1, 8))
    assert mean_gain(drawn).holds and not mean_gain(-drawn).holds
    assert not mean_gain(drawn[:, : MIN_SIGNIFICANT - 1]).holds


def test_noise_is_not_better_but_by_chance() -> None:
    rng = np.random.default_rng(3)
    held = [mean_gain(rng.normal(0.0, 1.0, (2, 20))).holds for _ in range(200)]
    assert sum(held) <= 12  # 2.5 % of 200 are 5; more than 12 come once in a thousand times
    assert not mean_gain(np.zeros((2, 20))).holds


def test_a_trial_is_dominated_by_one_that_is_at_least_as_good_and_better_somewhere() -> None:
    points = np.array([[1.0, 0.0], [0.0, 1.0], [0.5, 0.5], [0.4, 0.4]])
    assert [is_dominated(point, points) for point in points] == [False, False, False, True]


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["ttc.mn"], "did you mean 'ttc.min'"),
        (["speed.mean"], "neither more nor less is better"),
        (["ttc.min", "ttc.min"], "named twice"),
    ],
)
def test_wrong_objectives_are_refused(names: list[str], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        objectives(names, METRICS)


def test_an_objective_has_the_loop_in_which_it_is_defined() -> None:
    chosen = objectives(["ttc.min", "ade.3s.mean"], METRICS)
    assert [(one.mode, one.sign) for one in chosen] == [("closed", 1.0), ("open", -1.0)]


@given(NAMES, st.floats(0.0, 1.0))
def test_the_share_is_held_out_of_all_logs_and_of_each_stratum(
    families: dict[str, str], share: float
) -> None:
    labels = {name: LogLabels(family) for name, family in families.items()}
    held = held_out(labels, share)
    assert len(held) == floor(len(labels) * share + 1e-9) and held <= set(labels)
    sizes, mine = Counter(families.values()), Counter(families[name] for name in held)
    assert all(abs(mine[family] - share * size) < 1.0 + 1e-6 for family, size in sizes.items())


@given(NAMES, st.randoms())
def test_the_order_of_the_logs_does_not_matter(
    families: dict[str, str], random: st.DataObject
) -> None:
    labels = {name: LogLabels(dataset=family) for name, family in families.items()}
    names = list(labels)
    random.shuffle(names)  # type: ignore[attr-defined]
    assert held_out({name: labels[name] for name in names}, 0.3) == held_out(labels, 0.3)
