"""`replan tune`: planted better settings are found, noise is not.

Trials, files, resume, and wrong words.
"""

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import gates as write_gates, one_error, replan
from handmade import drive, lanes_along, scenario, square, straight

from replan.config import RunConfig, load_run
from replan.experiments.gains import Objective, RunScores
from replan.experiments.optuna_trials import OptunaTrials, TuningInputs, Values
from replan.experiments.space import Setting
from replan.logs.mcap import write_scenario
from replan.logs.road import Goal
from replan.run.claim import STUDY as FILE

pytest.importorskip(
    "optuna", reason="the extra improve is not installed: pip install 'replan[improve]'"
)
SPEED, IDLE = ("planner", "wishful:Wishful", "speed_mps"), ("planner", "wishful:Wishful", "idle")
ONE = (Objective("down.mean", "closed", -1.0),)


def tried(
    values: Callable[[Values], float],
    failed: Callable[[Values], int] = lambda v: 0,
    *,
    count: int = 40,
    seed: int = 0,
) -> list[dict[str, object]]:
    """The rows of trials of a function of the settings, without a drive."""
    settings = (Setting(SPEED, 8.0, 2.0, 12.0), Setting(IDLE, 0.5, 0.1, 10.0, log=True))
    default = RunScores(
        np.full((1, 3), values({SPEED: 8.0, IDLE: 0.5})), failed({SPEED: 8.0, IDLE: 0.5})
    )
    trials = OptunaTrials(
        TuningInputs(RunConfig(planners=("idm",)), settings, ONE, seed=seed), default
    )
    rows = []
    for _ in range(count):
        asked = trials.ask()
        rows.append(trials.row(asked, RunScores(np.full((1, 3), values(asked)), failed(asked))))
        trials.tell(rows[-1])
    return rows


def miss(values: Values) -> float:
    return abs(float(values[SPEED]) - 5.0)


def test_the_first_trial_is_the_default_and_the_seed_decides_the_rest() -> None:
    one, again, other = tried(miss, count=14), tried(miss, count=14), tried(miss, count=14, seed=1)
    first = ".".join(SPEED[:1]) + f'."{SPEED[1]}".{SPEED[2]}'
    assert one[0][first] == 8.0 and one[0]["total"] == 0.0
    assert one == again and one[1:] != other[1:]


def test_better_settings_are_found_and_those_that_fail_more_are_not_feasible() -> None:
    rows = tried(miss, lambda values: int(float(values[SPEED]) < 6.0))
    totals = [float(str(row["total"])) for row in rows if row["feasible"]]
    assert max(totals) > 0.6  # 5 m/s would be 1, 6 m/s is 2/3: 1 - 1/3
    assert all((row["failed"] == 1) != row["feasible"] for row in rows)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve logs of 2 s, on each of which another speed is driven."""
    out = tmp_path_factory.mktemp("tune")
    (out / "logs").mkdir()
    for k in range(12):
        ego = drive(straight, 6.0 + 0.3 * k, 2.0)
        made = scenario(ego, road=lanes_along(ego), goal=Goal((square(2.0 * ego.v[0], 0.0, 4.0),)))
        write_scenario(out / "logs" / f"{k}.mcap", replace(made, name=f"made/{k}"))
    write_gates(out / "gates.toml", 'metric = "collision_at_fault.count"\nmode = "closed"\nmax = 0')
    write_space(
        out / "space.toml",
        "speed_mps = { low = 5.0, high = 10.0 }",
        "idle = { low = 0.0, high = 1.0 }",
    )
    return out


def write_space(path: Path, *lines: str) -> None:
    path.write_text(
        "\n".join(f'planner."wishful:Wishful".{line}' for line in lines), encoding="utf-8"
    )


def words(folder: Path, out: Path, *more: object) -> Sequence[object]:
    """The command of a tuning; `more` replaces its options."""
    options = {
        "-p": "wishful:Wishful",
        "--space": folder / "space.toml",
        "--gates": folder / "gates.toml",
        "--held-out": 0.5,
        "--workers": 0,
        "-o": out,
    }
    kept = [word for option in options.items() if option[0] not in more for word in option]
    settings = ("--set", "loop.apart.trust=true", "--set", "repeat_s=0")
    return (
        "tune",
        folder / "logs",
        *settings,
        "--metric",
        "wishful:wish",
        "--metric",
        "wishful:noise",
        *kept,
        *more,
    )


@pytest.mark.slow
def test_planted_better_settings_are_found_and_hold_on_held_out_logs(
    folder: Path, tmp_path: Path
) -> None:
    objective = ("--objective", "wish.mean", "--trials", 4)
    result = replan(*words(folder, tmp_path / "out", *objective))
    assert result.exit_code == 0, result.output
    card = json.loads((tmp_path / "out" / "tune.json").read_text(encoding="utf-8"))
    assert len(card["held_out"]) == len(card["training"]) == 6 and card["said"][-1].startswith(
        "PASS"
    )
    assert card["gain"]["interval"][0] > 0.0 and f"{card['gain']['mean']:+.4f}" in result.stdout
    best = load_run(tmp_path / "out" / "best.toml")
    speed = best.planner["wishful:Wishful"]["speed_mps"]
    assert 5.9 < speed < 8.0 and card["chosen"]['planner."wishful:Wishful".speed_mps'] == speed
    table = pd.read_parquet(tmp_path / "out" / "trials.parquet")
    assert (
        table["pareto"].sum() == 1
        and table.loc[table["pareto"], "total"].item() == table["total"].max()
    )


@pytest.mark.slow
def test_pure_noise_fails(folder: Path, tmp_path: Path) -> None:
    noise = ("--objective", "noise.mean", "--trials", 2)
    result = replan(*words(folder, tmp_path / "out", *noise))
    assert result.exit_code == 1, result.output
    assert "FAIL: no feasible trial is better than the defaults" in result.stdout
    assert load_run(tmp_path / "out" / "best.toml").planners == ("wishful:Wishful",)


@pytest.mark.slow
def test_a_space_of_refused_points_is_one_line_and_its_trials_are_kept(
    folder: Path, tmp_path: Path
) -> None:
    """Both ends are multiples of the control period, and what lies between them is none."""
    (tmp_path / "space.toml").write_text(
        "loop.plan_period_s = { low = 0.2, high = 0.4 }", encoding="utf-8"
    )
    asked = ("--space", tmp_path / "space.toml", "--objective", "wish.mean", "--trials", 3)
    result = replan(*words(folder, tmp_path / "out", *asked))
    message = one_error(result)
    assert result.exit_code == 2 and "no trial of 3 is accepted by the configuration" in message
    assert "must be a multiple of" in message
    assert len((tmp_path / "out" / FILE).read_text(encoding="utf-8").splitlines()) == 4


def test_without_optuna_or_cmaes_one_line_helps(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "optuna", None)
    monkeypatch.setitem(sys.modules, "cmaes", None)
    falsify = ("falsify", "paper/crossing_pedestrian", "-p", "idm", "-o", tmp_path / "out")
    for asked in (words(folder, tmp_path / "out", "--objective", "wish.mean"), falsify):
        result = replan(*asked)
        assert result.exit_code == 2 and "pip install 'replan[improve]'" in one_error(result)
        assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--objective", "noise.men"), "did you mean 'noise.mean'"),
        (("--held-out", 0.0), "holds out 0, and on fewer than 6 no difference is more than chance"),
        (("--held-out", 1.0), "leaves none to search on"),
        (("--resume",), "contains no study to resume"),
        (("--space", "nowhere.toml"), "nowhere.toml"),
    ],
)
def test_wrong_options_are_one_line_and_leave_no_files(
    folder: Path, tmp_path: Path, more: tuple[object, ...], message: str
) -> None:
    result = replan(*words(folder, tmp_path / "out", *more))
    assert result.exit_code == 2 and message in one_error(result)
    assert not (tmp_path / "out").exists()


def test_a_space_that_the_planner_refuses_is_refused_before_anything_is_driven(
    folder: Path, tmp_path: Path
) -> None:
    (tmp_path / "space.toml").write_text(
        "planner.idm.time_gap_s = { low = -1.0, high = 2.0 }", encoding="utf-8"
    )
    result = replan(
        *words(folder, tmp_path / "out", "--space", tmp_path / "space.toml", "-p", "idm")
    )
    assert result.exit_code == 2 and "planner.idm.time_gap_s = -1.0 is refused" in one_error(result)
    assert not (tmp_path / "out").exists()
