"""What a planner's module loads, it loads once in a worker.

The drives still know nothing of each other.
"""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from textwrap import dedent

import pytest
from process_tree import are_gone
from short_logs import short

from replan.config import RunConfig
from replan.core.errors import PlannerError
from replan.logs.states import TRAJECTORY_COLUMNS
from replan.logs.trace import EndReason, Trace
from replan.replay.drive import DriveKey
from replan.replay.loop.open_loop import run_open_loop
from replan.replay.loop.planning import Planning
from replan.replay.loop_config import DEFAULT_LOOP, LoopConfig, PlannerProcessConfig
from replan.replay.planner_process.launcher import ENDING_S
from replan.replay.planner_process.processes import _warm, set_template_run
from replan.run.evaluate import evaluate_logs
from replan.run.one_log import LOOPS

pytestmark = pytest.mark.usefixtures("folder")

COUNTED = """
from replan.planners.constant_speed import ConstantSpeed
with open("loads.{name}", "a") as file:
    file.write("x")
{more}
"""
MINE = "class Mine(ConstantSpeed): pass\n"


@pytest.fixture(autouse=True)
def run() -> Iterator[None]:
    set_template_run("a run")
    yield
    set_template_run("")


def written(name: str, more: str = MINE) -> str:
    """A module that counts how often it is loaded; the name of its planner."""
    Path(f"{name}.py").write_text(COUNTED.format(name=name, more=dedent(more)), encoding="utf-8")
    return f"{name}:Mine"


def loads(name: str) -> int:
    return len(Path(f"loads.{name}").read_text(encoding="utf-8"))


def driven(
    planner: str, *, again: bool = False, config: LoopConfig = DEFAULT_LOOP, **settings: object
) -> Trace:
    def seat(*given: object, **named: object) -> Planning:
        return Planning(*given, place=DriveKey(again=again), **named)  # type: ignore[arg-type]

    return run_open_loop(
        short("test/a"), planner, planner_config=settings, config=config, seat=seat
    ).trace


def plans(trace: Trace) -> list[bytes]:
    return [
        getattr(one.plan.trajectory, name).tobytes()
        for one in trace.frames
        for name in TRAJECTORY_COLUMNS
    ]


@pytest.mark.slow
def test_a_module_is_loaded_once_in_a_run_and_anew_in_the_next() -> None:
    planner, log = written("once"), short("test/a")
    for loop in LOOPS.values():
        assert loop(log, planner).trace.end is not EndReason.PLANNER_FAILURE
    assert loads("once") == 1
    driven(planner, again=True)
    driven(planner, again=True)
    assert loads("once") == 2, "the second drive of a start has another"
    driven(planner, step_s=0.2)
    assert loads("once") == 3, "other settings"
    set_template_run("another run")
    driven(planner)
    assert loads("once") == 4
    set_template_run("")
    driven(planner)
    driven(planner)
    assert loads("once") == 6, "outside a run each drive loads it"


def test_drives_do_not_see_what_earlier_drives_left() -> None:
    kept = """
        import os
        drives = []
        class Mine(ConstantSpeed):
            def __init__(self, context):
                super().__init__(context)
                drives.append(1)
                os.environ["DRIVEN"] = os.environ.get("DRIVEN", "") + "x"
                if len(drives) > 1 or os.environ["DRIVEN"] != "x":
                    raise ValueError("has driven before")
        """
    planner = written("kept", kept)
    for _ in range(3):
        assert driven(planner).end is EndReason.END_OF_LOG
    assert loads("kept") == 1


UNFIT = {
    "threads": (
        "import threading, time\nthreading.Thread(target=time.sleep, args=(1e6,), "
        "daemon=True).start()"
    ),
    "files": "kept = open(__file__)",
    "processes": "import subprocess, sys\nsubprocess.Popen(['sleep', '1e6'])",
}


@pytest.mark.parametrize("name", UNFIT)
def test_modules_with_threads_files_or_children_are_loaded_by_each_drive(name: str) -> None:
    planner = written(name, UNFIT[name] + "\n" + MINE)
    for drives in (1, 2):
        assert driven(planner).end is EndReason.END_OF_LOG
        assert loads(name) == 1 + drives


BAD = {
    "raises": ("raise OSError('no weights')", "cannot be loaded: OSError: no weights"),
    "exits": ("import os\nos._exit(3)", "its process ended with code 3"),
    "hangs": ("import time\ntime.sleep(1e6)", "did not answer within 1 s while it was built"),
    "hoards": ("import numpy\nkept = numpy.ones(400_000_000)", "MemoryError"),
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name == "hangs")) for name in BAD]
)
def test_a_module_that_cannot_be_loaded_gives_the_same_error_with_and_without_template(
    name: str,
) -> None:
    planner, said = written(name, BAD[name][0] + "\n" + MINE), list[str]()
    start_timeout_s = 1.0 if name == "hangs" else 60.0
    limits = LoopConfig(apart=PlannerProcessConfig(start_timeout_s=start_timeout_s, memory_gb=2.0))
    for run in ("", "a run"):
        set_template_run(run)
        with pytest.raises(PlannerError, match=BAD[name][1]) as failure:
            driven(planner, config=limits)
        said.append(str(failure.value))
    assert said[0] == said[1]


PREPARED = """
    import random
    random.seed(1)
    class Mine(ConstantSpeed):
        weights = None
        def __init__(self, context, *, file: str = "a"):
            super().__init__(context)
            assert self.weights == file
            self.v = random.random()
        @classmethod
        def prepare(cls, *, file: str = "a"):
            assert cls.weights is None
            with open("loads.prepared", "a") as counter:
                counter.write("p")
            cls.weights = file
        def plan(self, frame):
            import dataclasses
            return super().plan(dataclasses.replace(frame, ego=dataclasses.replace(frame.ego, v=self.v)))
    """  # noqa: E501


def test_a_class_prepares_itself_once_and_everywhere_alike() -> None:
    planner, found = written("prepared", PREPARED), list[list[bytes]]()
    for run, expected in (("a run", 2), ("", 6)):
        set_template_run(run)
        found += [plans(driven(planner, file="b")) for _ in range(2)]
        assert loads("prepared") == expected
    assert found[0] == found[1] == found[2] == found[3], (
        "a seed that the module sets holds in each drive"
    )


def test_a_method_of_a_planner_that_is_called_prepare_is_its_own() -> None:
    own = """
        class Mine(ConstantSpeed):
            def prepare(self, frame):
                return frame
            def plan(self, frame):
                return super().plan(self.prepare(frame))
        """
    assert driven(written("own", own)).end is EndReason.END_OF_LOG


@pytest.mark.slow
def test_a_launcher_that_is_not_needed_any_more_ends_at_once() -> None:
    driven(written("ended"))
    begin = time.monotonic()
    _warm["launcher"].close()
    assert time.monotonic() - begin < 0.5 * ENDING_S
    assert driven(written("ended")).end is EndReason.END_OF_LOG


DRAWN = """
    import os
    bend = os.urandom(1)[0] * 1e-6
    class Mine(ConstantSpeed):
        def plan(self, frame):
            import dataclasses
            return super().plan(dataclasses.replace(frame, ego=dataclasses.replace(frame.ego, kappa=bend)))
    """  # noqa: E501


@pytest.mark.slow
@pytest.mark.parametrize("workers", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_a_run_in_a_worker_still_sees_what_is_not_deterministic(
    workers: int, logs: Path, folder: Path
) -> None:
    name = f"drawn{workers}"
    run = RunConfig(
        planners=(written(name, DRAWN),),
        recording=False,
        internals="none",
        mode="open",
        repeat_s=0.2,
    )
    result = evaluate_logs([logs], run, folder / "out", workers=workers)
    assert loads(name) == 1 + 2 * max(workers, 1), "one checks the settings; two in each worker"
    assert len(result.drives) == 3
    assert all(
        any(note.startswith("not deterministic") for note in drive.notes)
        for drive in result.drives.itertuples()
    )
    assert not _warm["launcher"].templates


@pytest.mark.slow
def test_a_worker_that_is_killed_takes_its_templates_along() -> None:
    code = """
        import os, time
        from short_logs import short
        from replan.replay.planner_process.processes import _warm, set_template_run
        from replan.replay.loop.open_loop import run_open_loop
        set_template_run("a run")
        run_open_loop(short("test/a"), "orphans:Mine")
        print(_warm["launcher"]._process.pid, flush=True)
        os.kill(os.getpid(), 9)
        """
    orphan = """
        import os
        from pathlib import Path
        Path("template").write_text(str(os.getpid()), encoding="utf-8")
        """
    written("orphans", dedent(orphan) + MINE)
    places = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    ended = subprocess.run(
        [sys.executable, "-P", "-c", dedent(code)], env=places, capture_output=True, text=True
    )
    pids = [ended.stdout.strip(), Path("template").read_text(encoding="utf-8")]
    assert ended.returncode == -9 and loads("orphans") == 1
    assert are_gone(pids)
