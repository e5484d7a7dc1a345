"""A run that was interrupted goes on where it was, and its tables are those of a run that was never
interrupted.
"""

import json
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import pytest
from process_tree import are_gone, started
from short_logs import QUICK, identical, short

from replan.config import RunConfig
from replan.core.errors import ConfigError
from replan.draw.drawn_results import Results
from replan.logs.mcap import write_scenario
from replan.results.log_result import LogResult, load_result, timings_of
from replan.run import evaluate_logs

PATIENT = '''
import os, pathlib, time
from replan.planners.constant_speed import ConstantSpeed

class Patient(ConstantSpeed):
    """Waits where anybody else is in the scene (with the file `alone`: where no one is), until it may go on."""
    def plan(self, frame):
        folder = pathlib.Path(__file__).parent
        waits = bool(len(frame.agents)) != (folder / "alone").exists()
        while waits and not (folder / "go").exists():
            if not (folder / "waiting").exists():  # whole or not at all: it may be killed at any moment
                (folder / "writing").write_text(str(os.getpid()))
                (folder / "writing").rename(folder / "waiting")
            time.sleep(0.02)
        return super().plan(frame)
'''  # noqa: E501
CONFIG = replace(QUICK, planners=("constant_speed", "patient:Patient"))
"""The logs are a, b, c; only in b is anybody else."""


@pytest.fixture
def patient(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a planner that waits for the file `go`, importable from here and there."""
    (tmp_path / "patient.py").write_text(PATIENT, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "patient", raising=False)
    return tmp_path


def resumed(
    logs: Path | Sequence[Path], out: Path, config: RunConfig = CONFIG, *, workers: int = 0
) -> Results:
    return evaluate_logs(
        [logs] if isinstance(logs, Path) else logs, config, out, workers=workers, resume=True
    )


def interrupted(
    logs: Path, folder: Path, stop: signal.Signals, workers: int
) -> subprocess.CompletedProcess[str]:
    """A run of the command line that is stopped while it waits in the middle log.

    Its results are in `out`.
    """
    planners = [word for name in CONFIG.planners for word in ("-p", name)]
    words = ["evaluate", logs, *planners, "--no-recording", "-o", "out", "--workers", workers]
    process = started(*words, cwd=folder)
    while not (folder / "waiting").exists():
        assert process.poll() is None, process.communicate()
        time.sleep(0.05)
    process.send_signal(stop)
    _, said = process.communicate(timeout=120)
    return subprocess.CompletedProcess(words, process.returncode, "", said)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stop", "workers"), [(signal.SIGINT, 0), (signal.SIGTERM, 1), (signal.SIGKILL, 1)]
)
def test_a_resumed_run_gives_the_bytes_of_one_that_was_never_interrupted(
    logs: Path, patient: Path, stop: signal.Signals, workers: int
) -> None:
    if workers:  # the longest log, b, is driven first: wait in one of the others
        (patient / "alone").touch()
    ended = interrupted(logs, patient, stop, workers)
    out = patient / "out"
    done = {path: path.stat().st_mtime_ns for path in out.glob("[!.]*/*")}
    assert done
    assert not list(out.glob("metrics.*"))
    assert are_gone([(patient / "waiting").read_text()]), "no worker goes on writing"
    if stop is signal.SIGKILL:
        assert ended.returncode == -signal.SIGKILL
    else:
        assert ended.returncode == 130
        assert "interrupted: 1 of 3 logs are finished in out" in ended.stderr
        assert "--out out --resume" in ended.stderr
        assert "Traceback" not in ended.stderr
        assert not list(out.rglob(".partial*"))
    (patient / "go").touch()
    result = resumed(logs, out)
    assert result.resumed == 1
    assert len(list(out.glob("*/log.json"))) == 3
    assert {path: path.stat().st_mtime_ns for path in done} == done
    whole = evaluate_logs([logs], CONFIG, patient / "whole")
    assert identical(whole.path, out)
    assert list(result.logs["log"]) == list(whole.logs["log"])
    assert not list(out.rglob(".partial*"))


@pytest.fixture(scope="module")
def whole(logs: Path, tmp_path_factory: pytest.TempPathFactory) -> Results:
    """A finished run: to be read only."""
    return evaluate_logs([logs], QUICK, tmp_path_factory.mktemp("whole") / "out")


@pytest.fixture
def begun(whole: Results, tmp_path: Path) -> Path:
    """The run without its tables and without the last log: what a killed run leaves."""
    out = Path(shutil.copytree(whole.path, tmp_path / "out"))
    (out / whole.logs.iloc[-1].folder).rename(out / ".partial-0123-4567")
    for name in ("metrics.parquet", "metrics.csv", "summary.json"):
        (out / name).unlink()
    (out / "timings.parquet").rename(out / ".partial-timings.parquet")
    return out


def test_resume_evaluates_the_missing_logs(
    logs: Path, begun: Path, whole: Results, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = {
        path: path.stat().st_mtime_ns for path in begun.glob("*/*") if ".partial" not in str(path)
    }
    result = resumed(logs, begun, QUICK)
    assert result.resumed == 2
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert identical(whole.path, begun)
    monkeypatch.setattr("replan.run.evaluate.evaluate_log", lambda *_, **__: 1 / 0)
    tables = {
        name: (begun / name).read_bytes()
        for name in ("metrics.parquet", "metrics.csv", "summary.json")
    }
    assert resumed(logs, begun, QUICK).resumed == 3, "a run that is complete is taken whole"
    assert {name: (begun / name).read_bytes() for name in tables} == tables


def test_a_folder_that_is_not_whole_is_evaluated_anew(
    logs: Path, begun: Path, whole: Results
) -> None:
    first, second = sorted(path.parent for path in begun.glob("[!.]*/log.json"))
    (first / "closed.mcap").unlink()
    (second / "log.json").write_text("{", encoding="utf-8")
    assert resumed(logs, begun, QUICK).resumed == 0
    assert identical(whole.path, begun)


def test_more_logs_may_be_named_and_in_another_order(logs: Path, begun: Path) -> None:
    files = sorted(logs.glob("*.mcap"))
    result = resumed(files[::-1], begun, QUICK)
    assert result.resumed == 2
    assert [log.source for log in result.logs.itertuples()] == [str(file) for file in files[::-1]]


@pytest.mark.slow
def test_failures_of_the_interrupted_run_are_not_forgotten(logs: Path, tmp_path: Path) -> None:
    (tmp_path / "raising.py").write_text(
        "from replan.planners.constant_speed import ConstantSpeed\nclass Raising(ConstantSpeed):\n"
        "    def plan(self, frame):\n        raise RuntimeError('out of ideas')\n",
        encoding="utf-8",
    )
    sys.path.insert(0, str(tmp_path))
    try:
        config = replace(QUICK, planners=("raising:Raising",))
        first = evaluate_logs([logs], config, tmp_path / "out")
        again = resumed(logs, tmp_path / "out", config)
    finally:
        sys.path.remove(str(tmp_path))
    assert again.resumed == 3
    assert again.failures.equals(first.failures) and again.exit_code == first.exit_code == 3


def test_the_kept_result_is_the_result(logs: Path, tmp_path: Path) -> None:
    logged: list[LogResult] = []
    result = evaluate_logs([logs], QUICK, tmp_path / "out", on_log=logged.append)
    assert len(logged) == 3
    for log in logged:
        found = load_result(result.path / log.folder)
        assert found is not None
        again = found[0]
        assert asdict(replace(again, seconds=0.0)) == asdict(replace(log, seconds=0.0)) and len(
            timings_of(result.path, again)
        )


def refusal(logs: Path | Sequence[Path], out: Path, config: RunConfig = QUICK) -> str:
    """Why a run is not resumed; whatever is in `out` stays there."""
    before = sorted(str(path) for path in out.rglob("*"))
    with pytest.raises(ConfigError) as raised:
        resumed(logs, out, config)
    assert sorted(str(path) for path in out.rglob("*")) == before
    return str(raised.value)


def test_another_configuration_is_refused_and_named(logs: Path, begun: Path) -> None:
    said = refusal(
        logs, begun, replace(QUICK, loop=replace(QUICK.loop, traffic="reactive"), mode="closed")
    )
    assert "loop.traffic was 'give_way', is 'reactive'" in said
    assert "mode was 'both', is 'closed'" in said
    assert "leave out --resume" in said


def test_other_gates_are_no_other_run(logs: Path, begun: Path, tmp_path: Path) -> None:
    gates = tmp_path / "gates.toml"
    gates.write_text('[[gate]]\nmetric = "gap.min"\nmin = 0.0\nmode = "closed"\n', encoding="utf-8")
    assert resumed(logs, begun, replace(QUICK, gates=str(gates))).resumed == 2


def test_another_version_or_other_code_is_refused(
    logs: Path, begun: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    card = next(begun.glob("[!.]*/log.json"))
    content = json.loads(card.read_text(encoding="utf-8"))
    card.write_text(json.dumps({**content, "code": "0" * 64}), encoding="utf-8")
    assert "other code of replan" in refusal(logs, begun)
    card.write_text(json.dumps({**content, "replan": "0.0.1"}), encoding="utf-8")
    assert "was begun with replan 0.0.1" in refusal(logs, begun)


@pytest.mark.slow
def test_another_planner_file_is_refused(logs: Path, patient: Path) -> None:
    (patient / "go").touch()
    evaluate_logs([logs], CONFIG, patient / "out")
    with (patient / "patient.py").open("a", encoding="utf-8") as file:
        file.write("# edited\n")
    assert "other code" in refusal(logs, patient / "out", CONFIG)


def test_logs_that_are_missing_or_have_changed_are_refused(
    logs: Path, begun: Path, tmp_path: Path
) -> None:
    files = sorted(logs.glob("*.mcap"))
    assert "a.mcap, which is not among the logs or has changed" in refusal(files[1:], begun)
    changed = tmp_path / "changed"
    changed.mkdir()
    for name in ("a", "b"):
        (changed / f"{name}.mcap").write_bytes((logs / f"{name}.mcap").read_bytes())
    write_scenario(changed / "a.mcap", short("test/a", v=3.0))
    assert "a.mcap, which is not among the logs or has changed" in refusal(changed, begun)


def test_resume_refuses_foreign_folders_and_starts_in_absent_ones(
    logs: Path, tmp_path: Path
) -> None:
    assert resumed(logs, tmp_path / "new", QUICK).resumed == 0
    (tmp_path / "new" / "thesis.tex").write_text("", encoding="utf-8")
    assert "thesis.tex" in refusal(logs, tmp_path / "new")
    with pytest.raises(ConfigError, match="--out"):
        evaluate_logs([logs], QUICK, resume=True)
