"""A full disk, at any byte: one line that names the file, no cut file under a final name, and
--resume goes on.
"""

from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
from command_line import replan
from full_disk import room
from hypothesis import Phase, given, settings, strategies as st
from short_logs import QUICK, identical, run

from replan.core.errors import OutputError
from replan.core.memory import Scratch
from replan.draw.recording import write_log_recording, write_recording
from replan.logs.mcap import read_scenario, write_scenario, write_trace
from replan.logs.scenario import Scenario
from replan.logs.trace import Trace
from replan.metrics import evaluate, evaluate_with_series
from replan.replay.loop.closed_loop import run_closed_loop
from replan.results.log_result import Steps, StepsFile
from replan.results.tables import write_metrics, write_text
from replan.run import evaluate_logs

LONG_LINE = "the disk is full " * 40


@pytest.fixture(scope="module")
def writers(logs: Path) -> dict[str, Callable[[Path], object]]:
    """What writes a file of each kind."""
    scenario = read_scenario(logs / "b.mcap")
    drive = run_closed_loop(scenario, "constant_speed")
    table, steps = evaluate_with_series(drive.trace, scenario)
    return {
        "log.mcap": lambda path: write_scenario(path, scenario),
        "closed.mcap": lambda path: write_trace(path, drive.trace, scenario, internals="full"),
        "closed.rrd": lambda path: write_recording(path, drive, scenario, table, steps),
        "log.rrd": lambda path: write_log_recording(path, scenario),
        "frames.parquet": lambda path: _write_steps(path.parent, drive.trace, scenario),
        "metrics.csv": lambda path: write_metrics(path.parent, table),
        "report.md": lambda path: write_text(path, LONG_LINE),
    }


def _write_steps(folder: Path, trace: Trace, scenario: Scenario) -> None:
    with closing(StepsFile(folder)) as steps:
        found: list[Steps] = []
        evaluate(trace, scenario, found=lambda name, series: found.append(steps.put(name, series)))
        steps.add("p", "closed", tuple(found))
        steps.write()


KINDS = (
    "log.mcap",
    "closed.mcap",
    "closed.rrd",
    "log.rrd",
    "frames.parquet",
    "metrics.csv",
    "report.md",
)


@pytest.mark.parametrize("name", KINDS)
@settings(max_examples=max(settings.default.max_examples // 12, 4), phases=[Phase.generate])
@given(share=st.floats(0.0, 1.0))
def test_a_file_is_whole_or_not_there(
    writers: dict[str, Callable[[Path], object]],
    tmp_path_factory: pytest.TempPathFactory,
    name: str,
    share: float,
) -> None:
    folder = tmp_path_factory.mktemp("disk")
    writers[name](folder / name)
    size = max(file.stat().st_size for file in folder.iterdir())
    # Two recordings differ by a few bytes
    least = 0.95 * size if name.endswith(".rrd") else size - 1
    for file in folder.iterdir():
        file.unlink()
    with (
        room(int(share * least)),
        pytest.raises(OutputError, match=r"cannot be written: File too large") as said,
    ):
        writers[name](folder / name)
    assert str(folder) in str(said.value) and "\n" not in str(said.value)
    # Beside metrics.csv, and whole
    assert {file.name for file in folder.iterdir()} <= {"metrics.parquet"}
    with room(2 * size):
        writers[name](folder / name)
    assert (folder / name).exists()


@pytest.mark.parametrize(
    "size", [3000, *(pytest.param(size, marks=pytest.mark.slow) for size in (0, 300, 9000))]
)
def test_a_run_ends_in_one_line_and_is_resumed(logs: Path, tmp_path: Path, size: int) -> None:
    """At 0 bytes nothing can be begun, then the run's settings, the drives of a log, the tables of
    the run.
    """
    whole = run(logs, tmp_path / "whole", QUICK)
    words = ["evaluate", str(logs), "-p", "constant_speed", "--workers", "0", "--no-recording"]
    out = tmp_path / "out"
    with room(size):
        done = replan(*words, "-o", out)
    assert done.exit_code == 3, done.output
    (line,) = [line for line in done.stderr.splitlines() if "error" in line]
    assert "cannot be written: File too large" in line and "--resume" in line * bool(
        size
    ) + "--resume" * (not size)
    assert "Traceback" not in done.output
    left = [
        path
        for path in out.rglob("*")
        if path.name.startswith((".partial", ".lock")) or path.suffix == ".part"
    ]
    assert not left and not (out / "summary.json").exists()
    assert identical(whole.path, evaluate_logs([logs], QUICK, out, resume=True).path)


def test_frames_that_find_no_room_are_said_as_they_are_put() -> None:
    scratch = Scratch()
    with room(100):
        with pytest.raises(OSError, match="File too large"):
            scratch.put(b"little, and still too much " * 10)
        scratch.close()


@pytest.mark.slow
def test_a_worker_that_finds_a_full_disk_ends_it(
    logs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = run(logs, tmp_path / "whole", replace(QUICK, recording=True))
    with room(9000), pytest.raises(OutputError, match="--resume"):
        evaluate_logs([logs], replace(QUICK, recording=True), tmp_path / "out", workers=2)
    again = evaluate_logs(
        [logs], replace(QUICK, recording=True), tmp_path / "out", workers=2, resume=True
    )
    assert identical(whole.path, again.path)


def test_a_full_standard_output_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*words: object, err: bool = False, **more: object) -> None:
        if not err:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr("typer.echo", full)
    assert replan("list").exit_code == 3
