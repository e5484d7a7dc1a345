"""Edited results: one line and a documented exit code, and nothing outside of the output is
touched.
"""

import json
import random
import shlex
import shutil
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from command_line import one_error, replan
from edited import edit
from hypothesis import given, settings, strategies as st
from short_logs import write_free_and_blocked

from replan.compare_runs import BASELINE
from replan.core.errors import ConfigError
from replan.draw.drawn_results import load
from replan.mine.mine import read_mined
from replan.results.schema import read_table
from replan.run.output import begun_in

pytest.importorskip("duckdb")
COMMANDS = {
    "run": (
        "report {it} -o {out}",
        "compare {it} {run} --no-first-difference",
        "cut {it} --table verdicts --where true -o {out}",
        "query {it} 'SELECT count(*) AS n FROM metrics, verdicts, groups, logs, drives, gates, "
        "failures'",
        "query {it} 'SELECT max(value) AS v FROM frames'",
        "query {it} 'SELECT max(seconds) AS s FROM timings'",
        "diagnose {it} -o {out} --workers 0",
        "baseline {it} -o {out}.parquet",
        "explain {it}",
        "evaluate {logs} -p constant_speed --no-recording --workers 0 -o {it} --resume",
    ),
    "mined": (
        "query {it} 'SELECT count(*) AS n FROM events, logs, health'",
        "cut {it} --where true -o {out}",
        "suite {it} -o {out}.toml",
        "coverage {it} --against {mined}",
        "mine {logs} --workers 0 -o {it} --resume",
    ),
    "baseline.parquet": ("compare {it} {run}", "report {run} --baseline {it} -o {out}"),
}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of two logs, its baseline, and the logs mined."""
    place = tmp_path_factory.mktemp("results")
    write_free_and_blocked(place / "logs")
    quick = ("-p", "constant_speed", "--workers", 0, "--no-recording")
    replan("evaluate", place / "logs", *quick, "-o", place / "run")
    replan("baseline", place / "run", "-o", place / "baseline.parquet")
    replan("mine", place / "logs", "--workers", 0, "-o", place / "mined")
    return place


@pytest.mark.parametrize("name", COMMANDS)
@settings(max_examples=60)
@given(seed=st.integers(0, 10**9))
def test_edited_results_are_one_line_and_nothing_outside_is_written(
    place: Path, tmp_path_factory: pytest.TempPathFactory, name: str, seed: int
) -> None:
    work, rng = tmp_path_factory.mktemp("work"), random.Random(seed)
    it, out = work / "in" / name, work / "deep" / "out" / "it"
    it.parent.mkdir()
    (shutil.copy if (place / name).is_file() else shutil.copytree)(place / name, it)
    edit(rng, it)
    words = shlex.split(rng.choice(COMMANDS[name]))
    places = {
        "run": place / "run",
        "mined": place / "mined",
        "logs": place / "logs",
        "it": it,
        "out": out,
    }
    result = replan(*(word.format(**places) for word in words))
    assert result.exit_code in (0, 1, 2, 3, 4) and "Traceback" not in result.stderr
    assert result.exit_code != 2 or one_error(result)
    assert {path.name for path in work.iterdir()} <= {"in", "deep"}
    assert not (work / "deep").exists() or [path.name for path in (work / "deep").iterdir()] == [
        "out"
    ]
    shutil.rmtree(work)


@pytest.mark.parametrize("folder", ["../../..", "/tmp", "..", "a/b", "a\\b", "a\0b", " ", "x\n"])
def test_a_folder_in_a_summary_is_a_plain_name(place: Path, tmp_path: Path, folder: str) -> None:
    run = Path(shutil.copytree(place / "run", tmp_path / "a" / "b" / "c" / "run"))
    summary = json.loads((run / "summary.json").read_text(encoding="utf-8"))
    for log in summary["logs"]:
        log["folder"] = folder
    (run / "summary.json").write_text(json.dumps(summary), encoding="utf-8")
    before = sorted(tmp_path.rglob("*"))
    for words in (
        ("diagnose", run, "--workers", 0, "-o", tmp_path / "out"),
        ("report", run),
        ("explain", run),
    ):
        result = replan(*words)
        assert result.exit_code == 2 and "summary.json: is not as replan writes it" in one_error(
            result
        )
    assert sorted(tmp_path.rglob("*")) == before


def test_another_version_is_refused_in_every_file(place: Path, tmp_path: Path) -> None:
    readers = {
        "run/summary.json": load,
        "mined/mined.json": read_mined,
        "run/origin.json": lambda run: begun_in(run, ["x"]),
    }
    for name, read in readers.items():
        source, _, file = name.partition("/")
        folder = Path(shutil.copytree(place / source, tmp_path / file))
        card = json.loads((folder / file).read_text(encoding="utf-8"))
        (folder / file).write_text(json.dumps({**card, "schema_version": 99}), encoding="utf-8")
        with pytest.raises(ConfigError, match=f"{file}: is of version 99, this replan reads"):
            read(folder)


def test_an_unknown_column_is_left_out(place: Path, tmp_path: Path) -> None:
    table = pq.read_table(place / "run" / "metrics.parquet")
    pq.write_table(table.append_column("new", table["log"]), tmp_path / "metrics.parquet")
    assert read_table(tmp_path / "metrics.parquet").column_names == table.column_names


@pytest.mark.parametrize("name", ["run", "mined"])
def test_deep_nesting_is_one_line(place: Path, tmp_path: Path, name: str) -> None:
    folder = Path(shutil.copytree(place / name, tmp_path / name))
    for file in folder.glob("*.json"):
        file.write_text("[" * 100_000, encoding="utf-8")
    assert one_error(
        replan("cut", folder, "--where", "true", "--table", "logs", "-o", tmp_path / "out")
    )


@pytest.mark.parametrize("odd", [float("inf"), float("-inf")])
def test_a_baseline_without_finite_values_is_refused(
    place: Path, tmp_path: Path, odd: float
) -> None:
    table = pq.read_table(place / "baseline.parquet")
    rows = table.to_pandas()
    rows.loc[rows["available"], "value"] = odd
    edited = pa.Table.from_pandas(rows, table.schema, preserve_index=False)
    pq.write_table(
        edited.replace_schema_metadata({BASELINE: table.schema.metadata[BASELINE]}),
        tmp_path / "b.parquet",
    )
    result = replan("compare", tmp_path / "b.parquet", place / "run")
    assert result.exit_code == 3 and "column value has infinite values" in one_error(result)


def test_what_is_written_is_read(place: Path) -> None:
    run = load(place / "run")
    assert (
        len(run.metrics)
        and len(run.groups)
        and len(run.timings)
        and len(run.frames)
        and len(run.verdicts)
    )
    assert run.timings["log"].dtype == "category" and pd.api.types.is_float_dtype(
        run.metrics["value"]
    )
