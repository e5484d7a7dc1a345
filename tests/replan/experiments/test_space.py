"""Spaces: what is read, what is refused before anything is driven, and the settings as a file."""

from pathlib import Path

import pytest
import tomli_w

from replan.config import RunConfig, load_run
from replan.core.errors import ConfigError
from replan.experiments.space import chosen_table, listed, load_space, with_values

RUN = RunConfig(planners=("idm",))


def write(folder: Path, text: str) -> Path:
    path = folder / "space.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_settings_with_their_defaults(tmp_path: Path) -> None:
    text = """
        planner.idm.time_gap_s = { low = 0.5, high = 3, log = true }
        loop.traffic = { choices = ["time", "give_way"] }
        ensemble = { low = 0, high = 4, step = 2 }
    """
    gap, traffic, members = load_space(write(tmp_path, text), RUN)
    assert (gap.key, gap.default, gap.ends, gap.log) == (
        "planner.idm.time_gap_s",
        1.5,
        (0.5, 3.0),
        True,
    )
    assert (traffic.default, traffic.ends) == ("give_way", ("time", "give_way"))
    assert members.is_whole and members.ends == (0, 4)
    run = with_values(RUN, {gap.path: 0.9, traffic.path: "time", members.path: 2})
    assert (run.planner["idm"], run.loop.traffic, run.ensemble) == ({"time_gap_s": 0.9}, "time", 2)
    assert listed([gap], {gap.path: 0.9}) == "planner.idm.time_gap_s = 0.9"


def test_the_chosen_settings_are_a_file_of_a_run_with_nothing_else_in_it(tmp_path: Path) -> None:
    run = with_values(RUN, {("planner", "idm", "time_gap_s"): 0.9})
    table = chosen_table(run)
    assert table == {"planners": ["idm"], "planner": {"idm": {"time_gap_s": 0.9}}}
    (tmp_path / "best.toml").write_text(tomli_w.dumps(table), encoding="utf-8")
    assert load_run(tmp_path / "best.toml") == run


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "contains no setting"),
        ("planner.idm.time_gap = { low = 1, high = 2 }", "did you mean 'planner.idm.time_gap_s'"),
        ("planer.idm.time_gap_s = { low = 1, high = 2 }", "did you mean 'planner'"),
        ("planner.dp_qp.stitch_m = { low = 1, high = 2 }", "no setting is called 'planner.dp_qp'"),
        ("planner.idm.time_gap_s = 1.5", "write { low = ..., high = ... }"),
        ("planner.idm.time_gap_s = { low = 1 }", "needs low and high, or choices"),
        ("planner.idm.time_gap_s = { low = 2, high = 1 }", r"low \(2\) must be below high \(1\)"),
        ("planner.idm.time_gap_s = { low = 1, high = inf }", "must be finite numbers"),
        ("planner.idm.time_gap_s = { low = 0, high = 1, log = true }", "log needs a positive low"),
        ("planner.idm.time_gap_s = { low = -1, high = 1 }", "time_gap_s = -1.0 is refused"),
        (
            "planner.idm.time_gap_s = { lo = 1, high = 2 }",
            "did you mean 'planner.idm.time_gap_s.low'",
        ),
        ("ensemble = { low = 0.5, high = 2 }", "must be whole, too"),
        ("loop.traffic = { low = 1, high = 2 }", "is no number"),
        ('loop.traffic = { choices = ["time"] }', "give at least two"),
        ('loop.traffic = { choices = [["time"]] }', "choices is a list of numbers, texts"),
        ('loop.traffic = { choices = ["time", "tme"] }', "is refused: .*tme"),
    ],
)
def test_an_invalid_space_is_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as error:
        load_space(write(tmp_path, text), RUN)
    assert str(error.value).startswith(str(tmp_path)) and "\n" not in str(error.value)
