"""Runs compared from their folders and from a baseline's file.

The command line; planted regressions.
"""

import json
import re
import shlex
import shutil
from collections.abc import Callable
from dataclasses import replace
from io import StringIO
from pathlib import Path

import pandas as pd
import pytest
from command_line import replan

from replan.compare_runs import compare_runs, read_run, write_baseline
from replan.config import RunConfig
from replan.core.errors import ConfigError, LogError
from replan.draw.report.comparison_sections import verdict_sentence
from replan.draw.report.console import SafeConsole
from replan.draw.report.terminal import print_comparison
from replan.metrics.comparison import Comparison
from replan.results.tables import write_parquet
from replan.run import evaluate_logs
from studies import regressions

LOGS = ("paper/crossing_pedestrian", "paper/free_road")
CONFIG = RunConfig(planners=("constant_speed", "idm"), mode="closed", recording=False)


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two logs, two planners, and the same with commands that act 100 ms late."""
    out = tmp_path_factory.mktemp("compared")
    late = replace(CONFIG, loop=replace(CONFIG.loop, plan_delay_s=0.1))
    assert replan("synth", *LOGS, "-o", out / "logs").exit_code == 0
    for name, config in (("before", CONFIG), ("after", late)):
        evaluate_logs([out / "logs"], config, out / name)
    return out / "before", out / "after"


def of(*paths: Path, **how: object) -> Comparison:
    return compare_runs(read_run(paths[0]), read_run(paths[-1]), **how)  # type: ignore[arg-type]


def test_the_same_run_is_no_difference_as_folder_and_as_file(
    runs: tuple[Path, Path], tmp_path: Path
) -> None:
    files = tmp_path / "one.parquet", tmp_path / "two.parquet"
    for file in files:
        write_baseline(read_run(runs[0]), file)
    assert files[0].read_bytes() == files[1].read_bytes() and files[0].stat().st_size < 100_000
    for pair in ((runs[0], runs[0]), (files[0], runs[0]), (files[0], files[1])):
        found = of(*pair)
        assert (
            (found.pairs["delta"].dropna() == 0.0).all()
            and found.flips.empty
            and found.partings.empty
        )
        assert (found.differences, found.exit_code) == ((), 0)
        assert len(found.pairs) > 300 and not found.only_in_baseline and not found.only_in_candidate


@pytest.mark.slow
def test_a_delay_is_named_as_input_and_parts_in_the_controller(runs: tuple[Path, Path]) -> None:
    found = of(*runs)
    assert found.differences == ("loop.plan_delay_s: 0.0 -> 0.1",)
    assert set(found.partings["stage"]) == {"controller"} and set(found.partings["mode"]) == {
        "closed"
    }
    assert of(*runs, partings=0).partings.empty
    one = of(*runs, partings=1)
    assert len(one.partings) == 1 and one.not_looked_at == 3 and found.not_looked_at == 0


@pytest.mark.slow
def test_two_planners_of_one_run(runs: tuple[Path, Path]) -> None:
    found = of(runs[0], planners=("constant_speed", "idm"))
    assert (found.baseline, found.candidate) == ("before: constant_speed", "before: idm")
    assert set(found.pairs["planner"]) == {"constant_speed -> idm"} and found.differences == ()
    pedestrian = found.flips[found.flips["log"] == LOGS[0]].set_index("metric")
    assert (
        pedestrian.loc["completed.final", "after"]
        == "pass"
        != pedestrian.loc["completed.final", "before"]
    )
    assert set(found.partings["stage"]) <= {"plan", "start of the plan"}
    back = of(runs[0], planners=("idm", "constant_speed"), partings=0)
    assert back.exit_code == 1 and len(back.flips) == len(found.flips)
    assert set(of(*runs, planners=("idm",), partings=0).pairs["planner"]) == {"idm"}
    with pytest.raises(ConfigError, match="dp_qp"):
        of(runs[0], planners=("idm", "dp_qp"))


def test_a_missing_log_and_an_older_folder(runs: tuple[Path, Path], tmp_path: Path) -> None:
    less = tmp_path / "less"
    shutil.copytree(runs[0], less)
    summary = json.loads((less / "summary.json").read_text())
    gone = summary["logs"].pop()
    for log in summary["logs"]:
        del log["family"], log["dataset"]
    (less / "summary.json").write_text(json.dumps(summary))
    table = pd.read_parquet(less / "metrics.parquet")
    write_parquet(less / "metrics.parquet", table[table["log"] != gone["log"]])
    found = of(runs[0], less)
    assert len(found.only_in_baseline) == 2 and all(
        said.startswith(gone["log"]) for said in found.only_in_baseline
    )
    assert found.exit_code == 1 and found.verdicts[0].outcome.value == "fail"
    assert of(less, runs[0]).exit_code == 0


@pytest.fixture(scope="module")
def single(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A log, driven by a planner, and by the same one under another name."""
    out = tmp_path_factory.mktemp("single")
    assert replan("synth", LOGS[1], "-o", out / "logs").exit_code == 0
    other = "replan.planners.constant_speed:ConstantSpeed"
    for name, planner in (("before", "constant_speed"), ("after", other)):
        evaluate_logs([out / "logs"], replace(CONFIG, planners=(planner,)), out / name)
    return out / "before", out / "after"


def test_two_planners_of_other_names_pair_if_each_run_has_one(single: tuple[Path, Path]) -> None:
    found = of(*single)
    assert set(found.pairs["planner"]) == {
        "constant_speed -> replan.planners.constant_speed:ConstantSpeed"
    }
    assert (found.exit_code, found.only_in_baseline, found.unpaired) == (0, (), "")
    assert found.equal_drives == 1 and found.not_looked_at == 0 and found.partings.empty
    result = replan("compare", *single)
    assert result.exit_code == 0
    assert "1 of 1 drive are equal in bits" in result.stdout
    assert "Not searched" not in result.stdout and "not searched" not in result.stdout


def test_planners_of_other_names_are_paired_by_the_command_that_is_named(
    runs: tuple[Path, Path], single: tuple[Path, Path]
) -> None:
    found = of(runs[0], single[1])
    words = shlex.split(found.unpaired)
    assert words[:4] == ["replan", "compare", str(runs[0]), str(single[1])]
    assert found.exit_code == 1 and verdict_sentence(found).endswith(found.unpaired)
    result = replan(*words[1:])
    assert result.exit_code in (0, 1) and "no drive is in both runs" not in result.stdout


@pytest.mark.parametrize("width", [80, 120])
def test_a_comparison_begins_with_the_verdict_and_names_what_holds_once(
    runs: tuple[Path, Path], width: int
) -> None:
    found, written = of(*runs), StringIO()
    print_comparison(found, SafeConsole(file=written, width=width))
    lines = [line.rstrip() for line in written.getvalue().splitlines()]
    assert lines[1].startswith(("PASS: ", "FAIL: ", "INCONCLUSIVE: "))
    assert lines[-1] == f"Comparison: {lines[1].partition(':')[0]} (exit code {found.exit_code})"
    assert sum("hold" in line for line in lines) == 1 + lines[1].startswith("PASS")
    assert max(map(len, lines)) <= width
    text = " ".join(" ".join(lines).split())
    stages = found.partings["stage"].value_counts()
    assert len(stages) and all(f"{stage} in {count}" in text for stage, count in stages.items())


def test_unreadable_runs_are_named(runs: tuple[Path, Path], tmp_path: Path) -> None:
    damaged, foreign = tmp_path / "damaged.parquet", tmp_path / "foreign.parquet"
    write_baseline(read_run(runs[0]), damaged)
    damaged.write_bytes(damaged.read_bytes()[:-500])
    pd.DataFrame({"x": [1]}).to_parquet(foreign)
    for path, error, words in (
        (damaged, LogError, "cannot be read as a baseline"),
        (foreign, ConfigError, "is not a baseline"),
        (tmp_path / "nothing", ConfigError, "no results"),
    ):
        with pytest.raises(error, match=words):
            read_run(path)
    assert replan("baseline", runs[0], "-o", tmp_path).exit_code == 2  # a folder is there


def test_a_damaged_folder_is_an_error_in_one_line(runs: tuple[Path, Path], tmp_path: Path) -> None:
    lost = tmp_path / "lost"
    shutil.copytree(runs[1], lost)
    for trace in lost.glob("*/*.mcap"):
        trace.unlink()
    assert set(of(runs[0], lost).partings["stage"]) == {"not known"}
    for file, content, code in (
        ("metrics.parquet", "PAR1", 3),
        ("verdicts.parquet", "", 3),
        ("timings.parquet", None, 3),
        ("summary.json", "[]", 2),
        ("summary.json", '{"schema_version": 1}', 2),
    ):
        damaged = tmp_path / f"{file}-{content}"
        shutil.copytree(runs[1], damaged)
        (damaged / file).unlink() if content is None else (damaged / file).write_text(content)
        result = replan("report", damaged)
        assert (
            result.exit_code == code and file in result.stderr and "Traceback" not in result.stderr
        )


CASES: dict[str, tuple[int, Callable[[tuple[Path, Path], Path], tuple[object, ...]]]] = {
    "pass": (0, lambda runs, tmp: (runs[0], runs[0])),
    "a rule failed": (
        1,
        lambda runs, tmp: (
            *runs,
            "--gates",
            _rule(tmp, "tracking_speed.p95", "max_increase = 0.0"),
        ),
    ),
    "one run": (2, lambda runs, tmp: (runs[0],)),
    "no such run": (2, lambda runs, tmp: (runs[0], tmp / "no")),
    "a bad rule": (
        2,
        lambda runs, tmp: (*runs, "--gates", _rule(tmp, "tracking_sped.p95", "max_increase = 0.0")),
    ),
    "damaged": (3, lambda runs, tmp: (runs[0], _damaged(tmp))),
    "nothing to judge": (
        4,
        lambda runs, tmp: (*runs, "--gates", _rule(tmp, "red_light.count", "max_increase = 0.0")),
    ),
}


def _rule(folder: Path, metric: str, limit: str) -> Path:
    file = folder / "gates.toml"
    file.write_text(
        f'[[gate]]\nmetric = "gap.min"\nmin = 0\n[[compare]]\nmetric = "{metric}"\n{limit}\n'
    )
    return file


def _damaged(folder: Path) -> Path:
    (folder / "bad.parquet").write_bytes(b"PAR1 and no more")
    return folder / "bad.parquet"


@pytest.mark.parametrize("case", list(CASES))
def test_exit_codes(runs: tuple[Path, Path], tmp_path: Path, case: str) -> None:
    code, words = CASES[case]
    assert replan("compare", *words(runs, tmp_path), "--no-first-difference").exit_code == code


@pytest.mark.slow
def test_evaluate_counts_the_rules_against_its_baseline(
    runs: tuple[Path, Path], tmp_path: Path
) -> None:
    """The gate passes in both runs: it is the baseline that decides."""
    file, logs = (
        tmp_path / "baseline.parquet",
        runs[0].parent / "logs" / "paper" / "crossing_pedestrian.mcap",
    )
    assert replan("baseline", runs[0], "-o", file).exit_code == 0
    gates = _rule(tmp_path, "tracking_speed.p95", "max_increase = 0.0")
    delay = tmp_path / "late.toml"
    delay.write_text("[loop]\nplan_delay_s = 0.1\n")
    common = (
        "evaluate",
        logs,
        "-p",
        "idm",
        "--mode",
        "closed",
        "--no-recording",
        "--workers",
        0,
        "--gates",
        gates,
    )
    same = replan(*common, "--out", tmp_path / "a", "--baseline", file)
    late = replan(
        *common, "--out", tmp_path / "b", "--baseline", file, "--config", delay, "--quiet"
    )
    assert (same.exit_code, late.exit_code) == (0, 1), same.stdout
    assert re.search(r"^Comparison: PASS *$", same.stdout, re.MULTILINE)
    for result, words in (
        (same, "Outcome: PASS (exit code 0)"),
        (late, "Outcome: FAIL (exit code 1)"),
    ):
        assert result.stdout.rstrip().splitlines()[-1].startswith(words), (
            "the last line is that of the whole"
        )
    assert "Comparison: FAIL\n" in late.stdout
    assert replan(*common, "--out", tmp_path / "a", "--baseline", tmp_path / "a").exit_code == 2
    assert replan(*common, "--out", tmp_path / "c", "--baseline", tmp_path / "no").exit_code == 2
    assert not (tmp_path / "c").exists()


@pytest.mark.slow
@pytest.mark.nightly
def test_planted_regressions_are_caught_and_named(tmp_path: Path) -> None:
    """On four logs no mean can be significant: the delay is inconclusive; all name their stage."""
    logs = (
        "paper/crossing_pedestrian",
        "everyday/follow",
        "everyday/cut_in",
        "pedestrian/jaywalker",
    )
    found = dict(regressions.compared(tmp_path, logs, list(regressions.CHANGES), workers=1))
    stages = {name: set(comparison.partings["stage"]) for name, comparison in found.items()}
    codes = {name: comparison.exit_code for name, comparison in found.items()}
    assert codes == {
        "weight": 1,
        "class": 1,
        "prediction": 1,
        "delay": 4,
        "again": 0,
        "tiny": 0,
        "solver": 0,
    }
    assert (
        stages["weight"] == {"speed DP"}
        and "controller" in stages["delay"]
        and stages["prediction"] == {"prediction"}
    )
    assert stages["class"] <= {"path DP", "S-T graph"} and stages["again"] == set()
    assert (found["again"].pairs["delta"].dropna() == 0.0).all() and found[
        "again"
    ].differences == ()
