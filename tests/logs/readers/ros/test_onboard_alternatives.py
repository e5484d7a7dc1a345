"""The trajectories among which a bag's on-board planner chose (Autoware's candidates)."""

import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ros_bags as bags
from ros_bags import SPEED, Row, ego_pose, header, message, pose, seconds
from rosbags.typesys import get_types_from_msg

from replan.logs.mcap import write_scenario
from replan.logs.readers import read_log
from replan.logs.scenario import Scenario
from replan.logs.states import OnboardPlan
from replan.replay.loop.open_loop import run_open_loop

PLAN = "autoware_planning_msgs/msg/Trajectory"
PACKAGE = "autoware_internal_planning_msgs/msg/"
DEFINITIONS = {
    "CandidateTrajectory": "std_msgs/Header header\nunique_identifier_msgs/UUID generator_id\n"
    "autoware_planning_msgs/TrajectoryPoint[] points\n",
    "ScoredCandidateTrajectory": "CandidateTrajectory candidate_trajectory\nfloat32 score\n",
    "GeneratorInfo": "unique_identifier_msgs/UUID generator_id\nstd_msgs/String generator_name\n",
    "CandidateTrajectories": "CandidateTrajectory[] candidate_trajectories\n"
    "GeneratorInfo[] generator_info\n",
    "ScoredCandidateTrajectories": "ScoredCandidateTrajectory[] scored_candidate_trajectories\n"
    "GeneratorInfo[] generator_info\n",
}
"""As Autoware's interfaces define them, without the later turn indicators."""
TYPES = bags.store()
for name, body in DEFINITIONS.items():
    TYPES.register(get_types_from_msg(body, PACKAGE + name))
SCORES = {"network": 0.75, "rules": 0.25}
BEST = "The on-board plans are the alternatives with the highest scores."


def points(ns: int, speed: float) -> list[dict[str, Any]]:
    """4 s along the arc at a speed, m/s, with times."""
    return [
        {
            "time_from_start": {"sec": k // 10, "nanosec": 100_000_000 * (k % 10)},
            "pose": pose(*ego_pose(seconds(ns) + 0.1 * k * speed / SPEED)),
            "longitudinal_velocity_mps": speed,
        }
        for k in range(41)
    ]


def candidate(ns: int, name: str, speed: float) -> dict[str, Any]:
    return {"header": header(ns), "generator_id": bags.uuid(name), "points": points(ns, speed)}


def drive(*, scored: bool, final: bool) -> list[Row]:
    """A drive whose planner chose between a fast and a slow trajectory; `final`: with its plans."""
    kind = PACKAGE + ("ScoredCandidateTrajectories" if scored else "CandidateTrajectories")
    info = [{"generator_id": bags.uuid(n), "generator_name": {"data": n}} for n in SCORES]
    rows = bags.odometry()
    for ns in bags.times(10):
        shown = [candidate(ns, "network", SPEED), candidate(ns, "rules", 0.5 * SPEED)]
        values: dict[str, Any] = {"candidate_trajectories": shown}
        if scored:
            items = zip(shown, SCORES.values(), strict=True)
            values = {
                "scored_candidate_trajectories": [
                    {"candidate_trajectory": item, "score": score} for item, score in items
                ]
            }
        candidates = message(kind, TYPES, generator_info=info, **values)
        rows.append(("/planning/candidates", kind, ns + 10_000_000, candidates))
        if final:
            planned = message(PLAN, TYPES, header=header(ns), points=points(ns, SPEED))
            rows.append(("/planning/trajectory", PLAN, ns + 20_000_000, planned))
    return rows


def written(folder: Path, *, scored: bool, final: bool) -> Scenario:
    rows = drive(scored=scored, final=final)
    return read_log(bags.write_ros2(folder / "bag", rows, types=TYPES))


@pytest.mark.parametrize(("scored", "final"), [(True, True), (True, False), (False, True)])
def test_plans_have_the_alternatives_that_were_known_then(
    tmp_path: Path, *, scored: bool, final: bool
) -> None:
    log = written(tmp_path, scored=scored, final=final)
    assert len(log.onboard) >= 60
    for plan in log.onboard[1:]:
        assert [alternative.name for alternative in plan.alternatives] == list(SCORES)
        scores = [alternative.score for alternative in plan.alternatives]
        assert scores == list(SCORES.values()) if scored else np.isnan(scores).all()
        fast, slow = (alternative.trajectory for alternative in plan.alternatives)
        assert fast.v == pytest.approx(SPEED)
        assert slow.v == pytest.approx(0.5 * SPEED)
        assert plan.known - 0.1 <= fast.t[0] <= plan.known
        assert plan.trajectory.v == pytest.approx(SPEED, rel=0.02)
    assert (BEST in log.notes) is not final


def test_alternatives_without_scores_are_no_plans(tmp_path: Path) -> None:
    assert not written(tmp_path, scored=False, final=False).onboard


def test_a_bag_without_definitions_is_read_without_alternatives(tmp_path: Path) -> None:
    rows, path = drive(scored=True, final=True), tmp_path / "bag"
    bags.write_ros2(path, rows, sqlite=True, types=TYPES)
    without_definitions(path)
    log = read_log(path)
    assert len(log.onboard) >= 60
    assert not any(plan.alternatives for plan in log.onboard)
    note = "The alternatives of /planning/candidates are not read: the bag does not define"
    assert any(text.startswith(note) for text in log.notes)


def without_definitions(path: Path) -> None:
    """Take the definitions out of a bag, as recorders before ROS 2 Iron wrote it."""
    (data,) = path.glob("*.db3")
    with sqlite3.connect(data) as file:
        file.execute("UPDATE message_definitions SET encoded_message_definition = ''")


def bits(plan: OnboardPlan) -> list[tuple[float, str, bytes]]:
    return [
        (other.score, other.name, other.trajectory.x.tobytes() + other.trajectory.t.tobytes())
        for other in plan.alternatives
    ]


def test_alternatives_stay_when_the_log_is_written_and_read(tmp_path: Path) -> None:
    log = written(tmp_path, scored=True, final=True)
    write_scenario(tmp_path / "log.mcap", log)
    again = read_log(tmp_path / "log.mcap")
    assert list(map(bits, again.onboard)) == list(map(bits, log.onboard))


def test_the_on_board_planner_shows_them(tmp_path: Path) -> None:
    log = written(tmp_path, scored=True, final=True)
    for frame in run_open_loop(log, "onboard").trace.frames[5:]:
        fast, slow = frame.plan.alternatives
        assert fast.trajectory.t[0] == slow.trajectory.t[0] == pytest.approx(frame.t)
        assert (fast.score, slow.name) == (0.75, "rules")
