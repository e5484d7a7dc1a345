"""`replan mine | query | cut | suite | coverage`: tables, moments as logs, refusals in one line."""

import json
import re
import shutil
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from command_line import one_error, replan
from hypothesis import given, strategies as st

from replan.core.errors import ConfigError
from replan.logs.catalogue import scenario
from replan.logs.mcap import write_scenario
from replan.logs.readers import read_log
from replan.mine.coverage import CELL, cells_of, missing_cells
from replan.mine.driven_log import Event, EventKind
from replan.mine.event_page import MOST_OF_A_KIND, PAGE, PICTURES, picture_of
from replan.mine.mine import EVENTS, HEALTH, LOGS
from replan.mine.mined_log import mine_log
from replan.mine.suite import ChosenLog, smallest_cover, suite_writer
from replan.results.tables import write_parquet
from replan.run.sources import suite_file

pytest.importorskip("duckdb")
NAMES = ("everyday/cut_in", "everyday/crosswalk", "paper/free_road")
BRISK = EventKind(
    "brisk", lambda log: [Event(0.0, 1.0, float(log.ego.v.max()))], "Always.", "speed", "m/s"
)
BROKEN = EventKind("broken", lambda log: 1 / 0, "Never.")  # type: ignore[arg-type, return-value]
UNREAL = EventKind("unreal", lambda log: [Event(5.0, 1.0, 0.0)], "Ends before it begins.")


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("logs")
    for name in NAMES:
        write_scenario(folder / f"{name.replace('/', '_')}.mcap", scenario(name))
    return folder


@pytest.fixture(scope="module")
def mined(logs: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("mined") / "run"
    assert replan("mine", logs, "-o", out, "--workers", 0).exit_code == 0
    return out


def test_the_tables_do_not_depend_on_the_workers(logs: Path, mined: Path, tmp_path: Path) -> None:
    replan("mine", logs, "-o", tmp_path / "two", "--workers", 2)
    for name in (EVENTS, LOGS, HEALTH, PAGE):
        assert (tmp_path / "two" / name).read_bytes() == (mined / name).read_bytes()


def test_each_event_is_a_row_of_the_page_and_the_first_of_a_kind_have_a_picture(
    mined: Path,
) -> None:
    events, logs = pd.read_parquet(mined / EVENTS), pd.read_parquet(mined / LOGS).set_index("log")
    page = (mined / PAGE).read_text(encoding="utf-8")
    assert page.count("<tr><td>") == len(events)
    pictures = {file.relative_to(mined).as_posix() for file in mined.glob(f"{PICTURES}/*/*.svg")}
    assert pictures == set(re.findall(r'<img class="event" src="([^"]+)"', page))
    drawn = events.groupby(["log", "kind"]).head(MOST_OF_A_KIND)
    assert {
        picture_of(row, logs.loc[row["log"], "sha256"]) for row in drawn.to_dict("records")
    } == pictures
    for row in drawn.to_dict("records"):
        picture = ElementTree.parse(mined / picture_of(row, logs.loc[row["log"], "sha256"]))
        pointed = [item for item in picture.iter() if item.get("class") == "pointed_out"]
        assert len(pointed) <= len(row["agents"])
        assert pointed or row["kind"] not in ("cut_in", "pedestrian_crossing")


def test_kinds_that_a_log_lacks_data_for_are_named(mined: Path) -> None:
    table = pd.read_parquet(mined / LOGS).set_index("log")
    assert any(line.startswith("red_light: ") for line in table.loc["paper/free_road", "not_asked"])
    events = pd.read_parquet(mined / EVENTS)
    assert set(events["kind"]) >= {"cut_in", "pedestrian_crossing", "crosswalk"}
    assert (events["t_from_s"] <= events["t_to_s"]).all()


def test_a_log_that_cannot_be_read_costs_itself(logs: Path, tmp_path: Path) -> None:
    (tmp_path / "bad.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(40))
    result = replan("mine", tmp_path / "bad.mcap", logs, "-o", tmp_path / "out", "--workers", 0)
    assert result.exit_code == 3 and "bad.mcap" in one_error(result)
    table = pd.read_parquet(tmp_path / "out" / LOGS)
    assert len(table) == len(NAMES) + 1 and (table["error"] != "").sum() == 1


def test_a_kind_of_a_user_is_found_and_a_broken_one_costs_itself(
    logs: Path, tmp_path: Path
) -> None:
    own = [
        word for name in ("BRISK", "BROKEN", "UNREAL") for word in ("--kind", f"{__name__}:{name}")
    ]
    result = replan(
        "mine", logs / "paper_free_road.mcap", "-o", tmp_path / "out", "--workers", 0, *own
    )
    assert result.exit_code == 3
    assert (
        "event kind 'broken': raised by code that the run names: ZeroDivisionError" in result.stderr
    )
    assert "event kind 'unreal'" in result.stderr
    events = pd.read_parquet(tmp_path / "out" / EVENTS)
    assert events["kind"].tolist() == ["brisk"] and events["unit"].tolist() == ["m/s"]
    assert "no event kind is called 'nix'" in one_error(replan("mine", logs, "--kind", "nix"))


def test_a_planner_adds_events_where_its_plans_differ(logs: Path, tmp_path: Path) -> None:
    replan(
        "mine",
        logs / "everyday_cut_in.mcap",
        "-o",
        tmp_path / "out",
        "--workers",
        0,
        "-p",
        "constant_speed",
    )
    events = pd.read_parquet(tmp_path / "out" / EVENTS)
    assert set(events.query("planner != ''")["kind"]) <= {
        "plan_differs",
        "plan_flips",
        "plan_falls_back",
    }
    assert (events["planner"] == "constant_speed").any()


def test_a_query_gives_rows_in_each_form(mined: Path, tmp_path: Path) -> None:
    sql = "SELECT kind, count(*) AS n FROM events GROUP BY kind ORDER BY kind"
    rows = json.loads(replan("query", mined, sql, "--json").stdout)
    expected = pd.read_parquet(mined / EVENTS)["kind"].value_counts().sort_index()
    assert {row["kind"]: row["n"] for row in rows} == expected.to_dict()
    for ending, read in (
        (".csv", pd.read_csv),
        (".parquet", pd.read_parquet),
        (".json", pd.read_json),
    ):
        replan("query", mined, sql, "-o", tmp_path / f"rows{ending}")
        assert read(tmp_path / f"rows{ending}")["n"].tolist() == expected.tolist()
    assert "rows.txt: name a file that ends in" in one_error(
        replan("query", mined, sql, "-o", tmp_path / "rows.txt")
    )


@pytest.mark.parametrize(
    "sql",
    [
        "COPY events TO '{secret}'",
        "DROP TABLE events",
        "SELECT 1; SELECT 2",
        "ATTACH '{secret}.db'",
        "INSTALL httpfs",
        "SET enable_external_access = true",
        "SELECT * FROM read_csv('{secret}')",
        "SELECT * FROM '{secret}'",
        "SELECT * FROM glob('{folder}/*')",
        "SELECT * FROM read_text('{secret}')",
        "PRAGMA database_list",
        "CREATE TABLE x AS SELECT * FROM events",
        "SELECT * FROM sqlite_scan('{secret}', 'x')",
        "SELECT getenv('HOME')",
        "EXPORT DATABASE '{folder}/db'",
        "LOAD '{secret}'",
        "SELECT",
        "SELECT * FROM evnts",
        "SELECT nix FROM events",
    ],
)
def test_a_hostile_query_is_one_line_and_reaches_no_file(
    mined: Path, tmp_path: Path, sql: str
) -> None:
    secret = tmp_path / "secret.csv"
    secret.write_text("key\nhunter2\n", encoding="utf-8")
    before = sorted(tmp_path.iterdir())
    result = replan("query", mined, sql.format(secret=secret, folder=tmp_path))
    assert result.exit_code == 2
    assert "hunter2" not in one_error(result) + result.stdout
    assert (
        sorted(tmp_path.iterdir()) == before
        and secret.read_text(encoding="utf-8") == "key\nhunter2\n"
    )


def test_the_tables_of_a_run_are_views_too(tmp_path: Path) -> None:
    words = (
        "--suite",
        "paper/free_road",
        "--planner",
        "constant_speed",
        "--mode",
        "closed",
        "--no-recording",
    )
    replan("evaluate", *words, "--out", tmp_path / "run", "--workers", 0)
    sql = (
        "SELECT count(*) AS n FROM metrics JOIN drives USING (log, planner, mode) WHERE metric = "
        "'ttc.min'"
    )
    assert json.loads(replan("query", tmp_path / "run", sql, "--json").stdout) == [{"n": 1}]
    assert "The views are metrics, verdicts" in one_error(
        replan("query", tmp_path / "run", "SELECT * FROM events")
    )
    cut = replan(
        "cut",
        tmp_path / "run",
        "--table",
        "metrics",
        "--where",
        "metric = 'lon_accel.max_abs'",
        "-o",
        tmp_path / "cuts",
    )
    assert cut.exit_code == 0 and len(list((tmp_path / "cuts").glob("*.mcap"))) == 1


def test_a_cut_is_the_log_at_that_moment_with_its_origin(
    logs: Path, mined: Path, tmp_path: Path
) -> None:
    words = ("--where", "kind = 'cut_in'", "--before", 2, "--after", 3, "-o", tmp_path / "cuts")
    assert replan("cut", mined, *words).exit_code == 0
    (file,) = (tmp_path / "cuts").glob("*.mcap")
    part, whole = read_log(file), read_log(logs / "everyday_cut_in.mcap")
    event = pd.read_parquet(mined / EVENTS).query("kind == 'cut_in'").iloc[0]
    begin = event["t_from_s"] - 2.0
    assert part.metadata["cut.of"] == whole.name and "cut_in" in part.tags
    assert part.duration == pytest.approx(event["t_to_s"] + 3.0 - begin, abs=0.2)
    at = np.linspace(0.5, part.ego.t[-1] - 0.5, 7)
    assert np.interp(at, part.ego.t, part.ego.x) == pytest.approx(
        np.interp(at + begin, whole.ego.t, whole.ego.x), abs=0.05
    )
    (tmp_path / "cuts" / "notes.txt").touch()
    assert "contains notes.txt" in one_error(replan("cut", mined, *words))
    nothing = replan("cut", mined, "--where", "kind = 'nix'", "-o", tmp_path / "none")
    assert "nothing to cut" in one_error(nothing) and not (tmp_path / "none").exists()


def test_a_suite_can_be_evaluated_and_a_foreign_file_is_refused(
    mined: Path, tmp_path: Path
) -> None:
    file = tmp_path / "suite.toml"
    assert replan("suite", mined, "-o", file).exit_code == 0
    quick = ("--planner", "constant_speed", "--mode", "closed", "--no-recording", "--workers", 0)
    replan("evaluate", "--suite", file, "--out", tmp_path / "run", *quick)
    summary = json.loads((tmp_path / "run" / "summary.json").read_text(encoding="utf-8"))
    assert {log["log"] for log in summary["logs"]} == {"everyday/cut_in", "everyday/crosswalk"}
    file.write_text("logs = 3\n", encoding="utf-8")
    assert "a suite has one key, logs" in one_error(
        replan("evaluate", "--suite", file, "--out", tmp_path / "no")
    )
    assert "this command did not write it" in one_error(replan("suite", mined, "-o", file))
    assert file.read_text(encoding="utf-8") == "logs = 3\n"
    assert "holds no mined logs" in one_error(
        replan("suite", tmp_path / "run", "-o", tmp_path / "new.toml")
    )


NAMES_OF_LOGS = st.text(
    st.characters(codec="utf-8", exclude_categories=["Cs"]), min_size=1, max_size=20
)


@given(name=NAMES_OF_LOGS, folder=st.sampled_from(["a b", 'a"b', "a'b#", "ä\\b", "a\nb"]))
def test_a_suite_names_logs_of_any_name(
    tmp_path_factory: pytest.TempPathFactory, name: str, folder: str
) -> None:
    place = tmp_path_factory.mktemp("suite")
    log = place / folder / "log.mcap"
    log.parent.mkdir()
    log.touch()
    (place / "suites").mkdir()
    with suite_writer(place / "suites" / "suite.toml") as write:
        write(
            [
                ChosenLog(name, f"{folder}/log.mcap", 1, ""),
                ChosenLog("other", "s3://bucket/x.mcap", 1, "a gate"),
            ],
            place,
        )
    sources, url = suite_file(place / "suites" / "suite.toml")
    assert Path(sources).resolve() == log.resolve() and url == "s3://bucket/x.mcap"
    assert not Path(
        tomllib.loads((place / "suites" / "suite.toml").read_text("utf-8"))["logs"][0]
    ).is_absolute()


def test_a_suite_without_its_logs_is_refused(
    mined: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copied = Path(shutil.copytree(mined, tmp_path / "copied"))
    (copied / "origin.json").unlink()
    table = pd.read_parquet(copied / LOGS)
    write_parquet(copied / LOGS, table.assign(source=[f"gone/{k}.mcap" for k in range(len(table))]))
    monkeypatch.chdir(tmp_path)
    assert "the log of these results is not at" in one_error(
        replan("suite", copied, "-o", tmp_path / "suite.toml")
    )
    assert not (tmp_path / "suite.toml").exists()


def test_a_planner_with_settings_is_mined_and_one_that_cannot_be_built_costs_its_rows(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ("mine", logs / "paper_free_road.mcap", "--workers", 0, "-p", "dp_qp")
    assert replan(*words, "-o", tmp_path / "out").exit_code == 0

    def refuse(*args: object) -> None:
        raise ConfigError("planner 'dp_qp' cannot be built: no")

    monkeypatch.setattr("replan.config.RunConfig.planner_keywords", refuse)
    result = replan(*words, "-o", tmp_path / "out")
    assert result.exit_code == 3 and "cannot be built" in one_error(result)
    assert len(pd.read_parquet(tmp_path / "out" / LOGS)) == 1


@pytest.mark.parametrize(
    ("limit", "value", "sql", "message"),
    [
        (
            "TIME_S",
            0.3,
            "SELECT count(*) FROM range(10000000000) a, range(1000) b",
            "takes more than 0.3 s",
        ),
        ("RESULT_GB", 0.001, "SELECT * FROM range(1000000)", "gives more than 0.001 GB: add LIMIT"),
        ("TIME_S", 300.0, " ", "the query is empty"),
    ],
)
def test_a_query_has_limits(
    mined: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    limit: str,
    value: float,
    sql: str,
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(f"replan.mine.query.{limit}", value)
    result = replan("query", mined, sql)
    assert result.exit_code == 2 and message in one_error(result) and not list(tmp_path.iterdir())


def test_wrong_options_of_mining_are_one_line(mined: Path, tmp_path: Path) -> None:
    assert "--where is empty" in one_error(
        replan("cut", mined, "--where", " ", "-o", tmp_path / "out")
    )
    assert "name logs, or logs of the catalogue" in one_error(
        replan("mine", "-o", tmp_path / "out")
    )
    assert "it has mined logs" in one_error(replan("report", mined))
    assert not list(tmp_path.iterdir())


def test_a_log_is_not_mined_again(
    logs: Path, mined: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = Path(shutil.copytree(mined, tmp_path / "out"))
    (out / EVENTS).unlink()
    lines = (out / "study.jsonl").read_text(encoding="utf-8").splitlines(keepends=True)
    (out / "study.jsonl").write_text("".join(lines[:3]) + lines[3][:50], encoding="utf-8")
    seen, once = [], mine_log
    monkeypatch.setattr(
        "replan.mine.mine.mine_log",
        lambda source, **more: seen.append(source) or once(source, **more),
    )
    assert replan("mine", logs, "-o", out, "--workers", 0, "--resume").exit_code == 0
    assert len(seen) == len(NAMES) - 2
    for name in (EVENTS, LOGS, HEALTH, "study.jsonl"):
        assert (out / name).read_bytes() == (mined / name).read_bytes()


def test_coverage_names_the_cells_of_the_other_set_that_are_missing(
    mined: Path, logs: Path, tmp_path: Path
) -> None:
    replan("mine", logs / "everyday_crosswalk.mcap", "-o", tmp_path / "few", "--workers", 0)
    result = replan("coverage", tmp_path / "few", "--against", mined)
    assert "cut_in" in result.stdout and "everyday/cut_in" in result.stdout
    table = pd.read_csv(tmp_path / "few" / "coverage.csv")
    assert set(table[~table["covered"]]["kind"]) >= {"cut_in"}
    assert (tmp_path / "few" / "coverage.png").stat().st_size > 5_000


CELLS = st.frozensets(st.tuples(st.sampled_from("abcd"), st.sampled_from("xyz")), max_size=6)


@given(st.dictionaries(st.sampled_from("pqrstu"), CELLS, min_size=1))
def test_a_cover_has_all_cells_and_each_log_of_it_adds_one(
    sets: dict[str, frozenset[tuple[str, ...]]],
) -> None:
    chosen = smallest_cover(sets, dict.fromkeys(sets, (False, 1.0)))
    seen: set[tuple[str, ...]] = set()
    for log in chosen:
        assert sets[log] - seen
        seen |= sets[log]
    assert seen == set().union(*sets.values())
    assert chosen == smallest_cover(dict(reversed(sets.items())), dict.fromkeys(sets, (False, 1.0)))


@given(
    st.lists(st.tuples(*(st.sampled_from("ab") for _ in CELL), st.sampled_from("pq")), max_size=12)
)
def test_a_set_lacks_no_cell_that_it_has(rows: list[tuple[str, ...]]) -> None:
    events = pd.DataFrame(rows, columns=[*CELL, "log"])
    covered = cells_of(events)
    assert covered["events"].sum() == len(events) and missing_cells(covered, covered).empty
    assert len(missing_cells(cells_of(events.iloc[:0]), covered)) == len(covered)
