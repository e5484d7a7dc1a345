"""The example of a network: its plans can be driven, it says what it needs, and it learns."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from command_line import replan as command
from hypothesis import given, settings, strategies as st

from replan import load
from replan.contract.planner_rules import context_of, frames_of
from replan.features import Features, features_of
from replan.logs import catalogue
from replan.logs.mcap import write_scenario
from replan.logs.plan import PlanStatus
from replan.replay.loop.plan_check import checked

EXAMPLE = Path(__file__).parents[2] / "examples" / "learned"
LOGS = {
    name: catalogue.scenario(name)
    for name in ("everyday/bend", "paper/free_road", "everyday/traffic_light")
}
MODULES = ("learned_planner", "route_view", "network", "train", "catalogue_split")


@pytest.fixture(autouse=True)
def path_of_the_example(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLE))


@pytest.fixture(scope="module")
def learned() -> ModuleType:
    sys.path.insert(0, str(EXAMPLE))
    try:
        import learned_planner
    finally:
        sys.path.remove(str(EXAMPLE))
    return learned_planner


def features_at(name: str, t: float) -> Features:
    log = LOGS[name]
    return features_of(frames_of(log, [t])[0], context_of(log))


def batch_of(*samples: Features) -> dict[str, np.ndarray]:
    arrays = [sample.arrays() for sample in samples]
    return {name: np.stack([row[name] for row in arrays]) for name in arrays[0]}


speeds = st.lists(st.floats(0.0, 25.0), min_size=8, max_size=8)
offsets = st.lists(st.floats(-1.5, 1.5), min_size=5, max_size=5)


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(sorted(LOGS)), st.integers(0, 100), speeds, offsets)
def test_whatever_the_network_answers_the_plan_begins_at_the_ego_and_agrees_with_itself(
    learned: ModuleType, name: str, tick: int, speeds: list[float], offsets: list[float]
) -> None:
    frame = frames_of(LOGS[name], [0.1 * tick])[0]
    features = features_at(name, 0.1 * tick)
    route = features.route[features.route_mask]
    plan = learned.plan_of(frame, route, np.array(speeds), np.array(offsets))
    trajectory = plan.trajectory
    assert trajectory.t[0] == frame.t and trajectory.t[-1] >= frame.t + 3.0
    assert (trajectory.v >= 0.0).all()
    as_driven = checked(plan, frame)
    assert as_driven.status in (PlanStatus.PLANNED, PlanStatus.CORRECTED), as_driven.reason
    assert np.hypot(trajectory.x[0] - frame.ego.x, trajectory.y[0] - frame.ego.y) < 1e-6


def test_answers_that_are_what_was_driven_give_the_drive_again(learned: ModuleType) -> None:
    import route_view

    from replan.replay.loop_config import DEFAULT_LOOP
    from replan.run.feature_export import samples_of

    log = LOGS["everyday/bend"]
    for sample in list(samples_of(log, DEFAULT_LOOP, route_view.SIZES, every=25))[1:-4]:
        batch = {name: array[None] for name, array in sample.items()}
        v, known, l, weights = route_view.targets(batch, "future")
        assert known.all()
        if not (weights == 1.0).all():
            continue  # it drives less far
        frame = frames_of(log, [float(sample["t"])])[0]
        plan = learned.plan_of(frame, sample["route"][sample["route_mask"]], v[0], l[0])
        for seconds in (1.0, 2.0, 4.0):
            planned, driven = (
                trajectory.at(frame.t + seconds) for trajectory in (plan.trajectory, log.ego)
            )
            assert np.hypot(planned.x - driven.x, planned.y - driven.y) < 0.6


def test_without_a_route_it_stops_and_says_why(learned: ModuleType) -> None:
    frame = frames_of(LOGS["paper/free_road"], [3.0])[0]
    plan = learned.plan_of(frame, np.zeros((0, 13)), np.full(8, 10.0), np.zeros(5))
    assert plan.status is PlanStatus.COMFORTABLE_STOP and "route" in plan.reason
    assert plan.trajectory.v[-1] < frame.ego.v


def test_the_view_along_the_route_straightens_a_curve() -> None:
    from route_view import along_route

    angle = np.arange(0.0, 1.5, 0.05)
    radius = 40.0
    line = np.column_stack([radius * np.sin(angle), radius * (1.0 - np.cos(angle))])
    route = np.column_stack([line, np.cos(angle), np.sin(angle)])[None]
    middle = 0.725
    point = np.array([np.sin(middle), -np.cos(middle)]) * (radius - 3.0) + [0.0, radius]
    s, l, along = along_route(route, np.ones(route.shape[:2], bool), point[None, None])
    assert s.item() == pytest.approx(radius * middle, abs=0.3)
    assert l.item() == pytest.approx(3.0, abs=0.1)
    np.testing.assert_allclose(along[0, 0], (np.cos(middle), np.sin(middle)), atol=0.03)


def test_inputs_have_the_sizes_that_the_network_expects() -> None:
    import route_view

    seen = route_view.inputs(batch_of(*(features_at(name, 2.0) for name in LOGS)))
    assert seen["ego"].shape == (len(LOGS), route_view.EGO_INPUTS)
    assert seen["agents"].shape == (*seen["mask"].shape, route_view.AGENT_INPUTS)
    assert all(np.isfinite(array).all() for array in seen.values())


def test_the_red_light_is_seen_where_it_is() -> None:
    import route_view

    log = LOGS["everyday/traffic_light"]
    (stop,) = log.road.stop_lines
    batch = batch_of(features_at("everyday/traffic_light", 2.0))
    near, _ = route_view.nearest_mark(batch["route"], batch["route_mask"], "red")[0]
    distance = stop.points.mean(axis=0) - (log.ego.at(2.0).x, log.ego.at(2.0).y)
    assert 20.0 * (1.0 / near - 1.0) == pytest.approx(np.hypot(*distance), abs=0.1)


def test_without_torch_it_names_the_extra(
    learned: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(ImportError, match=r"pip install 'replan\[learned\]'"):
        learned.Learned.prepare()


def test_no_family_is_in_both_parts_of_the_catalogue() -> None:
    from catalogue_split import HELD_OUT

    families = {name.partition("@")[0] for name in catalogue.suite("full")}
    assert set(HELD_OUT) < families and len(set(HELD_OUT)) == len(HELD_OUT)


@pytest.mark.slow
@pytest.mark.nightly
def test_what_it_learns_of_an_expert_drives_better_than_constant_speed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The commands of the page, with few logs."""
    pytest.importorskip("torch")
    for file in EXAMPLE.glob("*.py"):
        shutil.copy(file, tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "logs").mkdir()
    for number, name in enumerate(catalogue.suite("unece_r157/following")):
        write_scenario(tmp_path / "logs" / f"{number}.mcap", catalogue.scenario(name))
    quick = ("--workers", 0, "--no-recording", "--mode", "closed")
    expert, data = tmp_path / "expert", tmp_path / "data"
    command("evaluate", tmp_path / "logs", "-p", "dp_qp", *quick, "-o", expert)
    traces = sorted(expert.rglob("closed.mcap"))
    assert command("export", "features", *traces, "-o", data, "--every", 2).exit_code == 0
    assert json.loads((data / "features.json").read_text())["logs"]
    train = [sys.executable, "train.py", str(data), "--epochs", "60", "-o", "weights.npz"]
    first = subprocess.run(train, cwd=tmp_path, capture_output=True, text=True, check=True)
    losses = [float(line.split()[3]) for line in first.stdout.splitlines() if "loss" in line]
    assert losses[-1] < 0.5 * losses[0]
    second = tmp_path / "again.npz"
    subprocess.run([*train[:-1], str(second)], cwd=tmp_path, capture_output=True, check=True)
    assert second.read_bytes() == (tmp_path / "weights.npz").read_bytes()
    planners = ("-p", "learned_planner:Learned", "-p", "constant_speed")
    batch = ("--set", "loop.apart.batch=4")
    command("evaluate", tmp_path / "logs", *planners, *quick, *batch, "-o", tmp_path / "run")
    verdicts = load(tmp_path / "run").verdicts
    failed = verdicts[verdicts["outcome"] == "fail"].groupby("planner").size()
    assert failed.get("learned_planner:Learned", 0) < failed["constant_speed"]
