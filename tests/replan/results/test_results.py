"""A result folder read back: its tables are those that were written, its drives those that were
driven.
"""

import shutil
from pathlib import Path

import pandas as pd
import pyarrow.parquet as pq
import pytest
from short_logs import QUICK, short

from replan.config import RunConfig
from replan.core.errors import ConfigError
from replan.draw.drawn_results import Results, load
from replan.logs.mcap import write_scenario
from replan.logs.plan import StGraph
from replan.metrics.judge.aggregate import LogLabels, groups, standings
from replan.results.schema import (
    FRAMES,
    METADATA,
    TABLES,
    arrow,
    arrow_schema,
    markdown,
    read_table,
)
from replan.results.tables import TABLES as FILES
from replan.run import evaluate_logs

LOG = "paper/crossing_pedestrian"


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Results:
    config = RunConfig(planners=("dp_qp", "constant_speed"), recording=False)
    return evaluate_logs((), config, tmp_path_factory.mktemp("results") / "run", suite=LOG)


def test_the_tables_are_those_of_the_run(run: Results) -> None:
    result = load(run.path)
    assert result.path == run.path and result.summary == run.summary and result.run == run.run
    pd.testing.assert_frame_equal(result.metrics, run.metrics)
    assert list(result.gates["gate"]) == [gate["rule"] for gate in run.summary["gates"]]
    assert set(map(tuple, result.drives[["planner", "mode"]].to_numpy())) == set(run.run.drives)
    labels = {LOG: LogLabels(LOG, "replan catalogue", tuple(result.logs["tags"][0]))}
    assert result.labels == labels
    stand = standings(result.verdicts, result.drives, [LOG], result.run.drives)
    pd.testing.assert_frame_equal(
        result.groups, groups(result.measured, stand, labels), check_dtype=False
    )
    assert list(result.logs["family"]) == [LOG] and list(result.logs["dataset"]) == [
        "replan catalogue"
    ]
    assert set(result.frames["log"]) == {LOG} and len(result.timings) == len(run.timings)


def test_metrics_are_of_the_planners_and_the_reference_drives_are_apart(run: Results) -> None:
    """A table of them all mixed the planners' values with those of the reference drivers."""
    result = load(run.path)
    assert set(result.metrics["planner"]) == {"dp_qp", "constant_speed"}
    assert set(result.references["planner"]) >= {"driver", "careful", "parked"}
    both = pd.concat([result.metrics, result.references])
    filed = pd.read_parquet(run.path / "metrics.parquet").drop(columns="schema_version")
    keys = ["log", "planner", "mode", "metric"]
    pd.testing.assert_frame_equal(both.sort_values(keys, ignore_index=True), filed)
    peak = result.metrics.query("mode == 'closed'").pivot_table("value", "metric", "planner")
    own = result.drive(LOG, "dp_qp").metrics.set_index("metric")["value"]
    assert peak["dp_qp"]["gap.min"] == own["gap.min"]


def test_a_drive_has_its_plans_with_their_inside(run: Results) -> None:
    drive = load(run.path).drive(LOG, "dp_qp")
    plan = drive.plan(at=3.04)
    assert plan.trajectory.t[0] == pytest.approx(3.0) and drive.frame(3.04).t == pytest.approx(3.0)
    graph = next(item for item in plan.internals if isinstance(item, StGraph))
    assert graph.qp.shape == (81, 2)
    graphs = [
        item
        for frame in drive.trace.frames
        for item in frame.plan.internals
        if isinstance(item, StGraph)
    ]
    assert "pedestrian" in {obstacle.agent for graph in graphs for obstacle in graph.obstacles}
    gap = drive.metrics.set_index("metric").loc["gap.min"]
    assert (
        drive.series["gap"].min() == gap["value"] and drive.series["gap"].idxmin() == gap["time_s"]
    )
    assert drive.trace.end.value == drive.info["end"]


def test_what_is_not_there_is_named(run: Results, tmp_path: Path) -> None:
    result = load(run.path)
    for ask, words in (
        (lambda: load(tmp_path), "no results of a finished run"),
        (lambda: result.drive("paper/crossing_pedestrain"), LOG),
        (lambda: result.drive(LOG), "name a planner of dp_qp"),
        (lambda: result.drive(LOG, "idm"), "no closed loop of idm"),
        (lambda: result.drive(LOG, "dp_qp").plan(-1.0), "its first is at 0.00 s"),
        (lambda: result.drive(LOG, "dp_qp").plan(1e9), r"it ended at \d+.\d\d s: "),
    ):
        with pytest.raises(ConfigError, match=words):
            ask()


@pytest.mark.parametrize("at", [float("nan"), float("inf"), -1.0])
def test_a_time_without_a_plan_is_an_error_and_a_run_is_said_in_one_line(
    run: Results, at: float
) -> None:
    results = load(run.path)
    first = results.drives.iloc[0]
    with pytest.raises(ConfigError, match="no plan at"):
        results.drive(first["log"], first["planner"], first["mode"]).frame(at)
    assert len(repr(results)) < 300


ROOT = Path(__file__).parents[3]
RUN = RunConfig(**{**vars(QUICK), "ensemble": 1})


@pytest.fixture(scope="module", params=["logs", "nothing"])
def result(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Results:
    """A run of two logs, one of which cannot be read; and one in which nothing could be."""
    folder = tmp_path_factory.mktemp("logs")
    write_scenario(folder / "a.mcap", short("test/a", parked=True))
    (folder / "b.mcap").write_bytes((folder / "a.mcap").read_bytes()[:-80])
    if request.param == "nothing":
        (folder / "a.mcap").unlink()
    return evaluate_logs([folder], RUN, tmp_path_factory.mktemp("out") / "run")


def test_the_page_is_that_of_the_schema() -> None:
    assert (ROOT / "docs" / "results.md").read_text(encoding="utf-8") == markdown() + "\n", (
        "write it anew: head of replan/results/schema.py"
    )
    for file in FILES:
        assert f"`{file}`" in markdown(), file


def test_every_parquet_file_has_its_columns_and_types_also_without_rows(result: Results) -> None:
    found = [*result.path.glob("*.parquet"), *result.path.glob("*/*.parquet")]
    mined = {"events.parquet", "logs.parquet"}  # tests/replan/mine
    asked = {"input_use.parquet"}  # replan explain --table
    inside = {"frames.parquet", "ensemble.parquet"}
    assert {file.name for file in found} == TABLES.keys() - mined - asked - (
        set() if any(result.logs["folder"]) else inside
    )
    for file in found:
        schema = pq.read_schema(file)
        known = arrow_schema(file.name)
        expected = dict(zip(known.names, known.types, strict=True))
        if file.parent != result.path:
            expected.pop("schema_version", None)
        assert dict(zip(schema.names, schema.types, strict=True)) == expected, file
        assert list(expected) == schema.names
        assert schema.metadata == {key.encode(): value.encode() for key, value in METADATA.items()}
    csv = pd.read_csv(result.path / "metrics.csv")
    assert list(csv.columns) == [column.name for column in TABLES["metrics.parquet"].columns]


def test_every_frame_of_the_results_has_its_columns(result: Results) -> None:
    for name, table in FRAMES.items():
        assert list(getattr(result, name).columns) == [column.name for column in table.columns], (
            name
        )
    for file in ("metrics", "verdicts", "groups", "health", "timings"):
        columns = [
            column.name
            for column in TABLES[f"{file}.parquet"].columns
            if column.name != "schema_version"
        ]
        assert list(getattr(result, file).columns) == columns, file


def test_what_is_said_to_be_the_same_twice_is(result: Results, tmp_path: Path) -> None:
    again = tmp_path / "again"
    shutil.copytree(result.path, again)  # of a run: replaced
    sources = sorted({Path(source) for source in result.logs["source"]})
    evaluate_logs(sources, RUN, again)
    for file in [*result.path.glob("*.parquet"), *result.path.glob("*/*.parquet")]:
        if TABLES[file.name].same:
            assert (again / file.relative_to(result.path)).read_bytes() == file.read_bytes(), (
                file.name
            )


def test_a_column_that_the_schema_does_not_know_is_not_written() -> None:
    with pytest.raises(KeyError, match="surprise"):
        arrow("health.parquet", pd.DataFrame({"surprise": [1]}))


NEWER = {
    name: [column for column in table.columns if column.older is not None]
    for name, table in TABLES.items()
}


@pytest.mark.parametrize("name", [name for name, newer in NEWER.items() if newer])
def test_files_of_before_a_column_are_read_with_its_value_of_then(
    name: str, tmp_path: Path
) -> None:
    """Law: a table without its newer columns is read as one in which each row has their `older`
    value.
    """
    values = {
        "text": "a",
        "number": 1.0,
        "count": 1,
        "yes/no": True,
        "list": ["a"],
        "mode": "open",
        "outcome": "pass",
    }
    row = {
        column.name: [values.get(column.name, values[column.kind])] * 2
        for column in TABLES[name].columns
    }
    table, newer = arrow(name, pd.DataFrame(row)), NEWER[name]
    pq.write_table(
        table.drop_columns([c.name for c in newer]).replace_schema_metadata(METADATA),
        tmp_path / name,
    )
    found = read_table(tmp_path / name)
    assert found.schema.names == table.schema.names and found.schema.types == table.schema.types
    for column in newer:
        assert {str(value) for value in found[column.name].to_pylist()} == {str(column.older)}
