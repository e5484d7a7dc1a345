"""A run's configuration: what is written is read back; what is wrong names file, key and remedy."""

import tomllib
from dataclasses import asdict, fields, replace
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, strategies as st

import replan
from replan.config import RunConfig, dump_run, load_run
from replan.core.errors import ConfigError
from replan.core.settings import dotted_keys, set_table, strict
from replan.logs.vehicle import VehicleParameters, vehicle_names, vehicle_parameters
from replan.planners.dp_qp import DpQpConfig
from replan.replay.loop_config import LoopConfig
from replan.replay.parts import PLANNER
from replan.replay.planner_process.planner_config import planner_part
from replan.run.checks import checked
from replan.run.judging import explained

WORDS = st.text("abcdefgh_:.", min_size=1, max_size=12)
VEHICLE_KEYS = {
    "mass": st.floats(500.0, 3000.0),
    "width": st.floats(1.0, 3.0),
    "set": st.sampled_from(vehicle_names()),
}
RUNS = st.builds(
    RunConfig,
    planners=st.lists(WORDS, min_size=1, max_size=3, unique=True).map(tuple),
    mode=st.sampled_from(["both", "open", "closed"]),
    internals=st.sampled_from(["none", "summary", "full"]),
    recording=st.booleans(),
    loop=st.builds(
        LoopConfig,
        plan_period_s=st.sampled_from([0.1, 0.2]),
        prediction_horizon_s=st.floats(1.0, 9.0),
    ),
    planner=st.dictionaries(
        WORDS, st.dictionaries(WORDS, st.integers() | st.floats(-1e6, 1e6) | st.text(max_size=5))
    ),
    vehicle=st.fixed_dictionaries({}, optional=VEHICLE_KEYS),
)


@given(run=RUNS)
def test_written_then_read_is_the_same(
    run: RunConfig, tmp_path_factory: pytest.TempPathFactory
) -> None:
    path = tmp_path_factory.mktemp("run") / "run.toml"
    path.write_text(dump_run(run), encoding="utf-8")
    assert load_run(path) == run


KEYS = [field.name for field in fields(LoopConfig) if field.metadata.get("key", True)]


@given(name=st.sampled_from(KEYS), extra=st.sampled_from("xyz"))
def test_any_misspelled_key_is_refused_with_the_right_one_named(name: str, extra: str) -> None:
    with pytest.raises(ConfigError, match=f"loop.{name}{extra}.*did you mean 'loop.{name}'"):
        strict(RunConfig, {"loop": {name + extra: 1}})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("planers = ['dp_qp']", "no key is called 'planers'; did you mean 'planners'?"),
        (
            "[loop]\nplan_period = 0.1",
            "no key is called 'loop.plan_period'; did you mean 'loop.plan_period_s'?",
        ),
        (
            "[loop]\nmode = 'open'",
            "no key is called 'loop.mode'; known are: apart, control_period_s",
        ),
        ("[loop]\nplan_period_s = '0.1'", "loop.plan_period_s: expected float, got str"),
        ("[loop]\nplan_period_s = true", "loop.plan_period_s: expected float, got bool"),
        ("[loop]\nplan_period_s = 0.015", "must be a multiple"),
        ("mode = 'sideways'", "mode: Invalid enum value 'sideways'"),
        ("planners = []", "name at least one planner"),
        ("planners = ['dp_qp', 'dp_qp']", "named twice"),
        (
            "[vehicle]\nlenght = 4.0",
            "no key is called 'vehicle.lenght'; did you mean 'vehicle.length'?",
        ),
        ("[vehicle]\nlength = -4.0", "vehicle: vehicle length must be positive"),
        (
            "[vehicle]\nset = 'vw_vanagn'",
            "no vehicle is called 'vw_vanagn'; did you mean 'vw_vanagon'?",
        ),
        ("[vehicle]\nset = 'lorry'", "known are: bmw_320i, city_bus, delivery_robot"),
        ("[vehicle]\nset = 3", "vehicle.set: expected str, got int"),
        (
            "[vehicle]\nset = 'vw_vanagon'\nlength = -4.0",
            "vehicle: vehicle length must be positive",
        ),
        ("[vehicle]\nmass = 'heavy'", "vehicle.mass: expected float, got str"),
        ("planners = [1]", "planners[0]: expected str, got int"),
        ("loop = 3", "loop: expected"),
        ("mode =", "not TOML"),
    ],
)
def test_a_wrong_key_is_one_line_with_file_and_key(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "run.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_run(path)
    assert str(path) in str(caught.value)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.toml: no such file"):
        load_run(tmp_path / "nowhere.toml")


def test_gates_are_relative_to_their_configuration(tmp_path: Path) -> None:
    (tmp_path / "run.toml").write_text('gates = "mine.toml"', encoding="utf-8")
    assert load_run(tmp_path / "run.toml").gates_path == tmp_path / "mine.toml"
    assert RunConfig().gates_path is None


def test_gates_of_a_run_are_found_from_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("mine.toml", "default"):
        folder = tmp_path / "results" / name
        folder.mkdir(parents=True)
        (folder / "run.toml").write_text(explained(RunConfig(gates=name), folder), encoding="utf-8")
        found, given = load_run(folder / "run.toml").gates_path, RunConfig(gates=name).gates_path
        assert (found and found.resolve()) == (given and given.resolve())


def test_vehicle_replaces_what_the_log_says() -> None:
    log = VehicleParameters(mass=900.0, width=2.0)
    driven = RunConfig(vehicle={"mass": 1200.0}).driven(log)
    assert (driven.mass, driven.width) == (1200.0, 2.0)


@given(name=st.sampled_from(vehicle_names()), mass=st.floats(500.0, 3000.0))
def test_a_known_vehicle_replaces_the_logs_and_other_keys_replace_its_own(
    name: str, mass: float
) -> None:
    log = VehicleParameters(mass=900.0, width=2.0)
    assert RunConfig(vehicle={"set": name}).driven(log) == vehicle_parameters(name)
    assert RunConfig(vehicle={"set": name, "mass": mass}).driven(log) == replace(
        vehicle_parameters(name), mass=mass
    )
    assert load_run(None, {"vehicle": {"set": name}}).driven(log) == vehicle_parameters(name)


def test_a_vehicle_that_fits_by_default_but_not_with_the_log_is_a_config_error() -> None:
    run = RunConfig(vehicle={"length": 4.0})
    with pytest.raises(ConfigError, match="vehicle"):
        run.driven(VehicleParameters(wheelbase=3.5, length=5.0))


def test_planner_keywords_are_checked_and_typed() -> None:
    assert planner_part("constant_speed", {"horizon_s": 4.0}).keywords() == {"horizon_s": 4.0}
    with pytest.raises(ConfigError, match=r"planner\.constant_speed\.horizon.*did you mean"):
        planner_part("constant_speed", {"horizon": 4.0}).keywords()
    config = planner_part("dp_qp", {"stitch_m": 0.4, "speed": {"qp": {"w_j": 9.0}}}).keywords()[
        "config"
    ]
    assert isinstance(config, DpQpConfig)
    assert (config.stitch_m, config.speed.qp.w_j, config.stitch_mps) == (
        0.4,
        9.0,
        DpQpConfig().stitch_mps,
    )
    with pytest.raises(ConfigError, match=r"planner\.dp_qp\.speed\.qp\.w_jj"):
        planner_part("dp_qp", {"speed": {"qp": {"w_jj": 9.0}}}).keywords()
    with pytest.raises(ConfigError, match=r"planner\.dp_qp\.stitch_m: expected float"):
        planner_part("dp_qp", {"stitch_m": "near"}).keywords()


@pytest.mark.parametrize("name", ["dp_qp", "constant_speed", "logged"])
def test_a_resolved_planner_table_spells_everything_and_makes_the_same_planner(name: str) -> None:
    table = planner_part(name).resolved()
    assert table
    again = planner_part(name, table).keywords()
    assert again == ({"config": DpQpConfig()} if name == "dp_qp" else table)


def test_words_of_set_are_toml_or_text_and_change_one_key(tmp_path: Path) -> None:
    words = [
        "loop.plan_period_s=0.2",
        "mode=open",
        'planner."my:Mine".layers=[1, 2]',
        "loop.plant.mass=1400",
        "log.ego='17'",
    ]
    table = set_table(words)
    assert table["loop"] == {"plan_period_s": 0.2, "plant": {"mass": 1400}}
    assert table["planner"] == {"my:Mine": {"layers": [1, 2]}}
    (tmp_path / "run.toml").write_text(
        "gates = 'mine.toml'\n[loop]\nplan_delay_s = 0.1", encoding="utf-8"
    )
    run = load_run(tmp_path / "run.toml", table)
    assert (run.mode, run.log.ego, run.loop.plan_delay_s, run.loop.plan_period_s) == (
        "open",
        "17",
        0.1,
        0.2,
    )
    assert run.gates_path == tmp_path / "mine.toml"
    for wrong in ("loop", "loop plan=1", "=1"):
        with pytest.raises(ConfigError, match="write it as KEY=VALUE"):
            set_table([wrong])


def test_a_table_may_name_a_part_of_its_settings_and_the_others_keep_their_defaults() -> None:
    whole = asdict(DpQpConfig())
    for key in dotted_keys(DpQpConfig):
        names = key.split(".")
        part = reduce(
            lambda inner, name: {name: inner}, reversed(names), reduce(getitem, names, whole)
        )
        assert strict(DpQpConfig, part) == DpQpConfig(), key
    harder = strict(DpQpConfig, {"speed": {"qp": {"comfort": {"decel_mps2": 4.5}}}}).speed.qp
    assert (
        replace(harder.comfort, decel_mps2=3.0) == DpQpConfig().speed.qp.comfort
        and harder.comfort.decel_mps2 == 4.5
    )


def test_every_dotted_key_is_one_of_the_written_file() -> None:
    whole = tomllib.loads(dump_run(RunConfig()))
    # the selection of logs is no setting: only the run.toml of a run has it
    keys = [key for key in dotted_keys(RunConfig) if not key.startswith("selection.")]
    assert {"mode", "loop.apart.trust", "loop.sensor.range_m", "log.ego", "vehicle"} <= set(keys)
    for key in keys:
        reduce(getitem, key.split("."), whole)


@pytest.mark.parametrize("value", ["{}", "[]", '"x"', "true"])
def test_a_keyword_of_a_part_has_its_type(value: str) -> None:
    from command_line import one_error, replan

    setting = f"vehicle_model.kinematic_bicycle.rear_ratio={value}"
    result = replan("evaluate", "--suite", "paper/free_road", "--set", setting)
    assert result.exit_code == 2 and "rear_ratio: expected float" in one_error(result)


@given(st.sampled_from(PLANNER.causal), st.floats(0.05, 0.5))
def test_a_run_file_explains_every_setting_and_is_the_same_run(name: str, period: float) -> None:
    """Law: it is read as the configuration, and each setting of a built-in part has its meaning
    beside it.
    """
    run = checked(RunConfig(planners=(name,), loop=LoopConfig(plan_period_s=round(period, 2))))[0]
    text = explained(run, Path())
    assert tomllib.loads(text) == tomllib.loads(dump_run(run))
    lines = [line for line in text.splitlines() if " = " in line and not line.startswith("#")]
    before = dict(zip(text.splitlines()[1:], text.splitlines(), strict=False))
    bare = [line for line in lines if "  # " not in line and not before[line].startswith("# ")]
    assert not bare


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"mode": "shut"}, "mode: .*known are: both, open, closed"),
        ({"loop": {"controler": "mpc"}}, "did you mean 'loop.controller'"),
        ({"loop": {"plan_period_s": "soon"}}, "loop.plan_period_s: expected float"),
        ({"log": {"begin": "later"}}, "log.begin: expected float"),
    ],
)
def test_wrong_arguments_of_evaluate_name_the_key_and_what_is_known(
    given: dict[str, Any], said: str
) -> None:
    with pytest.raises(ConfigError, match=said):
        replan.evaluate(**given)
