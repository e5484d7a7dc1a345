"""Who goes first at a crossing: a made-up drive in which it is known."""

from dataclasses import replace
from math import inf
from pathlib import Path

import numpy as np
import pytest

from replan.logs.agents import AgentKind
from replan.logs.road import Road
from replan.logs.scenario import Scenario
from replan.logs.states import Trajectory
from replan.logs.tracks import Tracks
from studies.crossings import DrivenPath, compared, crossing_of, main

T = np.arange(0.0, 16.0, 0.1)

PATIENT = np.interp(T, [0.0, 2.0, 5.0, 8.0, 11.0], [10.0, 10.0, 1.0, 1.0, 8.0])


def drive(v: np.ndarray) -> Trajectory:
    zero = np.zeros_like(T)
    x = np.r_[0.0, np.cumsum(0.05 * (v[1:] + v[:-1]))]
    return Trajectory(T, x, zero, zero, v, np.gradient(v, T), zero)


def scene(v: np.ndarray, walks_at: float = 60.0) -> Scenario:
    """Who drives like `v`, and a pedestrian who is on the path at x = `walks_at` from about 5 to 7
    s.
    """
    zero = np.zeros_like(T)
    walker = Tracks(
        ("w",),
        (AgentKind.PEDESTRIAN,),
        np.array([0.5]),
        np.array([0.5]),
        np.array([False]),
        np.array([0, len(T)]),
        T,
        zero + walks_at,
        1.5 * (T - 6.0),
        zero + 1.57,
        zero,
        zero + 1.5,
    )
    ego = drive(v)
    road = Road.along(np.column_stack([np.arange(-10.0, 200.0), np.zeros(210)]), speed_limit=14.0)
    return Scenario("made", ego, walker, road, float(T[-1]), tags=("recorded",))


def test_the_crossing_is_where_and_when_someone_was_on_the_path() -> None:
    patient = scene(PATIENT)
    crossing = crossing_of(patient, DrivenPath(patient.ego))
    assert crossing is not None and crossing.place == pytest.approx(60.0, abs=0.1)
    assert crossing.begin == pytest.approx(6.0 - 1.6 / 1.5, abs=0.1)
    assert crossing.end == pytest.approx(6.0 + 1.6 / 1.5, abs=0.1)
    assert (
        crossing_of(
            scene(np.full_like(T, 10.0), walks_at=400.0), DrivenPath(drive(np.full_like(T, 10.0)))
        )
        is None
    )


def test_waiting_is_yielding_and_driving_on_is_going_first() -> None:
    patient = compared(scene(PATIENT), "logged")
    assert patient is not None and patient.human_yields and patient.planner_yields == "yes"
    assert (
        patient.delay == pytest.approx(0.0, abs=0.2)
        and patient.plans == patient.plans_that_yield > 20
    )
    quick = scene(PATIENT, walks_at=70.0)
    eager = compared(replace(quick, ego=replace(quick.ego, v=PATIENT + 6.0)), "constant_speed")
    assert eager is not None and eager.human_yields and eager.planner_yields == "no"
    assert eager.planner_passes < eager.human_passes < inf and eager.plans_that_yield < eager.plans
    blind = compared(scene(PATIENT), "constant_speed")
    assert blind is not None and (blind.planner_yields, blind.end) == ("ended", "collision")


def test_the_command_writes_a_row_a_log_and_names_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from replan.logs.mcap import write_scenario

    write_scenario(tmp_path / "a.mcap", scene(PATIENT))
    write_scenario(tmp_path / "b.mcap", scene(np.full_like(T, 10.0), walks_at=400.0))
    main(
        [
            str(tmp_path / "a.mcap"),
            str(tmp_path / "b.mcap"),
            "-o",
            str(tmp_path / "out"),
            "-p",
            "constant_speed",
        ]
    )
    said = capsys.readouterr().out
    assert said.count("| made |") == 1 and "No one on the path ahead of the driver" in said
    assert (tmp_path / "out" / "crossings.csv").read_text(encoding="utf-8").count("\n") == 2
