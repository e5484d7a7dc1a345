"""Tables in: from pandas frames, from CSV and Parquet, with other names and units.

What is wrong is named.
"""

import os
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from any_bytes import CHANGES, changed, read_or_refused
from differences import differences
from hypothesis import HealthCheck, given, settings, strategies as st

import replan
from replan.config import RunConfig
from replan.core.errors import LogError
from replan.logs.agents import AgentKind
from replan.logs.mcap import read_scenario, write_scenario
from replan.logs.readers import LogSettings, read_log, reader_of
from replan.logs.readers.columns import DIMENSIONS, UNITS
from replan.logs.readers.table import from_frames
from replan.logs.summary import summarise
from replan.logs.vehicle import VehicleParameters
from replan.run import evaluate_logs

T = np.arange(0.0, 6.01, 0.1)


def ego(**more: Any) -> pd.DataFrame:
    return pd.DataFrame(
        {"t": 100.0 + T, "x": 5000.0 + 8.0 * T, "y": 200.0, "yaw": 0.0, "v": 8.0, **more}
    )


def agents(**more: Any) -> pd.DataFrame:
    one = {
        "t": 100.0 + T,
        "id": "b",
        "x": 5030.0 + 6.0 * T,
        "y": 200.0,
        "yaw": 0.0,
        "vx": 6.0,
        "vy": 0.0,
    }
    two = {
        "t": 101.0 + T[:20],
        "id": "a",
        "x": 5020.0,
        "y": 203.0 - T[:20],
        "yaw": -1.5,
        "vx": 0.0,
        "vy": -1.0,
    }
    frames = [pd.DataFrame({**one, "kind": "car"}), pd.DataFrame({**two, "kind": "person"})]
    return pd.concat(frames, ignore_index=True).assign(**more)


def test_ten_lines_make_a_log_that_is_evaluated(tmp_path: Path) -> None:
    scenario = replan.from_frames(ego(), agents(), name="mine")
    replan.write_log(tmp_path / "mine.mcap", scenario)
    assert differences(read_scenario(tmp_path / "mine.mcap"), scenario) == []
    result = evaluate_logs(
        [tmp_path / "mine.mcap"], RunConfig(("logged",), recording=False), tmp_path / "out"
    )
    assert result.failures.empty and len(result.drives) == 2


def test_a_converted_log_does_not_claim_a_vehicle_that_was_assumed(tmp_path: Path) -> None:
    for name, vehicle in (("assumed", None), ("theirs", VehicleParameters(mass=2000.0))):
        replan.write_log(tmp_path / f"{name}.mcap", from_frames(ego(), vehicle=vehicle))
        said = "\n".join(summarise(tmp_path / f"{name}.mcap").lines())
        assert ("tracking: the log's vehicle" in said) is (vehicle is not None)


def test_frames_times_and_sizes_are_as_documented() -> None:
    scenario = from_frames(ego(), agents())
    assert scenario.origin == (5000.0, 200.0) and scenario.start_ns == 100_000_000_000
    assert scenario.ego.x == pytest.approx(8.0 * T) and scenario.ego.t == pytest.approx(T)
    assert scenario.tracks.ids == ("a", "b")
    assert scenario.tracks.kinds == (AgentKind.PEDESTRIAN, AgentKind.CAR)
    assert scenario.tracks.length.tolist() == [0.5, 4.5]
    assert float(scenario.tracks.t[0]) == pytest.approx(1.0)
    said = " ".join(scenario.notes)
    for word in (
        "no length",
        "no lanes",
        "does not describe the ego's vehicle",
        "no ego acceleration",
    ):
        assert word in said


@given(
    st.sampled_from(
        [("x", u) for u in DIMENSIONS["length"]]
        + [("yaw", u) for u in DIMENSIONS["angle"]]
        + [("v", u) for u in DIMENSIONS["speed"]]
        + [("t", u) for u in DIMENSIONS["time"]]
    ),
    st.sampled_from(["columns", "{} [{}]", "{} ({})", "{}_{}"]),
    st.permutations(range(len(T))),
)
@settings(max_examples=40, deadline=None)
def test_other_names_units_and_orders_are_the_same(
    column: tuple[str, str], header: str, order: list[int]
) -> None:
    ours, unit = column
    theirs = "theirs" if header == "columns" else header.format(ours, unit)
    table = ego(yaw=0.1).iloc[order].rename(columns={ours: theirs})
    table[theirs] = table[theirs] / UNITS[unit]
    columns = {ours: f"theirs [{unit}]"} if header == "columns" else {}
    plain, other = from_frames(ego(yaw=0.1)), from_frames(table, columns=columns)
    for name in ("t", "x", "y", "yaw", "v"):
        assert getattr(other.ego, name) == pytest.approx(getattr(plain.ego, name), abs=1e-6)


@pytest.mark.parametrize("unit", ["ns", "us", "ms"])
def test_times_may_be_integers_or_dates(unit: str) -> None:
    per = {"ns": 10**9, "us": 10**6, "ms": 10**3}[unit]
    ticks = np.round((1e9 + T) * per).astype(np.int64)
    whole = ego(t=ticks).rename(columns={"t": f"t_{unit}"})
    date = ego(t=pd.to_datetime(ticks, unit=unit))
    zoned = ego(t=pd.to_datetime(ticks, unit=unit, utc=True))
    for table in (whole, date, zoned):
        scenario = from_frames(table)
        assert scenario.start_ns == 10**18 and scenario.ego.t == pytest.approx(T, abs=1e-9)


def test_the_time_may_be_in_the_index() -> None:
    dates = pd.to_datetime(np.round((1e9 + agents()["t"]) * 1e9).astype(np.int64))
    stamped = agents(t=dates)
    whole = from_frames(ego(t=dates[: len(T)]), stamped)
    plain = from_frames(ego(), agents())
    cases = [
        (ego().set_index("t"), agents().set_index(["id", "t"]), {}, plain),
        (ego().rename(columns={"t": "s"}).set_index("s"), agents(), {"ego.t": "s"}, plain),
        (
            ego(t=dates[: len(T)]).set_index("t").rename_axis(None),
            stamped.set_index("t").rename_axis("stamp"),
            {},
            whole,
        ),
    ]
    for own, others, columns, same in cases:
        made = from_frames(own, others, columns=columns)
        assert differences(made.ego, same.ego) == [] and made.start_ns == same.start_ns
        assert differences(made.tracks, same.tracks) == []
    taken = from_frames("b", agents().set_index("t"))
    assert differences(taken.ego, from_frames("b", agents()).ego) == []


def test_dates_with_and_without_a_time_zone_are_not_mixed() -> None:
    ticks = np.round((1e9 + T) * 1e9).astype(np.int64)
    naive = pd.Series(pd.to_datetime(ticks))
    aware = naive.dt.tz_localize("Europe/Berlin")
    one = agents().iloc[: len(T)]
    for own, others, topic in ((aware, naive, "agents"), (naive, aware, "ego")):
        for texts in (False, True):
            times = (own.astype(str), others.astype(str)) if texts else (own, others)
            with pytest.raises(
                LogError, match=f"topic {topic}: its times have no time zone.*tz_local"
            ):
                from_frames(ego(t=times[0]), one.assign(t=times[1]))
    both = naive.astype(str).where(T < 3.0, naive.astype(str) + "Z")
    with pytest.raises(LogError, match="dates with a time zone, and without"):
        from_frames(ego(t=both))
    for column in (aware, aware.astype(str), naive.astype(str)):
        assert len(from_frames(ego(t=column), one.assign(t=column)).tracks) == 1


def test_what_is_missing_is_derived_causally_and_noted() -> None:
    bare = from_frames(ego().drop(columns="v"), agents().drop(columns=["yaw", "vx", "vy", "kind"]))
    assert bare.ego.v == pytest.approx(8.0) and "no ego speed" in " ".join(bare.notes)
    walker, car = bare.tracks.samples(0), bare.tracks.samples(1)
    assert bare.tracks.yaw[walker][5:] == pytest.approx(-np.pi / 2) and bare.tracks.yaw[
        car
    ] == pytest.approx(0.0)
    assert bare.tracks.perceived(3.0).speed == pytest.approx([1.0, 6.0], abs=1e-6)
    assert any("taken for cars" in note for note in bare.notes)
    with_speed = from_frames(ego(), agents(v=3.0).drop(columns=["vx", "vy"]))
    assert with_speed.tracks.perceived(3.0).speed == pytest.approx([3.0, 3.0])


@pytest.mark.parametrize(
    ("table", "others", "words"),
    [
        (ego(x=0.0, y=0.0).drop(columns="yaw"), None, "no column yaw; it has t, x, y, v; name it"),
        (ego(x="here"), None, "x is not a column of numbers"),
        (ego(y=np.nan), None, "y is not finite"),
        (ego(t=5.0), None, "two rows have the time 0 s; keep one"),
        (ego(t=1e30), None, "beyond any clock"),
        (ego().iloc[:0], None, "the table has no rows"),
        (ego(), agents(kind="dragon"), "an agent is a 'dragon'"),
        (ego(), pd.concat([agents(), agents()]), "agent a has two rows at 1 s"),
        (ego(), agents().drop(columns="id"), "no column id"),
        (
            ego(),
            agents(id=[None, *["a"] * (len(agents()) - 1)]),
            "row 0 has no id; name every agent",
        ),
    ],
)
def test_wrong_tables_are_one_clear_line(
    table: pd.DataFrame, others: pd.DataFrame | None, words: str
) -> None:
    with pytest.raises(LogError) as error:
        from_frames(table, others)
    assert words in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(("zero", "start_s"), [(0.0, 100.0), (100.0, 0.5), (105.0, 0.5)])
def test_the_zero_of_times_may_lie_anywhere(tmp_path: Path, zero: float, start_s: float) -> None:
    """The others begin half a second before the ego: whatever is negative, all stay where they were
    and are written.
    """
    scenario = from_frames(ego(t=ego().t - zero), agents(t=agents().t - 0.5 - zero))
    assert scenario.start_ns == round(1e9 * start_s)
    moved = from_frames(ego(), agents(t=agents().t - 0.5)).tracks.t
    assert moved.min() == pytest.approx(-0.5) and scenario.tracks.t == pytest.approx(
        moved, abs=1e-6
    )
    write_scenario(tmp_path / "log.mcap", scenario)
    assert read_scenario(tmp_path / "log.mcap").tracks.t == pytest.approx(moved, abs=1e-6)


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_a_folder_of_tables_is_a_log(suffix: str, tmp_path: Path) -> None:
    folder = tmp_path / "drive_7"
    folder.mkdir()
    for name, table in (
        ("ego", ego().rename(columns={"v": "speed"}).assign(speed=28.8)),
        ("agents", agents()),
    ):
        getattr(table, f"to_{suffix}")(folder / f"{name}.{suffix}", index=False)
    reader = reader_of(folder)
    assert reader is not None and reader.name == "table"
    with_car = LogSettings(columns={"v": "speed [km/h]"}, car={"width": 2.0, "length": 5.0})
    scenario = read_log(folder, with_car)
    assert (
        scenario.name == "drive_7"
        and scenario.ego.v == pytest.approx(8.0)
        and scenario.vehicle.width == 2.0
    )
    assert [topic.messages for topic in reader.contents(folder).topics] == [len(T), len(T) + 20]
    with pytest.raises(
        ValueError, match="car has no height: its keys are length, width, wheelbase, rear_overhang"
    ):
        LogSettings(car={"height": 2.0})
    with pytest.raises(LogError, match=r"unit \[parsec\] of speed is unknown"):
        read_log(folder, LogSettings(columns={"v": "speed [parsec]"}))


@given(CHANGES, st.sampled_from(["csv", "parquet"]))
@settings(
    max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_mutated_tables_are_read_or_refused(
    tmp_path: Path, changes: list[tuple[int, int]], suffix: str
) -> None:
    folder = tmp_path / suffix
    folder.mkdir(exist_ok=True)
    getattr(ego(), f"to_{suffix}")(folder / f"ego.{suffix}", index=False)
    file = folder / f"ego.{suffix}"
    file.write_bytes(changed(file.read_bytes(), changes))
    read_or_refused(folder)


def test_the_example_of_the_documentation_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (Path(__file__).parents[3] / "docs" / "bring_log.md").read_text(encoding="utf-8")
    code = page.partition("```python\n")[2].partition("```")[0]
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "docs/bring_log.md", "exec"), {})
    scenario = read_scenario(tmp_path / "mine.mcap")
    assert scenario.ego.v == pytest.approx(12.0) and scenario.tracks.perceived(
        0.2
    ).speed == pytest.approx([9.0])


def test_a_column_by_an_unknown_name_is_refused() -> None:
    with pytest.raises(
        LogError, match=r"columns has speed, which is not a known name; known: t, .*\bv\b"
    ):
        from_frames(ego(), name="bad", columns={"speed": "v"})
    with pytest.raises(LogError, match=r"no table has the column sped that v is read from"):
        from_frames(ego(), name="bad", columns={"v": "sped"})
    for wrong in ("others.v", "ego.speed"):
        with pytest.raises(
            LogError, match=rf"columns has {wrong}, which is not a known name; .*ego\.v, agents\.v"
        ):
            from_frames(ego(), agents(), columns={wrong: "v"})
    with pytest.raises(
        LogError, match=r"no table has the column yaw2 that agents\.yaw is read from"
    ):
        from_frames(
            ego().rename(columns={"yaw": "yaw2"}),
            agents(),
            columns={"yaw": "yaw2", "agents.yaw": "yaw2"},
        )


def test_the_two_tables_may_have_names_of_their_own() -> None:
    plain = from_frames(ego(), agents())
    columns = {"t": "time", "ego.x": "east [cm]", "agents.x": "px", "agents.yaw": "course [deg]"}
    mine = ego().rename(columns={"t": "time", "x": "east"})
    theirs = agents().rename(columns={"t": "time", "x": "px", "yaw": "course"})
    mine["east"], theirs["course"] = 100.0 * mine["east"], np.rad2deg(theirs["course"])
    other = from_frames(mine, theirs, columns=columns)
    for name in ("t", "x", "y", "yaw"):
        np.testing.assert_allclose(getattr(other.ego, name), getattr(plain.ego, name), atol=1e-9)
        np.testing.assert_allclose(
            getattr(other.tracks, name), getattr(plain.tracks, name), atol=1e-9
        )


@pytest.mark.parametrize(("unit", "per_s"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
@pytest.mark.parametrize("start_s", [0.0, 5.0, 1.7e9])
@pytest.mark.parametrize("rate", [1.0, 10.0, 50.0])
def test_times_without_a_unit_are_understood_by_their_steps(
    tmp_path: Path, unit: str, per_s: float, start_s: float, rate: float
) -> None:
    seconds = start_s + np.arange(20) / rate
    ticks = np.round(seconds * 1e3).astype(np.int64) * round(per_s / 1e3)
    table = pd.DataFrame({"t": ticks, "x": 8.0 * (seconds - start_s), "y": 0.0, "yaw": 0.0})
    table.to_csv(tmp_path / "ego.csv", index=False)
    read = read_log(tmp_path)
    assert read.duration == pytest.approx(19 / rate)
    assert any(f"taken for {unit}" in note for note in read.notes)
    stated = read_log(tmp_path, LogSettings(columns={"ego.t": f"t [{unit}]"}))
    assert stated.ego.t.tolist() == read.ego.t.tolist()
    assert not any("taken for" in note and "steps" in note for note in stated.notes)


def test_rounded_times_are_named(tmp_path: Path) -> None:
    t = np.arange(60) / 10
    table = ego().head(60).assign(t=np.floor(t))
    with pytest.raises(LogError, match="times are rounded: 54 of 60") as refused:
        from_frames(table)
    assert 'columns = {t = "frame [10 Hz]"}' in refused.value.remedy
    counted = table.rename(columns={"t": "second"}).assign(frame=np.arange(60))
    counted.to_csv(tmp_path / "ego.csv", index=False)
    whole = read_log(tmp_path, LogSettings(columns={"t": "frame [10 Hz]"}))
    np.testing.assert_allclose(whole.ego.t, t, atol=1e-9)


def test_the_unit_in_a_header_of_their_own_counts() -> None:
    table = ego(t=np.arange(61) * 100).rename(columns={"t": "Zeit [ms]", "v": "Tempo (km/h)"})
    table["Tempo (km/h)"] *= 3.6
    for time, speed in (
        ("Zeit [ms]", "Tempo (km/h)"),
        ("Zeit", "Tempo"),
        ("Zeit [msec]", "Tempo [kmh]"),
    ):
        scenario = from_frames(table, columns={"t": time, "v": speed})
        assert scenario.duration == 6.0 and scenario.ego.v == pytest.approx(8.0)


@pytest.mark.parametrize(
    ("header", "columns", "said"),
    [
        (
            "t [fortnight]",
            {},
            r"the unit \[fortnight\] of t \[fortnight\] is unknown; known: s, ms, us, ns",
        ),
        ("t [km/h]", {}, r"the unit \[km/h\] of t \[km/h\] is none of t"),
        ("Zeit [ms]", {"t": "Zeit [s]"}, r"Zeit \[ms\] is asked for in \[s\]; leave that unit out"),
    ],
)
def test_units_that_are_unknown_or_contradict_are_refused(
    header: str, columns: dict[str, str], said: str
) -> None:
    with pytest.raises(LogError, match=said):
        from_frames(ego().rename(columns={"t": header}), columns=columns)


@pytest.mark.parametrize(
    ("separator", "decimal"), [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ",")]
)
def test_the_separator_and_the_decimal_mark_are_found(
    tmp_path: Path, separator: str, decimal: str
) -> None:
    for name, table in (("ego", ego()), ("agents", agents())):
        table.to_csv(tmp_path / f"{name}.csv", index=False, sep=separator, decimal=decimal)
    assert (
        differences(
            replace(read_log(tmp_path), name="table"),
            from_frames(ego(), agents(), tags=("recorded", "table")),
        )
        == []
    )


def _as(kind: str, folder: Path) -> None:
    file = folder / "agents.csv"
    if kind in ("Agents.csv", "agents.CSV", "agents.csv.gz", "agents.xlsx"):
        agents().to_csv(folder / kind, index=False)
    elif kind == "folder":
        file.mkdir()
    elif kind == "pipe":
        os.mkfifo(file)
    else:
        file.symlink_to("/dev/null" if kind == "device" else "nowhere.csv")


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("link", "agents.csv is a link that leads nowhere, not a file"),
        ("folder", "agents.csv is a folder, not a file"),
        ("pipe", "agents.csv is a named pipe, not a file"),
        ("device", "agents.csv is a device, not a file"),
        (
            "Agents.csv",
            "Agents.csv is not read: the file's name is agents.csv; rename it to agents.csv",
        ),
        ("agents.CSV", "agents.CSV is not read: the file's name is agents.csv"),
        ("agents.csv.gz", "agents.csv.gz is not read: a table is agents.csv or agents.parquet"),
        ("agents.xlsx", "agents.xlsx is not read"),
    ],
)
def test_what_is_named_like_the_agents_is_read_or_refused(
    tmp_path: Path, kind: str, said: str
) -> None:
    ego().to_csv(tmp_path / "ego.csv", index=False)
    assert not len(read_log(tmp_path).tracks)
    _as(kind, tmp_path)
    with pytest.raises(LogError, match=re.escape(said)):
        read_log(tmp_path)
    assert not evaluate_logs(
        [tmp_path], RunConfig(("logged",), recording=False), tmp_path / "out"
    ).drives.size
