"""The logs of `separating` ask for what a fault in the input hides."""

import numpy as np
import pytest

from replan.logs.catalogue import scenario, suite
from replan.logs.rules import Colour
from replan.logs.scenario import Scenario
from replan.logs.shapes import distance

KINDS = ("stop_sign", "late_amber", "two_stop_lines")


def gaps(log: Scenario) -> np.ndarray:
    """The least gap of the logged drive to each road user, m."""
    least = np.full(len(log.tracks), np.inf)
    for state in (log.ego.state(i) for i in range(len(log.ego))):
        ego = (
            *state.ahead(log.vehicle.axle_to_center),
            state.yaw,
            log.vehicle.length,
            log.vehicle.width,
        )
        others = log.tracks.truth(state.t)
        boxes = np.column_stack([others.x, others.y, others.yaw, others.length, others.width])
        least = np.minimum(least, [distance(*ego, *box) for box in boxes.tolist()])
    return least


def front(log: Scenario) -> np.ndarray:
    return log.ego.x + log.vehicle.axle_to_front


@pytest.mark.parametrize("label", [name for kind in KINDS for name in suite(f"separating/{kind}")])
def test_the_driver_stands_before_each_line_and_crosses_lights_at_green(label: str) -> None:
    log = scenario(label)
    lights = {light.id: light for light in log.lights}
    for line in log.road.stop_lines:
        before = line.points[0, 0] - front(log)
        standing = log.ego.v < 0.1
        assert 0.0 < before[standing & (before > 0.0)].min() < 3.0
        assert line.must_stop is (line.light is None)
        crossed = float(log.ego.t[np.argmax(before < 0.0)])
        assert line.light is None or lights[line.light].at(crossed) is Colour.GREEN


def test_who_is_seen_aside_of_their_place_is_left_too_little_room() -> None:
    """Between people on both kerbs there is a metre to each in the middle only, and beside a rider
    at the left edge less than the 1.5 m of the law.
    """
    for label in suite("separating/both_kerbs"):
        log = scenario(label)
        beside = gaps(log)
        assert 1.0 <= beside.min() < 1.4 and beside.max() == pytest.approx(beside.min())
    for label in suite("separating/rider_at_left_edge"):
        log = scenario(label)
        right = log.tracks.y[0] - 0.5 * log.tracks.width[0]
        assert right - (-1.75) - log.vehicle.width < 1.5 and gaps(log).min() > 3.0


def test_the_fast_car_is_far_away_a_second_before_and_passes_first() -> None:
    for label in suite("separating/fast_car"):
        log = scenario(label)
        passes = float(log.metadata["parameter.passes_s"])
        line = next(line for line in log.road.stop_lines if line.lane == 1)
        entered = float(log.ego.t[np.argmax(front(log) > line.points[0, 0])])
        assert passes < entered
        aside = abs(log.tracks.truth(passes - 2.0).y[0] - log.tracks.truth(passes).y[0])
        assert aside == pytest.approx(50.0)
