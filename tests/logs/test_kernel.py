"""Kernels without a place for their machine code: they are compiled anew, which is said once."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

NO_PLACE = "import numba.core.caching as c; c.CacheImpl._locator_classes = []\n"
NO_ROOM = """
import errno, numba.core.caching as c
def full(*arguments):
    raise OSError(errno.ENOSPC, "No space left on device")
c.IndexDataCacheFile.save = full
c.IndexDataCacheFile.load = lambda *arguments: None
"""
USE = "from logs.shapes import corners\nprint(corners(1.0, 2.0, 0.5, 4.0, 2.0))\n"


@pytest.mark.parametrize("without", [NO_PLACE, NO_ROOM])
def test_without_a_cache_kernels_are_compiled_anew_and_it_is_said_once(without: str, tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path.cwd()), *sys.path])}
    environment.pop("NUMBA_DISABLE_JIT", None)
    options = {"cwd": tmp_path, "env": environment, "capture_output": True, "text": True, "check": True}
    said = [subprocess.run([sys.executable, "-c", before + USE], **options) for before in (without, "")]
    assert said[0].stdout == said[1].stdout != ""
    assert said[0].stderr.count("compiled kernels cannot be kept") == 1 and "NUMBA_CACHE_DIR" in said[0].stderr
    assert said[1].stderr == ""
