"""Axes: their words, origins and scales."""

import pytest
from hypothesis import given, strategies as st

from replan.core.errors import ConfigError
from replan.experiments.search_subject import SCALES, box_of, search_axes, values_at
from replan.logs.catalogue import FAMILIES
from replan.logs.edit.variations import VARIATIONS

CUT_IN = FAMILIES["unece_r157/cut_in"]


@given(st.floats(-3.0, 3.0), st.floats(-5.0, 5.0))
def test_values_at_a_point_give_the_point_back(u: float, w: float) -> None:
    axes = search_axes(["time=-3:3", "speed=0.2:2"], (), None, with_agents=True)
    values = values_at(axes, (u, w))
    assert values["time"] == pytest.approx(u, abs=1e-8)
    assert values["speed"] == pytest.approx(min(max(1.0 + 0.2 * w, 0.2), 2.0), abs=1e-8)


def test_the_origin_is_the_recorded_value_and_for_an_inserted_agent_the_far_end() -> None:
    axes = search_axes(["ego_speed=0.5:1.5", "standing_car=20:80"], (), None, with_agents=False)
    assert [axis.origin for axis in axes] == [1.0, 80.0]
    assert box_of(axes).tolist() == [[-5.0, -6.0], [5.0, 0.0]]
    assert values_at(axes, (0.0, 0.0)) == {"ego_speed": 1.0, "standing_car": 80.0}


def test_every_variation_with_an_order_has_a_scale() -> None:
    assert set(SCALES) == {name for name, one in VARIATIONS.items() if not one.is_choice}


def test_parameters_of_families_are_scaled_by_their_names() -> None:
    words = ["ego_kmh=20:60", "gap_m=0:60", "lateral_mps=0.5:3", "accel_mps2=-3:3"]
    axes = search_axes(words, ["gap_m=2"], CUT_IN, with_agents=True)
    assert [(axis.origin, axis.scale) for axis in axes] == [
        (60.0, 6.0),
        (30.0, 2.0),
        (2.0, 0.4),
        (0.0, 1.0),
    ]
    assert [axis.unit for axis in axes] == ["km/h", "m", "m/s", "m/s2"]


def test_default_axes_are_the_grid_of_a_family_or_the_usual_variations() -> None:
    assert [axis.name for axis in search_axes((), (), CUT_IN, with_agents=True)] == list(
        CUT_IN.grid
    )
    usual = search_axes((), (), FAMILIES["everyday/cut_in"], with_agents=True)
    assert [axis.name for axis in usual] == ["time", "speed", "ego_speed"]
    assert [axis.name for axis in search_axes((), (), None, with_agents=False)] == ["ego_speed"]


@pytest.mark.parametrize(
    ("words", "scales", "message"),
    [
        (["tme=0:1"], [], "did you mean 'time'"),
        (["time=0"], [], "write it as NAME=LOW:HIGH"),
        (["time=1:0"], [], "LOW below HIGH"),
        (["time=nan:1"], [], "LOW below HIGH"),
        (["time=1:3"], [], "does not hold the recorded value, 0"),
        (["time=-3:3", "time=-1:1"], [], "named twice"),
        (["remove=0:1"], [], "is a choice and has no distance"),
        (["speed=0.1:2"], [], "it must be from 0.2 to 5"),
        (["time=-3:3"], ["speed=1"], "no axis"),
        (["time=-3:3"], ["time=0"], "a positive value"),
    ],
)
def test_wrong_axes_are_refused_in_one_line(
    words: list[str], scales: list[str], message: str
) -> None:
    with pytest.raises(ConfigError, match=message) as error:
        search_axes(words, scales, None, with_agents=True)
    assert "\n" not in str(error.value)


def test_a_parameter_without_a_unit_in_its_name_needs_a_scale() -> None:
    family = FAMILIES["everyday/junction"]
    with pytest.raises(ConfigError, match="--scale turn=1"):
        search_axes(["turn=-1:1"], (), family, with_agents=True)
    assert search_axes(["turn=-1:1"], ["turn=2"], family, with_agents=True)[0].scale == 2.0
