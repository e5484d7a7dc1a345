from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from drives import along, drive, scenario
from typer.testing import CliRunner

from logs import Mode
from metrics import GROUPS, METRICS, evaluate
from metrics.metric import Metric
from replay.cli import app

PAGE = Path(__file__).parents[2] / "docs" / "metrics.md"


def said(*words: str) -> str:
    result = CliRunner().invoke(app, ["metrics", *words])
    assert result.exit_code == 0, result.output
    return result.output


def test_the_page_is_what_the_command_prints() -> None:
    assert PAGE.read_text() == said("--markdown"), "replan metrics --markdown > docs/metrics.md"


def test_the_list_names_every_metric_under_its_group() -> None:
    lines = said().splitlines()
    assert [line for line in lines if line and not line.startswith(" ")] == list(GROUPS)
    assert [line.split()[0] for line in lines if line.startswith(" ")] == list(METRICS)


@pytest.mark.parametrize("metric", METRICS.values(), ids=METRICS.keys())
def test_a_metrics_page_says_all_about_it(metric: Metric) -> None:
    text = said(metric.name)
    assert metric.formula
    for told in (metric.formula, metric.meaning, metric.unit, metric.source, *metric.parameters, metric.needs):
        assert told in text
    for reduction in metric.reductions:
        assert reduction.name in text
    assert not any(mark in metric.formula for mark in "`\n")


def test_what_needs_nothing_is_always_available() -> None:
    log = scenario(along(np.zeros(1), 10.0), duration=5.0)
    free = {metric.name: metric for metric in METRICS.values() if not metric.needs}
    assert {"collision", "completed", "distance"} <= free.keys()
    for mode in Mode:
        assert evaluate(drive(log, mode=mode), log, metrics=free)["available"].all()


def test_a_page_of_ones_own_metric_and_of_none() -> None:
    assert "For a test." in said("metrics_of_mine:MINE")
    result = CliRunner().invoke(app, ["metrics", "gpa"])
    assert result.exit_code == 2
    assert "gpa" in result.output
