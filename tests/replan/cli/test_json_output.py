"""`--json`: one document on stdout, and what goes to which stream when there is an error."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from command_line import evaluate, one_error, replan

from replan.logs.catalogue import FAMILIES
from replan.logs.vehicle import vehicle_names
from replan.metrics import METRICS


def names_in(document: object) -> Iterator[str]:
    """The names of the entries of a document."""
    entries = document if isinstance(document, list) else [document]
    for entry in entries:
        if isinstance(entry, dict) and isinstance(entry.get("name"), str):
            yield entry["name"]


@pytest.mark.parametrize(
    ("words", "holds"),
    [
        (("list",), lambda document: document["planners"][0]["name"] == "dp_qp"),
        (
            ("list", "cars"),
            lambda document: [entry["name"] for entry in document] == list(vehicle_names()),
        ),
        (("metrics",), lambda document: [entry["name"] for entry in document] == list(METRICS)),
        (
            ("metrics", "gap"),
            lambda document: document["unit"] == "m" and "min" in document["reductions"],
        ),
        (
            ("synth", "--list"),
            lambda document: {entry["name"] for entry in document["families"]} == FAMILIES.keys(),
        ),
        (
            ("convert", "--formats"),
            lambda document: "native" in [entry["name"] for entry in document],
        ),
        (("vary", "--list"), lambda document: "speed" in [entry["name"] for entry in document]),
        (("falsify", "--list"), lambda document: "speed" in [entry["name"] for entry in document]),
        (
            ("falsify", "paper/crossing_pedestrian", "--list-agents"),
            lambda document: document[0]["kind"] == "pedestrian",
        ),
        (
            ("vary", "paper/crossing_pedestrian", "--list-agents"),
            lambda document: document[0]["kind"] == "pedestrian",
        ),
        (
            ("inspect", "{free}"),
            lambda document: (
                document["scenario"]["name"] == "test/free" and document["health"] == []
            ),
        ),
    ],
)
def test_json_is_one_document_with_the_names_of_the_words(
    folder: Path, words: tuple[str, ...], holds: Callable[[Any], bool]
) -> None:
    result = replan(*(word.format(free=folder / "free.mcap") for word in words), "--json")
    assert result.exit_code == 0
    document = json.loads(result.stdout)
    assert holds(document)
    shown = replan(*(word.format(free=folder / "free.mcap") for word in words))
    assert shown.exit_code == 0
    for name in names_in(document):
        assert name in shown.stdout


def test_errors_leave_stdout_empty() -> None:
    for words in (
        ("synth", "all", "--json"),
        ("convert", "x", "--json"),
        ("evaluate", "nowhere", "--json", "-q"),
    ):
        result = replan(*words)
        assert (result.exit_code, result.stdout) == (2, "")
        assert one_error(result)


def test_a_damaged_log_is_an_error_in_json_and_with_quiet(folder: Path, tmp_path: Path) -> None:
    bad = tmp_path / "bad.mcap"
    bad.write_bytes((folder / "free.mcap").read_bytes()[:-100])
    inspected = replan("inspect", bad, "--json")
    assert inspected.exit_code == 3
    assert "bad.mcap" in json.loads(inspected.stdout)["error"]
    quiet = evaluate(bad, folder / "free.mcap", "-q", "--out", tmp_path / "out")
    assert str(bad) in one_error(quiet)
    assert quiet.stderr.count("\n") == 1
    assert quiet.stdout.splitlines() == [
        f"Outcome: NOT ALL COULD BE EVALUATED (exit code 3); results: {tmp_path / 'out'}"
    ]
