"""Planners in a process of their own: the same results, and whatever they do costs their own drive
only.
"""

import signal
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from handmade import drive, lanes_along, scenario, straight, track, tracks
from process_tree import are_gone, descendants, started
from scenes import perceive

from replan.config import RunConfig
from replan.core.errors import ConfigError, PlannerError
from replan.logs.agents import NUMBERS, OPTIONAL
from replan.logs.catalogue import CATALOGUE
from replan.logs.frame import PlannerContext
from replan.logs.mcap import write_scenario
from replan.logs.mcap.trace_file import plan_message
from replan.logs.road import Goal
from replan.logs.scenario import Scenario
from replan.logs.states import TRAJECTORY_COLUMNS
from replan.logs.trace import EndReason, Trace
from replan.metrics import evaluate
from replan.replay.loop.closed_loop import run_closed_loop
from replan.replay.loop.open_loop import run_open_loop
from replan.replay.loop_config import LoopConfig, PlannerProcessConfig
from replan.replay.planner_process import messages
from replan.replay.planner_process.connection import clean_text, describe_planner
from replan.replay.planner_process.messages import (
    context_message,
    context_of,
    decode,
    encode,
    frame_message,
    frame_of,
)
from replan.replay.planner_process.processes import _warm, set_template_run
from replan.replay.world import World
from replan.run.one_log import LOOPS
from replan.run.resume import stamp_of

SHORT = LoopConfig(apart=PlannerProcessConfig(plan_timeout_s=0.4, memory_gb=2.0))


def short_log() -> Scenario:
    """A second of driving behind a parked car; it holds a hundred states."""
    ego = drive(straight, 10.0, 1.0)
    parked = track("parked", [0.0], [80.0], [-3.0], static=True)
    return scenario(ego, road=lanes_along(ego), agents=tracks(parked))


def ended(planner: str, config: LoopConfig = SHORT) -> Trace:
    return run_open_loop(short_log(), planner, config=config).trace


def nothing_is_left() -> bool:
    """Whether all that the launcher has started is gone; zombies count."""
    launcher = _warm["launcher"]._process.pid
    return are_gone(descendants(launcher)) and not descendants(launcher)


@pytest.mark.parametrize(
    ("name", "built_in", "apart"),
    [
        ("paper/free_road", "idm", "replan.planners.idm:Idm"),
        pytest.param(
            "everyday/nudge", "dp_qp", "replan.planners.dp_qp:DpQp", marks=pytest.mark.slow
        ),
        pytest.param("everyday/junction", "idm", "replan.planners.idm:Idm", marks=pytest.mark.slow),
    ],
)
def test_what_is_driven_does_not_depend_on_the_process(
    name: str, built_in: str, apart: str
) -> None:
    log = CATALOGUE[name].scenario()
    for run in LOOPS.values():
        one, two = run(log, built_in).trace, run(log, apart).trace
        assert (one.end, one.detail, one.notes) == (two.end, two.detail, two.notes)
        for a, b in zip(one.frames, two.frames, strict=True):
            for column in TRAJECTORY_COLUMNS:
                assert np.array_equal(
                    getattr(a.plan.trajectory, column), getattr(b.plan.trajectory, column)
                )
            assert (a.plan.status, a.plan.reason, a.plan.start) == (
                b.plan.status,
                b.plan.reason,
                b.plan.start,
            )
            assert plan_message(a.plan, "full") == plan_message(b.plan, "full")
        tables = [evaluate(trace, log).drop(columns="planner") for trace in (one, two)]
        assert tables[0].equals(tables[1])


def test_threads_that_start_planners_at_once_share_one_launcher(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Before, each of the first threads had a launcher of its own, which ended as the next one
    began.
    """
    monkeypatch.setattr("replan.replay.planner_process.processes._warm", {})
    program = f"exec:{sys.executable} {Path(__file__).parents[3] / 'examples' / 'planner_exec.py'}"
    with ThreadPoolExecutor(12) as pool:
        traces = list(pool.map(lambda planner: ended(planner, LoopConfig()), [program] * 12))
    assert {trace.end for trace in traces} == {EndReason.END_OF_LOG}


SAID = {
    "Raises": "raised at 0.50 s: ValueError: no way ahead?[31m (bad_planners.py:",
    "ReturnsNone": "broke its contract at 0.50 s: it returned NoneType instead of a Plan",
    "NotFinite": "raised at 0.50 s: ValueError: x is not finite at index 0",
    "Past": "broke its contract at 0.50 s: its plan starts at -0.500 s, not at the frame's time",
    "Sleeps": "did not answer within 0.4 s at t = 0.50 s; it printed last: zzz",
    "Loops": "did not answer within 0.4 s at t = 0.50 s",
    "Allocates": "raised at 0.50 s: MemoryError: Unable to allocate",
    "SysExits": "raised at 0.50 s: SystemExit: 3 (bad_planners.py:",
    "Exits": (
        "exited at t = 0.50 s: its process ended with code 7; it printed last: going?[31m home"
    ),
    "ExitsWell": "exited at t = 0.50 s: its process ended with code 0",
    "Segfaults": "exited at t = 0.50 s: its process was killed (SIGSEGV)",
    "Closes": "exited at t = 0.50 s: it closed its output",
    "Babbles": "sent an invalid message at t = 0.50 s: ",
    "Writes": (
        "raised at 0.50 s: ValueError: cannot set WRITEABLE flag to True of this array "
        "(bad_planners.py:"
    ),
    "Daemon": "did not answer within 0.4 s at t = 0.50 s",
    "Shows": "broke its contract at 0.50 s: its inside and its alternatives have 20000",
    "Stages": "broke its contract at 0.50 s: it names 1001 stages, more than 100",
    "RaisesMuch": "raised at 0.50 s: ValueError: xxx",
}


@pytest.mark.parametrize("name", SAID)
def test_a_bad_planner_ends_its_own_drive_with_one_line(name: str) -> None:
    begin = time.monotonic()
    trace = ended(f"bad_planners:{name}")
    assert time.monotonic() - begin < 60.0
    assert trace.end is EndReason.PLANNER_FAILURE and len(trace.frames) == 5
    assert trace.detail.startswith(f"planner 'bad_planners:{name}' on handmade {SAID[name]}"), (
        trace.detail
    )
    assert trace.detail.isprintable() and len(trace.detail) < 1500
    assert nothing_is_left()


def test_the_time_to_read_an_answer_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    def slowly(message: object) -> object:
        time.sleep(0.5)
        return plan_of(message)

    plan_of = messages.plan_of
    monkeypatch.setattr(messages, "plan_of", slowly)
    assert (
        "needed more than 0.4 s, reading of its plan included, at t = "
        in ended("replan.planners.constant_speed:ConstantSpeed").detail
    )


@pytest.mark.parametrize("name", ["Far", "OneState", "Prints", "Random", "Threads"])
def test_what_is_only_odd_is_driven_and_judged(name: str) -> None:
    trace = ended(f"bad_planners:{name}", LoopConfig())
    assert (trace.end, trace.detail, len(trace.frames)) == (EndReason.END_OF_LOG, "", 11)
    assert nothing_is_left()


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("Long", "it has 300000 states, more than 10000"),
        ("Verbose", "xxx ... (cut, 50000000 characters)"),
    ],
)
def test_what_is_too_large_in_every_plan_is_cut_or_refused_within_seconds(
    name: str, reason: str
) -> None:
    begin = time.monotonic()
    trace = ended(f"bad_planners:{name}", LoopConfig(apart=PlannerProcessConfig()))
    assert (trace.end, len(trace.frames)) == (EndReason.END_OF_LOG, 11)
    assert all(frame.plan.reason.endswith(reason) for frame in trace.frames[5:])
    assert time.monotonic() - begin < 20.0
    assert sum(len(frame.plan.reason) for frame in trace.frames) < 10_000


@pytest.mark.skipif(
    not Path("/proc/self/task").exists(), reason="orphans are taken over on Linux alone"
)
@pytest.mark.parametrize("name", ["Detaches", "DetachesAndExits"])
@pytest.mark.parametrize("within_a_run", [False, True])
def test_processes_in_sessions_of_their_own_end_with_the_drive(
    name: str, within_a_run: bool, folder: Path
) -> None:
    (folder / "detached").unlink(missing_ok=True)
    set_template_run("a run" if within_a_run else "")
    trace = ended(f"bad_planners:{name}", LoopConfig(apart=PlannerProcessConfig()))
    set_template_run("")
    assert len(trace.frames) == (11 if name == "Detaches" else 5), trace.detail
    pids = (folder / "detached").read_text().split()
    assert len(pids) == 2 and are_gone(pids)
    assert nothing_is_left()


def test_who_peeps_finds_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SECRET_LOG", "SECRET")
    for run in LOOPS.values():
        assert (
            "ValueError: found []"
            in run(short_log(), "bad_planners:Peeps", config=SHORT).trace.detail
        )


def test_who_peeps_would_find_much_where_it_is_trusted() -> None:
    trusted = LoopConfig(apart=PlannerProcessConfig(trust=True))
    detail = run_closed_loop(short_log(), "bad_planners:Peeps", config=trusted).trace.detail
    assert "object Scenario" in detail and "frame Scenario" in detail


def test_a_variable_that_is_named_is_passed_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SECRET_LOG", "mine")
    limits = PlannerProcessConfig(environment=("SECRET_LOG",))
    assert "variable SECRET_LOG" in ended("bad_planners:Peeps", LoopConfig(apart=limits)).detail


@pytest.mark.slow
def test_the_whole_drive_may_be_limited() -> None:
    limits = PlannerProcessConfig(log_timeout_s=5.0)
    assert (
        "took more than 5 s in this drive, at t = 0.50 s"
        in ended("bad_planners:Sleeps", LoopConfig(apart=limits)).detail
    )


def test_a_planner_that_cannot_be_built_or_loaded_is_an_error() -> None:
    with pytest.raises(
        PlannerError, match=r"handmade cannot be built: KeyError: 'weights.bin' \(bad_planners.py:"
    ):
        ended("bad_planners:Unbuilt")
    with pytest.raises(ConfigError, match="wieght"):
        run_open_loop(short_log(), "bad_planners:Unbuilt", planner_config={"wieght": 2.0})
    with pytest.raises(PlannerError, match="no_such_module"):
        ended("no_such_module:Mine")
    with pytest.raises(ConfigError, match="no program nowhere"):
        ended("exec:nowhere --fast")
    with pytest.raises(ConfigError, match="tcp://HOST:PORT"):
        ended("tcp://localhost")
    with pytest.raises(PlannerError, match="cannot be reached: Connection refused"):
        ended("tcp://127.0.0.1:9")


def test_settings_are_asked_of_the_planner_and_reach_it() -> None:
    spec = "replan.planners.constant_speed:ConstantSpeed"
    assert describe_planner(spec, {"step_s": 0.2}, PlannerProcessConfig()) == {
        "horizon_s": 8.0,
        "step_s": 0.2,
    }
    with pytest.raises(ConfigError, match="horizon"):
        describe_planner(spec, {"horizon": 4.0}, PlannerProcessConfig())
    trace = run_closed_loop(
        short_log(), spec, planner_config={"horizon_s": 4.0, "step_s": 0.2}
    ).trace
    assert len(trace.frames[0].plan.trajectory) == 21


def test_another_program_is_not_resumed_with(tmp_path: Path) -> None:
    program = tmp_path / "planner.py"
    stamps = []
    for text in ("one", "two", "one"):
        program.write_text(text, encoding="utf-8")
        stamps.append(stamp_of(RunConfig(planners=(f"exec:{sys.executable} {program} --fast",))))
    assert stamps[0] == stamps[2] != stamps[1]


def test_control_characters_do_not_reach_the_terminal() -> None:
    assert clean_text("a\x1b[2J\r\nb\x00\u202ec") == "a?[2J b??c"


@pytest.mark.slow
@pytest.mark.parametrize("workers", ["0", "1"])
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_run_that_ends_takes_a_planner_along_that_hangs(
    tmp_path: Path, how: signal.Signals, workers: str
) -> None:
    write_scenario(tmp_path / "log.mcap", short_log())
    words = (
        "evaluate log.mcap -p bad_planners:Hangs --set loop.apart.plan_timeout_s=1000 -o out "
        "--workers"
    )
    with started(*words.split(), workers, cwd=tmp_path) as run:
        while not (tmp_path / "hangs").exists():
            assert run.poll() is None
            time.sleep(0.05)
        run.send_signal(how)
        run.communicate(timeout=60.0)
    assert run.returncode == (-9 if how is signal.SIGKILL else 130)
    assert are_gone((tmp_path / "hangs").read_text(encoding="utf-8").split())


def test_a_goal_with_alternatives_reaches_the_planner_and_one_without_is_as_before() -> None:
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]])
    plain = Goal((square,), v=(0.0, 5.0))
    both = Goal.any_of([plain, Goal((square + 9.0,), v=(0.0, 0.0))])
    log = scenario(drive(straight, 10.0, 1.0))
    for goal in (plain, both):
        sent = context_message(PlannerContext(log.road, goal, log.vehicle, 0.1, log.ego.state(0)))
        found = context_of(decode(encode(sent), messages.Context), print).goal
        assert found is not None and (found.t, found.v, found.yaw) == (goal.t, goal.v, goal.yaw)
        assert [one.v for one in found.alternatives] == [one.v for one in goal.alternatives]
        np.testing.assert_array_equal(np.vstack(found.regions), np.vstack(goal.regions))
    old = {
        key: value
        for key, value in decode(encode(sent.goal), dict).items()
        if key != "alternatives"
    }
    assert decode(encode(old), Goal).alternatives == ()


def test_agents_reach_the_planner_with_all_columns_and_without_those_of_older_senders() -> None:
    log = scenario(
        drive(straight, 10.0, 1.0), agents=tracks(track("a", [0.4, 0.5], [1.0, 2.0], [0.0, 0.1]))
    )
    frame = perceive(World(log.ego.state(0), log.tracks))
    assert not len(frame.agents)
    frame = perceive(World(replace(log.ego.state(0), t=0.6), log.tracks))
    sent = encode(frame_message(frame))
    found = frame_of(decode(sent, messages.Frame)).agents
    for name in NUMBERS:
        np.testing.assert_array_equal(
            getattr(found, name), getattr(frame.agents, name), err_msg=name
        )
    assert found.age == pytest.approx([0.2]) and found.unseen == pytest.approx([0.1])
    plain = msgspec.msgpack.decode(sent)
    for name in OPTIONAL:
        del plain["agents"][name]
    old = frame_of(decode(encode(plain), messages.Frame)).agents
    assert all(np.isnan(getattr(old, name)).all() for name in OPTIONAL) and old.x == frame.agents.x
