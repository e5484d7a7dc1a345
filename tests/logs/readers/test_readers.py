"""The table of readers: one claims a log, foreign ones are sent on, a part of a log is that
part.
"""

import sys
from dataclasses import replace
from importlib.metadata import EntryPoint
from math import inf
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from rich_scenario import rich_scenario

from replan.config import RunConfig
from replan.core import extension
from replan.core.errors import ConfigError, LogError
from replan.logs.catalogue import CATALOGUE
from replan.logs.edit.cut import cut
from replan.logs.mcap import read_scenario, write_scenario
from replan.logs.readers import LogSettings, Reader, logs_in, read_log, reader_of, readers, windows
from replan.logs.scenario import Scenario
from replan.run import evaluate_logs
from replan.run.log_source import LogSource
from replan.run.sources import select

SCENARIO = CATALOGUE["everyday/cut_in"].scenario()


@given(st.floats(0.0, 4.0), st.floats(0.5, 3.0))
@settings(max_examples=30, deadline=None)
def test_a_part_is_that_part_of_the_log(begin: float, length: float) -> None:
    part = cut(SCENARIO, begin, begin + length)
    assert part.duration == pytest.approx(length) and part.start_ns == SCENARIO.start_ns + round(
        1e9 * begin
    )
    for t in np.linspace(0.0, length, 7):
        here, there = part.ego.at(float(t)), SCENARIO.ego.at(float(t) + begin)
        assert (here.x, here.y, here.yaw, here.v) == pytest.approx(
            (there.x, there.y, there.yaw, there.v), abs=1e-9
        )
        seen, known = part.tracks.truth(float(t)), SCENARIO.tracks.truth(float(t) + begin)
        assert seen.ids == known.ids and seen.x == pytest.approx(known.x, abs=1e-6)


@given(st.floats(0.1, 2.0), st.floats(0.1, 2.0))
@settings(max_examples=20, deadline=None)
def test_a_part_of_a_part_is_a_part(first: float, second: float) -> None:
    twice, once = cut(cut(SCENARIO, first), second), cut(SCENARIO, first + second)
    assert twice.ego.x == pytest.approx(once.ego.x[-len(twice.ego) :], abs=1e-9)
    assert twice.duration == pytest.approx(once.duration)


@pytest.mark.parametrize("off", [-(2.0**-51), 0.0, 2.0**-51])
def test_a_part_may_begin_and_end_a_rounding_off_a_sample(tmp_path: Path, off: float) -> None:
    """As 3 * 0.7 s is of 2.1 s: `--window 0.7` of a log at 10 Hz."""
    path = tmp_path / "log.mcap"
    write_scenario(path, SCENARIO)
    begin, end = float(SCENARIO.ego.t[7]) + off, float(SCENARIO.ego.t[21]) + off
    part = read_log(path, LogSettings(begin=begin, end=end))
    assert len(part.ego) == 15 and part.ego.t[0] == 0.0


def test_the_whole_is_the_same_object_and_beyond_the_log_is_an_error() -> None:
    assert cut(SCENARIO, 0.0) is SCENARIO and cut(SCENARIO, 0.0, inf) is SCENARIO
    with pytest.raises(LogError, match=r"no ego states after 500 s: they are from 0 s to"):
        cut(SCENARIO, 500.0)


def test_a_cut_log_keeps_lights_controls_and_goal(tmp_path: Path) -> None:
    whole = rich_scenario(40)
    path = tmp_path / "rich.mcap"
    write_scenario(path, whole)
    begin = 0.5 * float(whole.ego.t[-1])
    part = read_log(path, LogSettings(begin=begin))
    assert [light.id for light in part.lights] == [light.id for light in whole.lights]
    for light, before in zip(part.lights, whole.lights, strict=True):
        assert light.at(0.01) == before.at(begin + 0.01)
    assert whole.controls is not None and part.controls is not None
    assert len(part.controls) == int((whole.controls.t >= begin).sum())
    write_scenario(tmp_path / "part.mcap", part)
    assert read_scenario(tmp_path / "part.mcap").ego.x.tolist() == part.ego.x.tolist()


@given(st.floats(1.0, 9.0), st.floats(0.3, 9.0))
@settings(max_examples=20)
def test_windows_begin_every_so_many_seconds_and_have_half_their_length_at_least(
    length: float, every: float
) -> None:
    whole = LogSettings(begin=1.0, end=21.0)
    parts = windows(Path("there_is_no_such_log"), whole, length, every)
    assert [part.begin for part in parts] == pytest.approx(
        [1.0 + k * every for k in range(len(parts))]
    )
    spans = np.array([part.end - part.begin for part in parts])
    assert (
        (spans <= length + 1e-9).all()
        and (spans >= 0.5 * length - 1e-9).all()
        and parts[-1].end <= 21.0
    )
    assert 21.0 - (parts[-1].begin + every) < 0.5 * length + 1e-9, "none is missing"


def test_the_settings_are_part_of_what_a_log_is(tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    write_scenario(path, SCENARIO)
    plain, late = LogSource("log", path), LogSource("log", path, LogSettings(begin=1.0))
    assert plain.is_mcap and not late.is_mcap and plain.identity() != late.identity()


def test_settings_are_checked() -> None:
    for wrong, word in (
        ({"begin": 2.0, "end": 1.0}, "empty"),
        ({"clock": "wall"}, "clock"),
        ({"car": {"width": -1.0}}, "positive"),
    ):
        with pytest.raises(ValueError, match=word):
            LogSettings(**wrong)


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Installs a reader of another distribution."""

    def install(loaded: Any) -> None:
        entry = EntryPoint("mine", "my_reader:READER", "replan.readers")
        monkeypatch.setattr(extension, "_installed_entry_points", lambda group, path: (entry,))
        module = ModuleType("my_reader")
        vars(module).update({} if loaded is None else {"READER": loaded})
        monkeypatch.setitem(sys.modules, "my_reader", module)
        readers.cache_clear()

    yield install
    monkeypatch.undo()
    readers.cache_clear()


def _mine(path: Path, settings: LogSettings) -> Scenario:
    if path.read_text(encoding="utf-8") != "drive":
        raise LogError("not a drive")
    return replace(SCENARIO, name=f"mine {settings.ego}")


MINE = Reader(
    "mine",
    "a format of a team",
    "*.mine",
    (".mine",),
    lambda path: path.suffix == ".mine",
    _mine,
    settings=("ego",),
)


def test_a_reader_from_outside_reads_its_format_everywhere(installed: Any, tmp_path: Path) -> None:
    installed(MINE)
    path = tmp_path / "folder" / "a.mine"
    path.parent.mkdir()
    path.write_text("drive", encoding="utf-8")
    assert reader_of(path) is MINE and list(logs_in(tmp_path)) == [(path, MINE)]
    assert select([tmp_path]).sources[0].read().name == "mine "
    assert read_log(path, LogSettings(ego="7", begin=1.0)).name == "mine 7@1"
    path.write_text("nothing", encoding="utf-8")
    with pytest.raises(LogError) as error:
        read_log(path)
    assert str(error.value) == f"{path}: not a drive"


@given(st.floats(0.0, 3.0), st.floats(0.5, 2.0))
@settings(
    max_examples=10, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_a_part_and_its_conversion_are_the_same_to_the_last_bit(
    tmp_path: Path, begin: float, length: float
) -> None:
    """Else `convert` and `evaluate` would give other metrics than `evaluate` of the log as it
    is.
    """
    write_scenario(tmp_path / "log.mcap", SCENARIO)
    part = read_log(tmp_path / "log.mcap", LogSettings(begin=begin, end=begin + length))
    write_scenario(tmp_path / "part.mcap", part)
    again = read_log(tmp_path / "part.mcap")
    for one, other in ((part.ego, again.ego), (part.tracks, again.tracks)):
        for name in ("t", "x", "y", "yaw"):
            assert np.array_equal(getattr(one, name), getattr(other, name))
    assert part.duration == again.duration


def test_what_a_reader_from_outside_raises_is_its_own_fault(installed: Any, tmp_path: Path) -> None:
    def clumsy(path: Path, settings: LogSettings) -> Scenario:
        raise KeyError("x")

    installed(replace(MINE, read=clumsy))
    (tmp_path / "a.mine").touch()
    with pytest.raises(
        LogError, match=r"a\.mine: the reader mine raised KeyError: 'x'; its author: raise LogError"
    ):
        read_log(tmp_path / "a.mine")


def test_samples_on_one_nanosecond_are_refused(installed: Any, tmp_path: Path) -> None:
    twice = replace(SCENARIO, ego=replace(SCENARIO.ego, t=SCENARIO.ego.t * 1e-10))
    installed(replace(MINE, read=lambda path, settings: twice))
    (tmp_path / "a.mine").touch()
    with pytest.raises(LogError, match=r"a\.mine: in whole nanoseconds: .* increase"):
        read_log(tmp_path / "a.mine")


def test_an_ego_that_a_format_cannot_take_is_refused(installed: Any, tmp_path: Path) -> None:
    installed(replace(MINE, settings=()))
    path = tmp_path / "a.mine"
    path.write_text("drive", encoding="utf-8")
    for asked, word in ((LogSettings(ego="7"), "ego 7"), (LogSettings(problem=2), "problem 2")):
        with pytest.raises(
            LogError, match=f"{word} is asked for, but the format mine has no choice of it"
        ):
            read_log(path, asked)
    write_scenario(tmp_path / "native.mcap", SCENARIO)
    with pytest.raises(
        LogError, match=r"native\.mcap: ego 7 is asked for, but a native log has its ego"
    ):
        read_log(tmp_path / "native.mcap", LogSettings(ego="7"))


def test_a_reader_that_cannot_be_used_is_named(installed: Any) -> None:
    for loaded, word in (
        (None, "no reader in my_reader is called 'READER'"),
        (42, "reader 'mine' is a int, not a replan.Reader"),
        (replace(MINE, name="native"), "two readers called 'native'"),
    ):
        installed(loaded)
        with pytest.raises(ConfigError, match=word):
            readers()


def test_a_map_that_is_not_there_is_found_before_anything_is_written(tmp_path: Path) -> None:
    run = RunConfig(("constant_speed",), log=LogSettings(map=str(tmp_path / "none.osm")))
    write_scenario(tmp_path / "log.mcap", SCENARIO)
    with pytest.raises(ConfigError, match=r"none\.osm: no such map"):
        evaluate_logs([tmp_path / "log.mcap"], run, tmp_path / "out")
    assert not (tmp_path / "out").exists()
