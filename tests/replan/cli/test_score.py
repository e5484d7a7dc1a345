"""`replan score`: runs and files in, tables out; bad input is one line and exit code 2."""

from pathlib import Path

import pandas as pd
import pytest
from command_line import one_error, replan

VALUES = Path(__file__).parents[2] / "support" / "leaderboards"
NUPLAN = (
    "no_ego_at_fault_collisions",
    "drivable_area_compliance",
    "driving_direction_compliance",
    "ego_is_making_progress",
    "ego_progress_along_expert_route",
    "time_to_collision_within_bound",
    "speed_limit_compliance",
    "ego_is_comfortable",
    "score",
)
NAVSIM = (
    "no_at_fault_collisions",
    "drivable_area_compliance",
    "driving_direction_compliance",
    "traffic_light_compliance",
    "ego_progress",
    "time_to_collision_within_bound",
    "lane_keeping",
    "history_comfort",
    "two_frame_extended_comfort",
    "score",
)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of the catalogue, a run over it, and plans in a file."""
    folder = tmp_path_factory.mktemp("score")
    assert replan("synth", "everyday/cut_in", "-o", folder / "logs").exit_code == 0
    run = replan(
        "evaluate",
        folder / "logs",
        "-p",
        "constant_speed",
        "-o",
        folder / "run",
        "--workers",
        0,
        "--no-recording",
        "--traffic",
        "time",
        "--set",
        "loop.plan_period_s=0.5",
    )
    assert (folder / "run" / "summary.json").is_file(), run.output
    plans = pd.read_parquet(VALUES / "navsim_plans.parquet")
    plans = plans[plans.drive.str.startswith("everyday_cut_in")]
    names = plans.drive.str.rsplit("__", n=1).str
    plans.assign(log=names[0], drive=names[1]).rename(columns={"t": "t_s"}).to_csv(
        folder / "plans.csv", index=False
    )
    return folder


def test_a_run_has_the_scores_of_its_drives(place: Path) -> None:
    out = place / "cls.parquet"
    done = replan("score", place / "run", "--as", "nuplan-cls", "-o", out)
    assert done.exit_code == 0, done.output
    assert "CLS-NR" in done.output
    table = pd.read_parquet(out)
    assert tuple(table.columns) == ("scenario", "planner_name", *NUPLAN)
    assert table.scenario.tolist() == ["everyday/cut_in", "final_score"]
    assert table.iloc[1][list(NUPLAN)].tolist() == table.iloc[0][list(NUPLAN)].tolist()
    metrics = pd.read_parquet(place / "run" / "metrics.parquet").set_index("metric").value
    assert table.score[0] == pytest.approx(metrics["nuplan_closed.score.final"])


def test_a_run_has_the_scores_of_its_plans(place: Path) -> None:
    out = place / "plans_of_run.csv"
    assert replan("score", place / "run", "--as", "navsim-v2", "-o", out, "-q").exit_code == 0
    table = pd.read_csv(out)
    assert tuple(table.columns) == ("token", "log_name", "agent", "start_time", *NAVSIM)
    rows = table[table.token != "average_all_frames"]
    assert rows.start_time.tolist() == [0.5 * k for k in range(len(rows))]
    assert rows.two_frame_extended_comfort.isna().sum() == 1  # the first plan has none before it
    assert table.score.iloc[-1] == pytest.approx(rows.score.mean())


def test_a_file_of_trajectories_has_the_scores_of_the_original(place: Path) -> None:
    out = place / "scores.csv"
    done = replan(
        "score",
        place / "logs",
        "--trajectories",
        place / "plans.csv",
        "--as",
        "navsim-v2",
        "-o",
        out,
    )
    assert done.exit_code == 0, done.output
    assert "two_frame_extended_comfort: 18 of 18 windows" in done.output
    table = pd.read_csv(out)
    values = pd.read_csv(VALUES / "navsim_original.csv")
    values = values[values.drive.str.startswith("everyday_cut_in")]
    names = {(row.drive.rsplit("__", 1)[1], float(row.t)): row.EP for row in values.itertuples()}
    rows = table[table.token != "average_all_frames"]
    for row in rows.itertuples():
        assert row.ego_progress == pytest.approx(names[row.agent, row.start_time], abs=1e-4)
    relative = pd.read_csv(place / "plans.csv")
    relative = relative[relative.t_s == 4.0]
    # The ego at 4 s: it starts at 10 m and drives at 16.7 m/s along x
    relative["x"] -= 10.0 + 4.0 * 16.7
    relative.to_csv(place / "relative.csv", index=False)
    words = (
        "--trajectories",
        place / "relative.csv",
        "--relative",
        "--as",
        "navsim-v2",
        "-o",
        place / "again.csv",
    )
    assert replan("score", place / "logs", *words).exit_code == 0
    again = pd.read_csv(place / "again.csv").set_index("agent").ego_progress
    assert again["dp_qp"].iloc[0] == pytest.approx(names["dp_qp", 4.0], abs=1e-3)


def test_a_long_table_of_two_stages_is_shown_by_its_means(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("replan.cli.score.MOST_ROWS", 1)
    plans = pd.read_csv(place / "plans.csv")
    plans = plans[(plans.drive == "idm") & plans.t_s.isin([2.0, 6.0])]
    follows = plans.t_s.map({2.0: None, 6.0: "first"})
    tokens = plans.t_s.map({2.0: "first", 6.0: "second"})
    plans.assign(token=tokens, stage_one=follows).to_csv(tmp_path / "staged.csv", index=False)
    words = ("--trajectories", tmp_path / "staged.csv", "--as", "navsim-v2")
    shown = replan("score", place / "logs", *words).output
    for mean in ("stage_one", "stage_two", "combined"):
        assert f"extended_pdm_score_{mean}" in shown.partition("Not exact:")[0]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda t: t.drop(columns="yaw"), "no column yaw"),
        (lambda t: t.drop(columns="t_s").assign(token="a"), "a token names no time"),
        (lambda t: t.iloc[:-1], "7 poses"),
        (lambda t: t.assign(log="other"), "other"),
        (lambda t: t.assign(t_s=500.0), "500"),
        (lambda t: t.assign(x="here"), "no finite number"),
        (lambda t: t.assign(after_s=t.after_s + 0.1), "after_s"),
        (lambda t: t.iloc[:0], "no rows"),
        (lambda t: t.assign(log=None), "log of row 1 is empty"),
        (lambda t: t.assign(drive=None), "drive of row 1 is empty"),
        (lambda t: t.assign(x=1e300), "--relative"),
        (lambda t: t.assign(y=t.y + 1e4), "--relative"),
    ],
)
def test_a_bad_file_is_one_line(place: Path, tmp_path: Path, change: object, says: str) -> None:
    plans = pd.read_csv(place / "plans.csv")
    one = plans[(plans.drive == "idm") & (plans.t_s == 6.0)]
    change(one).to_csv(tmp_path / "bad.csv", index=False)  # type: ignore[operator]
    done = replan(
        "score", place / "logs", "--trajectories", tmp_path / "bad.csv", "--as", "navsim-v2"
    )
    assert done.exit_code == 2
    assert says in one_error(done)


def test_bad_words_are_one_line(place: Path, tmp_path: Path) -> None:
    (tmp_path / "agent.pkl").write_bytes(b"\x80\x04N.")
    plans = place / "plans.csv"
    for words, says in (
        ((place / "logs", "--as", "nuplan-cls"), "folder of results"),
        ((place / "logs", "--as", "navsim-v2"), "--trajectories"),
        ((place / "run", "--as", "nuplan-cls", "--trajectories", plans), "--trajectories"),
        ((place / "run", "--as", "navsim-v2", "-o", tmp_path / "a.xlsx"), ".parquet"),
        (
            (place / "logs", "--as", "navsim-v2", "--trajectories", tmp_path / "agent.pkl"),
            "pickles",
        ),
        (
            (place / "logs", "--as", "navsim-v2", "--trajectories", tmp_path / "none.csv"),
            "none.csv",
        ),
        ((tmp_path / "nowhere", "--as", "navsim-v2", "--trajectories", plans), "nowhere"),
    ):
        done = replan("score", *words)
        assert done.exit_code == 2, (words, done.output)
        assert says in one_error(done)
