"""Kernels compiled beforehand: what a folder of them needs to be of use, and when it is said that
there are none.
"""

import os
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest
from worker_tasks import count_files, touch, wait_for_beside

from replan.config import RunConfig
from replan.replay.parts import PLANNER
from replan.run.evaluate import compile_planning
from replan.run.pool import run_all

ASK = """
import os, tempfile
if os.environ.get("READ_ONLY"):  # stands for a file system that is read-only: root may write anywhere else
    def refused(*_, **__):
        raise OSError("read-only file system")
    os.makedirs = os.mkdir = tempfile.TemporaryFile = refused
import replan.core.kernel as kernel, replan.logs.shapes as shapes, gc
watch = kernel.KernelWatch()
cold, corners = kernel.is_cache_cold(), shapes.corners(1.0, 2.0, 0.5, 4.0, 2.0).tolist()
print(watch.stored == 0 and cold, corners, kernel.compiled_count() > 0, watch.look() == 0 and watch.stored == 0)
print(gc.isenabled())
"""  # noqa: E501


def _asked(folder: Path, **more: str) -> tuple[list[str], str]:
    """What a fresh process says with its kernels in a folder, none beside the sources: its lines,
    and stderr.
    """
    copy = folder.parent / "copy"
    for source, package in (("replan", "replan"), ("logs", "replan/logs")):
        shutil.copytree(
            source, copy / package, ignore=shutil.ignore_patterns("__pycache__"), dirs_exist_ok=True
        )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(copy), *sys.path]), **more}
    environment.pop("NUMBA_DISABLE_JIT", None)
    done = subprocess.run(
        [sys.executable, "-c", ASK],
        env={**environment, "NUMBA_CACHE_DIR": str(folder)},
        cwd=folder.parent,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.splitlines(), done.stderr


@pytest.mark.slow
def test_kernels_are_compiled_once_for_a_processor_and_read_where_nothing_can_be_written(
    tmp_path: Path,
) -> None:
    kept = tmp_path / "kernels"
    kept.mkdir()
    first, _ = _asked(kept)
    assert (
        first[0].startswith("True [[") and first[0].endswith(" True False") and first[1] == "True"
    )
    files = sorted(kept.rglob("*.nb?"))
    again, said = _asked(kept, READ_ONLY="1")
    assert again[0].startswith("False [[") and again[0].endswith(" False False") and said == ""
    assert sorted(kept.rglob("*.nb?")) == files
    other, _ = _asked(kept, NUMBA_CPU_NAME="generic")
    assert other == first


@pytest.mark.slow
def test_one_worker_does_first_what_all_workers_need(tmp_path: Path) -> None:
    ended = [
        index
        for index, _ in run_all(
            count_files, [tmp_path / str(k) for k in range(4)], 4, one_first=True
        )
    ]
    others = {int((tmp_path / str(k)).read_text()) for k in range(3)}
    assert ended[0] == 3 and sorted(ended) == [0, 1, 2, 3]
    assert (tmp_path / "3").read_text() == "0" and others <= {1, 2, 3}


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 2])
def test_beside_the_first_item_another_process_does_other_work(
    tmp_path: Path, workers: int
) -> None:
    beside, first = partial(touch, tmp_path / "beside"), [tmp_path / "other", tmp_path / "first"]
    ended = [
        index
        for index, _ in run_all(wait_for_beside, first, workers, one_first=True, meanwhile=beside)
    ]
    assert sorted(ended) == [0, 1] and (tmp_path / "beside").exists()


@pytest.mark.slow
def test_the_head_start_compiles_what_a_plan_needs() -> None:
    """Without an error, of all built-in planners.

    A planner of a user is left to its own process.
    """
    names = (*PLANNER.causal, "nobody:Knows", "logged")
    compile_planning(RunConfig(planners=names))
