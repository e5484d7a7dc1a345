"""`replan export features`: samples with the recorded future, a file a log."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import replan
from short_logs import short

from replan.contract.planner_rules import context_of, frames_of
from replan.features import FeatureSizes, features_of
from replan.logs import catalogue
from replan.logs.mcap import write_scenario, write_trace
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop_config import DEFAULT_LOOP
from replan.run.feature_export import FUTURE_S, samples_of

LOG = catalogue.scenario("paper/static_obstacles")
SIZES = FeatureSizes(agents=4, objects=2, lanes=10, crosswalks=1)


def read(folder: Path) -> tuple[dict, list[dict[str, np.ndarray]]]:
    manifest = json.loads((folder / "features.json").read_text(encoding="utf-8"))
    logs = []
    for row in manifest["logs"]:
        parts = [np.load(folder / name) for name in row["files"]]
        logs.append({key: np.concatenate([part[key] for part in parts]) for key in parts[0].files})
    return manifest, logs


@pytest.fixture
def log_file(tmp_path: Path) -> Path:
    path = tmp_path / "logs" / "drive.mcap"
    path.parent.mkdir()
    write_scenario(path, LOG)
    return path


def test_a_sample_is_what_a_planner_gets_in_open_loop() -> None:
    samples = list(samples_of(LOG, DEFAULT_LOOP, SIZES, every=30))
    times = [0.1 * k for k in range(61)]
    frames, context = frames_of(LOG, times), context_of(LOG)
    for sample, frame in zip(samples, frames[::30], strict=False):
        assert sample["t"] == pytest.approx(frame.t)
        for name, array in features_of(frame, context, SIZES).arrays().items():
            np.testing.assert_array_equal(sample[name], array, err_msg=name)


def test_futures_are_those_of_the_log_and_known_until_it_ends() -> None:
    samples = list(samples_of(LOG, DEFAULT_LOOP, SIZES, every=10))
    for sample in samples:
        now, t = LOG.ego.at(float(sample["t"])), float(sample["t"]) + FUTURE_S
        known = sample["future_known"]
        np.testing.assert_array_equal(known, t <= LOG.ego.t[-1] + 1e-6)
        for k in np.flatnonzero(known)[::20]:
            state = LOG.ego.at(float(t[k]))
            x, y = now.offset_of(np.array(state.x), np.array(state.y))
            np.testing.assert_allclose(sample["future"][k, :2], (x, y), atol=1e-3)
            assert sample["future"][k, 4] == pytest.approx(state.v, abs=1e-4)
        assert not sample["future"][~known].any()
        assert not sample["plan_known"].any(), "no planner was on board"
    assert samples[0]["future_known"].all() and not samples[-1]["future_known"][20:].any()


def test_the_futures_of_agents_are_in_their_order() -> None:
    log = catalogue.scenario("everyday/cut_in")
    (sample, *_) = samples_of(log, DEFAULT_LOOP, SIZES, every=40)
    frame, context = frames_of(log, [0.0])[0], context_of(log)
    features = features_of(frame, context, SIZES)
    first = log.tracks.ids.index(frame.agents.ids[features.agents_row[0]])
    span = log.tracks.samples(first)
    x = np.interp(2.0, log.tracks.t[span], log.tracks.x[span])
    y = np.interp(2.0, log.tracks.t[span], log.tracks.y[span])
    expected = frame.ego.offset_of(np.array(x), np.array(y))
    np.testing.assert_allclose(sample["agents_future"][0, 19, :2], expected, atol=1e-3)
    assert not sample["agents_future_known"][~features.agents_mask].any()


def test_a_trace_has_the_plans_of_its_planner(tmp_path: Path) -> None:
    drive = run_closed_loop(LOG, "idm", until_s=3.0)
    write_trace(tmp_path / "closed.mcap", drive.trace, LOG)
    done = replan("export", "features", str(tmp_path / "closed.mcap"), "-o", str(tmp_path / "data"))
    assert done.exit_code == 0, done.output
    manifest, (samples,) = read(tmp_path / "data")
    assert manifest["logs"][0]["driven_by"] == "idm"
    assert samples["plan_known"].all()
    frame = drive.trace.frames[10]
    assert samples["t"][2] == pytest.approx(frame.t)
    later, now = frame.plan.trajectory.at(frame.t + 4.0), drive.trace.ego.at(frame.t)
    x, y = now.offset_of(np.array(later.x), np.array(later.y))
    np.testing.assert_allclose(samples["plan"][2, 39, :2], (x, y), atol=1e-2)
    assert samples["plan"][2, 39, 4] == pytest.approx(later.v, abs=1e-3)


def test_the_same_logs_give_the_same_bytes_with_any_number_of_workers(
    tmp_path: Path, log_file: Path
) -> None:
    write_scenario(log_file.with_name("short.mcap"), short("test/short"))
    for name, workers in (("one", "0"), ("two", "2")):
        words = ["export", "features", str(log_file.parent), "-o", str(tmp_path / name)]
        done = replan(*words, "--workers", workers, "--every", "20", "--size", "lanes=5")
        assert done.exit_code == 0, done.output
    files = sorted(file.name for file in (tmp_path / "one").iterdir())
    assert len(files) >= 3
    for name in files:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    manifest, logs = read(tmp_path / "one")
    assert manifest["sizes"]["lanes"] == 5 and manifest["sample_period_s"] == pytest.approx(2.0)
    assert [row["samples"] for row in manifest["logs"]] == [len(log["t"]) for log in logs]
    assert logs[0]["lanes"].shape[1] == 5


def test_a_log_that_cannot_be_read_is_named_and_the_others_are_written(
    tmp_path: Path, log_file: Path
) -> None:
    (log_file.parent / "bad.mcap").write_bytes(log_file.read_bytes()[:300])
    data = tmp_path / "data"
    done = replan("export", "features", str(log_file.parent), "-o", str(data), "--workers", "0")
    assert done.exit_code == 3 and "bad.mcap" in done.output
    manifest, logs = read(data)
    assert len(logs) == 1 and "bad.mcap" in manifest["failures"][0]


def test_a_second_export_replaces_the_first_and_no_file_of_others(
    tmp_path: Path, log_file: Path
) -> None:
    data = tmp_path / "data"
    words = ["export", "features", str(log_file), "-o", str(data), "--workers", "0"]
    assert replan(*words, "--every", "50").exit_code == 0
    assert replan(*words, "--every", "100").exit_code == 0
    other = tmp_path / "other"
    other.mkdir()
    (other / "mine.npz").write_bytes(b"mine")
    done = replan("export", "features", str(log_file), "-o", str(other))
    assert done.exit_code == 2 and "mine.npz" in done.output
    assert (other / "mine.npz").read_bytes() == b"mine"


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ([], "name logs"),
        (["no_such_log"], "no_such_log"),
        (["--suite", "smoke", "--size", "agents=0"], "agents"),
        (["--suite", "smoke", "--size", "agent=3"], "agents"),
    ],
)
def test_wrong_words_are_one_line_and_exit_code_2(
    tmp_path: Path, words: list[str], problem: str
) -> None:
    done = replan("export", "features", *words, "-o", str(tmp_path / "data"))
    assert done.exit_code == 2 and problem in done.output
    assert not (tmp_path / "data").exists()


def test_a_long_log_is_several_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("replan.run.feature_export.SAMPLES_PER_FILE", 4)
    write_scenario(tmp_path / "a.mcap", short("test/a"))
    words = ["export", "features", str(tmp_path / "a.mcap"), "-o", str(tmp_path / "data")]
    assert replan(*words, "--workers", "0", "--every", "1").exit_code == 0
    manifest, (samples,) = read(tmp_path / "data")
    assert len(manifest["logs"][0]["files"]) == -(-len(samples["t"]) // 4) > 1
    assert (np.diff(samples["t"]) > 0.0).all()
