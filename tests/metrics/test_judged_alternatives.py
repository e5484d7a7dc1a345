"""What a planner chose among, judged each by itself (`replan.metrics.alternatives`)."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from drives import along, car, drive, grid, plans, scenario, straight_road
from hypothesis import given, settings, strategies as st

from replan.logs.scenario import Scenario
from replan.logs.states import Alternative, Trajectory
from replan.logs.trace import Mode, PlannedFrame
from replan.metrics import GROUPS, evaluate

ASKED = {metric.name: metric for metric in GROUPS["alternatives"]}
V, SECONDS = 10.0, 3.0
LOG = scenario(along(grid(SECONDS + 9.0, 0.1), V), road=straight_road(half=10.0))


def changed(path: Trajectory, share: float, aside: float) -> Trajectory:
    bend = np.clip((path.t - path.t[0]) / 4.0, 0.0, 1.0)
    x = path.x[0] + share * (path.x - path.x[0])
    return replace(path, x=x, y=path.y + aside * bend, v=share * path.v)


def frames(
    differences: Sequence[tuple[float, float]], scores: Sequence[float], log: Scenario = LOG
) -> tuple[PlannedFrame, ...]:
    """Plans whose alternatives have a share of the log's speed and an offset from it, m."""
    made = []
    for frame in plans(log.ego, grid(SECONDS, 0.5), 8.0):
        path = frame.plan.trajectory
        alternatives = tuple(
            Alternative(changed(path, *difference), score)
            for difference, score in zip(differences, scores, strict=True)
        )
        made.append(replace(frame, plan=replace(frame.plan, alternatives=alternatives)))
    return tuple(made)


def judged(
    made: tuple[PlannedFrame, ...], log: Scenario = LOG, mode: Mode = Mode.OPEN
) -> pd.DataFrame:
    return evaluate(drive(log, mode=mode, frames=made), log, metrics=ASKED).set_index("metric")


fans = st.lists(
    st.tuples(st.floats(0.2, 1.2), st.floats(-5.0, 5.0)), min_size=1, max_size=6, unique=True
)


@given(fan=fans, more=st.tuples(st.floats(0.2, 1.2), st.floats(-5.0, 5.0)))
@settings(max_examples=25, deadline=None)
def test_one_more_alternative_never_takes_the_log_farther_away(
    fan: list[tuple[float, float]], more: tuple[float, float]
) -> None:
    few = judged(frames(fan, [1.0] * len(fan)))["value"]
    many = judged(frames([*fan, more], [1.0] * (len(fan) + 1)))["value"]
    for name in ("min_ade.1s.mean", "min_ade.8s.mean", "min_fde.3s.max", "min_miss.3s.rate"):
        assert many[name] <= few[name] + 1e-12, name


@given(fan=fans, order=st.randoms(use_true_random=False))
@settings(max_examples=25, deadline=None)
def test_the_order_of_alternatives_does_not_matter(
    fan: list[tuple[float, float]], order: object
) -> None:
    scores = [1.0 / (k + 2) for k in range(len(fan))]
    pairs = list(zip(fan, scores, strict=True))
    one = judged(frames(fan, scores))
    order.shuffle(pairs)  # type: ignore[attr-defined]
    two = judged(frames([place for place, _ in pairs], [score for _, score in pairs]))
    assert one["value"].to_numpy(float) == pytest.approx(
        two["value"].to_numpy(float), abs=1e-9, nan_ok=True
    )


def test_of_one_alternative_the_least_is_its_own_error() -> None:
    table = judged(frames([(1.0, 0.0)], [1.0]))["value"]
    for h in ("1s", "3s", "5s", "8s"):
        assert table[f"min_ade.{h}.mean"] == pytest.approx(0.0, abs=1e-12)
    assert table["alternatives.mean"] == 1.0
    assert table["alternatives_spread.mean"] == 0.0
    slow = judged(frames([(0.5, 0.0)], [1.0]))["value"]
    assert slow["min_fde.3s.mean"] == pytest.approx(0.5 * V * 3.0)
    assert slow["min_ade.3s.mean"] == pytest.approx(0.5 * V * np.mean(np.arange(1, 31)) * 0.1)
    assert slow["min_miss.3s.rate"] == 1.0


def test_spread_is_the_mean_distance_from_the_middle() -> None:
    table = judged(frames([(1.0, 3.0), (1.0, -3.0)], [0.5, 0.5]))["value"]
    assert table["alternatives_spread.mean"] == pytest.approx(3.0)


def test_the_share_off_the_road_is_that_of_the_alternatives() -> None:
    table = judged(frames([(1.0, 0.0), (1.0, 12.0), (0.9, 0.0), (1.0, -12.0)], [0.25] * 4))["value"]
    assert table["alternatives_off_road.mean"] == 0.5
    assert table["alternatives_contact.mean"] == 0.0


def test_regret_is_what_a_better_choice_would_have_gained() -> None:
    world = scenario(
        along(grid(SECONDS + 9.0, 0.1), V),
        [car(55.0, 0.0, 0.0)],
        road=straight_road(half=10.0),
    )
    fan = [(1.0, 0.0), (0.6, 0.0)]  # into the parked car; slower, which is better until it is near
    right = judged(frames(fan, [0.2, 0.8], world), world)["value"]
    wrong = judged(frames(fan, [0.8, 0.2], world), world)["value"]
    assert right["alternatives_contact.mean"] == wrong["alternatives_contact.mean"] > 0.0
    assert wrong["selection_regret.mean"] > 0.3
    assert right["selection_regret.mean"] < 0.1
    assert judged(frames(fan[:1], [1.0], world), world)["value"]["selection_regret.max"] == 0.0


@pytest.mark.parametrize(
    ("scores", "nearest", "error", "brier"),
    [
        ((1.0, 0.0), 1.0, 0.0, 0.0),
        ((0.0, 1.0), 0.0, 1.0, 2.0),
        ((0.7, 0.3), 1.0, 0.3, 0.18),
        ((0.4, 0.6), 0.0, 0.6, 0.72),
    ],
)
def test_probabilities_are_held_against_the_nearest(
    scores: tuple[float, float], nearest: float, error: float, brier: float
) -> None:
    table = judged(frames([(1.0, 0.0), (0.5, 0.0)], scores))["value"]
    assert table["nearest_chosen.mean"] == nearest
    assert table["nearest_chosen.calibration_error"] == pytest.approx(error)
    assert table["brier.mean"] == pytest.approx(brier)


def test_scores_that_are_no_probabilities_are_not_calibrated() -> None:
    table = judged(frames([(1.0, 0.0), (0.5, 0.0)], [3.0, 1.0]))
    assert not table["available"]["brier.mean"]
    assert "no scores sum to 1" in table["reason"]["brier.mean"]
    assert table["available"]["selection_regret.mean"]


def test_without_scores_nothing_is_chosen() -> None:
    table = judged(frames([(1.0, 0.0), (0.5, 0.0)], [np.nan, np.nan]))
    assert table["reason"]["selection_regret.mean"] == "the alternatives have no scores"
    assert table["available"]["min_ade.3s.mean"]


def test_a_planner_without_alternatives_says_so() -> None:
    table = judged(tuple(plans(LOG.ego, grid(SECONDS, 0.5), 8.0)))
    names = [metric.name for metric in GROUPS["alternatives"]]
    rows = table[[name.partition(".")[0] in names for name in table.index]]
    assert len(rows) and not rows["available"].any()
    assert set(rows["reason"]) == {"the planner shows no alternatives (`Plan.alternatives`)"}


def test_an_alternative_that_ends_early_counts_until_its_end() -> None:
    made = list(frames([(1.0, 0.0), (0.5, 0.0)], [0.5, 0.5]))
    short = []
    for frame in made:
        exact, slow = frame.plan.alternatives
        ended = exact.changed(lambda path: path.resampled(path.t[path.t <= path.t[0] + 2.0]))
        short.append(replace(frame, plan=replace(frame.plan, alternatives=(ended, slow))))
    table = judged(tuple(short))["value"]
    assert table["min_ade.1s.mean"] == 0.0
    assert table["min_fde.3s.mean"] == pytest.approx(0.5 * V * 3.0)
