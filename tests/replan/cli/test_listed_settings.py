"""`replan list NAME`: every setting has a key that --set takes, a default, a unit and a meaning,
all from the code.
"""

import json
from collections.abc import Callable
from dataclasses import replace

import pytest
from command_line import one_error, replan

from replan.cli.listing import ListedSetting, described, settings_of, unit
from replan.cli.options import complete_setting, completion
from replan.config import RunConfig
from replan.core.errors import ConfigError
from replan.core.settings import bounds_of, dotted_keys, set_table, strict, types_of
from replan.planners.dp_qp.lane import DpQpConfig
from replan.replay.control.mpc import MpcConfig
from replan.replay.parts import PARTS, Part

BOUND_BY_OTHERS = {"planner.dp_qp.path.corridor.clearance_m", "planner.dp_qp.path.dp.rows"}
"""Settings whose bound is not accepted beside the defaults of others."""
BUILT_IN = [Part(kind, name) for kind in PARTS.values() for name in kind.builtin]

MINE = '''
from dataclasses import dataclass
from typing import Annotated

from msgspec import Meta

from replan.planners.constant_speed import ConstantSpeed


@dataclass(frozen=True)
class MineConfig:
    """Settings."""

    gap_m: float
    """The gap
    to keep."""
    share: float = 0.5

    def __post_init__(self):
        assert False, "is not built: gap_m has no default"


class Mine(ConstantSpeed):
    """Mine."""

    def __init__(self, context, config: MineConfig | None = None):
        super().__init__(context)


class Follower:
    """Controls."""

    def __init__(
        self,
        parameters,
        powertrain,
        period,
        *,
        gain_pm: Annotated[float, Meta(ge=0.0, description="Its gain.")] = 2.0,
    ):
        """Build it."""

    def control(self, state, plan): ...


def either(scenario):
    """A planner or traffic."""
'''


@pytest.mark.parametrize("part", BUILT_IN, ids=lambda part: part.where)
def test_every_setting_has_a_meaning_and_a_key_that_set_takes(part: Part) -> None:
    found = settings_of(part)
    assert len({one.key for one in found}) == len(found)
    for one in found:
        assert len(one.meaning.split()) > 1 and "..." not in one.meaning, (
            f"{one.key}: its meaning is not stated"
        )
        assert one.default is not None, one
        table = set_table([f"{one.key}={json.dumps(one.default)}"])
        if one.key.startswith("loop."):
            assert strict(RunConfig, table) == RunConfig()
        else:
            (settings,) = table[part.kind.table].values()
            replace(part, settings=settings).keywords()


def test_all_settings_of_a_dataclass_are_listed_and_their_bounds_are_those_that_it_checks() -> None:
    found = {
        one.key.removeprefix("planner.dp_qp."): one
        for one in settings_of(Part(PARTS["planner"], "dp_qp"))
    }
    assert sorted(found) == sorted(dotted_keys(DpQpConfig))
    decel = found["speed.qp.comfort.decel_mps2"]
    assert (decel.default, decel.unit, decel.range) == (3.0, "m/s2", {"exclusiveMinimum": 0.0})
    assert decel.group and decel.group != found["speed.qp.emergency.decel_mps2"].group
    assert (found["speed.qp.w_s"].unit, found["lane.due_s"].unit) == ("", "s")
    assert found["path.dp.rows"].range == {"minimum": 3} and found["path.dp.columns"].range == {
        "minimum": 2
    }
    assert found["lane.due_s"].range == {"exclusiveMinimum": 0.0} and found[
        "lane.look_s"
    ].range == {"minimum": 0.0}
    friction = bounds_of(types_of(MpcConfig)["friction_share"])
    assert friction == {"exclusiveMinimum": 0.0, "maximum": 1.0}


def test_a_value_out_of_its_range_is_refused_in_python_too() -> None:
    with pytest.raises(ConfigError, match=r"friction_share: expected float <= 1.0, got 1.5"):
        MpcConfig(friction_share=1.5)


@pytest.mark.parametrize("part", BUILT_IN, ids=lambda part: part.where)
def test_values_within_a_range_are_accepted_and_values_beyond_refused(part: Part) -> None:
    for one in settings_of(part):
        if one.key in BOUND_BY_OTHERS:
            continue
        for bound, edge in one.range.items():
            away = (1 if isinstance(edge, int) else 1e-6 * max(1.0, abs(edge))) * (
                -1 if "inimum" in bound else 1
            )
            for value, holds in (
                (edge, bound[0] == "m"),
                (edge + away, False),
                (edge - away, True),
            ):
                assert _takes(part, one, value) == holds, (one, value)


def _takes(part: Part, one: ListedSetting, value: float) -> bool:
    listed = [value] * len(one.default) if isinstance(one.default, tuple) else value
    table = set_table([f"{one.key}={json.dumps(listed)}"])
    try:
        if one.key.startswith("loop."):
            strict(RunConfig, table)
        else:
            (settings,) = table[part.kind.table].values()
            replace(part, settings=settings).keywords()
    except Exception:
        return False
    return True


def test_units_are_the_last_part_of_a_name() -> None:
    names = {
        "time_gap_s": "s",
        "jerk_mps3": "m/s3",
        "yaw_noise_deg": "deg",
        "steps": "",
        "s": "",
        "w_m": "",
        "seed": "",
    }
    assert {name: unit(name) for name in names} == names


def test_a_part_of_a_user_is_described_by_its_kind(module: Callable[[str, str], str]) -> None:
    module("listed_mine", MINE)
    (mine,) = described("listed_mine:Mine")
    assert (mine.kind, mine.says) == ("planners", "Mine.") and mine.settings is not None
    gap, share = mine.settings
    assert (gap.key, gap.default, gap.unit) == ('planner."listed_mine:Mine".gap_m', None, "m")
    assert (gap.meaning, share.meaning, gap.range) == ("The gap to keep.", "", {})
    (follower,) = described("listed_mine:Follower")
    assert follower.kind == "controllers" and follower.settings is not None
    assert [(one.default, one.unit, one.meaning) for one in follower.settings] == [
        (2.0, "1/m", "Its gain.")
    ]
    assert [one.kind for one in described("listed_mine:either")] == ["planners", "traffic"]
    assert "takes the arguments of no" in one_error(replan("list", "listed_mine:MineConfig"))


def test_the_shell_completes_settings_of_parts_and_names_to_list() -> None:
    assert complete_setting("planner.dp_qp.speed.qp.comfort.d") == [
        "planner.dp_qp.speed.qp.comfort.decel_mps2="
    ]
    assert complete_setting("vehicle_model.kinematic_bicycle.") == [
        "vehicle_model.kinematic_bicycle.rear_ratio="
    ]
    assert completion("listed")("kinematic") == ["kinematic_bicycle", "kinematic_rear_steer"]
    assert set(completion("listed")("plan")) == {"planners"}
