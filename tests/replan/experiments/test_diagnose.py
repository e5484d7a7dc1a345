"""`replan diagnose`: planted causes, the files, resume, and wrong words."""

import json
import re
import shlex
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from command_line import gates as write_gates, one_error, replan
from short_logs import free_and_blocked

from replan.logs.mcap import write_scenario

COLLISION = 'metric = "collision_at_fault.count"\nmode = "closed"\nmax = 0'
WEAK = "[planner.idm]\ndecel_mps2 = 0.3\nhardest_mps2 = 0.5\n"
"""Brakes so weakly that it meets the car that stands in its way."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of `idm` with weak brakes over a free road, a blocked one, and a blocked one whose log
    is gone since.
    """
    out = tmp_path_factory.mktemp("diagnose")
    (out / "logs").mkdir()
    free, blocked = free_and_blocked()
    for name, log in (
        ("free", free),
        ("blocked", blocked),
        ("gone", replace(blocked, name="test/gone")),
    ):
        write_scenario(out / "logs" / f"{name}.mcap", log)
    write_gates(out / "gates.toml", COLLISION)
    (out / "weak.toml").write_text(WEAK, encoding="utf-8")
    ran = replan(
        "evaluate",
        out / "logs",
        "-p",
        "idm",
        "--config",
        out / "weak.toml",
        "--gates",
        out / "gates.toml",
        "--no-recording",
        "--workers",
        0,
        "-o",
        out / "run",
    )
    assert ran.exit_code == 1, ran.output
    (out / "logs" / "gone.mcap").unlink()
    return out


@pytest.fixture(scope="module")
def found(folder: Path) -> Path:
    result = replan("diagnose", folder / "run", "-o", folder / "out", "--workers", 0)
    assert result.exit_code == 3, result.output
    return folder / "out"


@pytest.mark.slow
def test_a_drive_that_cannot_be_driven_again_is_named_and_the_others_are_diagnosed(
    found: Path,
) -> None:
    diagnosis = card(found)
    assert (
        list(diagnosis["not_driven"]) == ["test/gone"]
        and "gone.mcap" in diagnosis["not_driven"]["test/gone"]
    )
    assert [one["log"] for one in diagnosis["drives"]] == ["test/blocked"] and not diagnosis[
        "fails_no_more"
    ]
    (line,) = [
        line
        for line in diagnosis["said"]
        if line.startswith("Could not be driven again: test/gone: ")
    ]
    assert line in (found / "diagnosis.md").read_text(encoding="utf-8")


def card(out: Path) -> dict[str, Any]:
    read: dict[str, Any] = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    return read


@pytest.mark.slow
def test_the_planted_cause_is_named_and_the_sentences_agree_with_the_tables(found: Path) -> None:
    diagnosis = card(found)
    drives = pd.read_csv(found / "diagnosis.csv")
    assert drives["log"].tolist() == ["test/blocked"] and drives["cause"].tolist() == [
        "comfort bound"
    ]
    table = pd.read_csv(found / "changes.csv").set_index("change")
    assert table.loc["default_limits_idm", "passes"] and not table.loc["perfect_car", "passes"]
    assert not table.loc["true_futures", "passes"], "who stands is predicted to stand"
    assert drives.loc[0, "passes_with"].split() == table.index[table["passes"]].tolist()
    assert drives.loc[0, "parts_s"] == table.loc["default_limits_idm", "parts_s"]
    happens, cause, place = diagnosis["said"][:3]
    assert happens == "1 of 1 failing drive: brakes too weakly for a car, and collides with them."
    assert cause.startswith("  Points to comfort bound: passes with the planner's default limits")
    assert "collision_at_fault.count <= 0" in cause
    (drive,) = diagnosis["drives"]
    difference = drive["failure"]["difference"]
    assert (
        f"{-difference['hardest_mps2']:.1f} m/s² instead of "
        f"{-difference['would_hardest_mps2']:.1f} m/s²"
    ) in place
    assert (
        difference["hardest_mps2"] > -0.6
        and drive["failure"]["who"] == "car wall"
        and "car wall" in place
    )
    assert (
        drives.loc[0, "happens"]
        == diagnosis["clusters"][0]["happens"]
        == happens.partition(": ")[2].rstrip(".")
    )
    assert (found / "changes" / "default_limits_idm" / "metrics.parquet").is_file()


@pytest.mark.slow
def test_every_command_of_the_page_runs(found: Path) -> None:
    commands = re.findall(r"`replan ([^`]+)`", (found / "diagnosis.md").read_text(encoding="utf-8"))
    assert [command.split()[0] for command in commands] == ["explain", "compare"]
    for command in commands:
        assert replan(*shlex.split(command)).exit_code in (0, 1), command


@pytest.mark.slow
def test_the_smallest_change_passes_and_is_resumed_and_what_it_breaks_is_counted(
    folder: Path, found: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    space = folder / "space.toml"
    space.write_text("planner.idm.hardest_mps2 = { low = 0.2, high = 8.5 }\n", encoding="utf-8")
    shutil.copytree(found, folder / "remedy")
    out = folder / "remedy"
    words = (
        "diagnose",
        folder / "run",
        "--space",
        space,
        "-o",
        out,
        "--resume",
        "--workers",
        0,
        "--json",
    )
    first = replan(*words)
    (remedy,) = json.loads(first.stdout)["remedies"]
    monkeypatch.setattr("replan.experiments.diagnose.drive_again", None)
    again = replan(*words)
    assert again.exit_code == first.exit_code == 3 and again.stdout == first.stdout, (
        "nothing is driven a second time"
    )
    assert remedy["mended"] == ["test/blocked"] and remedy["broken"] == [] and remedy["drives"] == 2
    again = replan(
        "evaluate",
        folder / "logs",
        "-p",
        "idm",
        "--config",
        folder / "weak.toml",
        "--gates",
        folder / "gates.toml",
        "--set",
        f"planner.idm.hardest_mps2={remedy['now']}",
        "--no-recording",
        "--workers",
        0,
        "-o",
        folder / "again",
    )
    assert again.exit_code == 0, again.output


@pytest.mark.slow
def test_a_run_without_failing_drives_has_an_empty_diagnosis(folder: Path) -> None:
    result = replan(
        "diagnose", folder / "run", "--log", "test/free", "-o", folder / "none", "--workers", 0
    )
    assert result.exit_code == 0
    diagnosis = json.loads((folder / "none" / "diagnosis.json").read_text(encoding="utf-8"))
    assert diagnosis["drives"] == [] and diagnosis["open_loop"] == {}


@pytest.mark.slow
def test_a_failure_of_the_open_loop_alone_is_named(folder: Path, tmp_path: Path) -> None:
    write_gates(tmp_path / "gates.toml", 'metric = "plan_horizon.min"\nmode = "open"\nmin = 100')
    log = folder / "logs" / "free.mcap"
    run = (
        "--gates",
        tmp_path / "gates.toml",
        "--no-recording",
        "--workers",
        0,
        "-o",
        tmp_path / "run",
    )
    assert replan("evaluate", log, "-p", "idm", *run).exit_code == 1
    assert (
        replan("diagnose", tmp_path / "run", "-o", tmp_path / "out", "--workers", 0).exit_code == 0
    )
    diagnosis = json.loads((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    assert diagnosis["drives"] == [] and diagnosis["open_loop"] == {
        "test/free": ["plan_horizon.min >= 100 [open]"]
    }
    assert any("open loop" in line and "test/free" in line for line in diagnosis["said"])


@pytest.mark.slow
def test_the_report_shows_the_diagnosis_and_links_its_drives(folder: Path, found: Path) -> None:
    result = replan("report", folder / "run", "--diagnosis", found, "-o", folder / "reports")
    assert result.exit_code == 0, result.output
    page, text = (
        (folder / "reports" / name).read_text(encoding="utf-8")
        for name in ("report.html", "report.md")
    )
    for line in page, text:
        assert (
            "Why idm fails" in line
            and "comfort bound" in line
            and "brakes too weakly for a car" in line
        )
    (anchor,) = set(re.findall(r'<td><a href="#([^"]+)">test/blocked</a>', page))
    assert f'id="{anchor}"' in page
    other = json.loads((found / "diagnosis.json").read_text(encoding="utf-8"))
    other["clusters"][0]["drives"] = ["test/other"]
    (folder / "diagnosis.json").write_text(json.dumps(other), encoding="utf-8")
    assert "another run" in one_error(replan("report", folder / "run", "--diagnosis", folder))
    (folder / "diagnosis.json").unlink()
    wrong = replan("report", folder / "run", "--diagnosis", folder)
    assert wrong.exit_code == 2 and "replan diagnose RUN" in one_error(wrong)


def test_wrong_options_are_one_line(folder: Path, tmp_path: Path) -> None:
    for words, message in (
        (("--log", "test/blockd"), "test/blocked"),
        (("--planner", "dp_qp"), "idm"),
        (("--changes", tmp_path / "no.toml"), "no.toml"),
        (("--resume",), "--out"),
    ):
        result = replan("diagnose", folder / "run", *words)
        assert result.exit_code == 2 and message in one_error(result), words
    assert "no results" in one_error(replan("diagnose", tmp_path))
    (tmp_path / "mine.txt").write_text("mine", encoding="utf-8")
    result = replan("diagnose", folder / "run", "-o", tmp_path)
    assert result.exit_code == 2 and one_error(result) and (tmp_path / "mine.txt").is_file()
