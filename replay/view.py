"""Open recordings in the Rerun viewer: a recording, a log, or all recordings of a result folder."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from logs.errors import ConfigError, ReplanError
from logs.readers import LogSettings, read_log

MOST = 12
"""Recordings opened at once: each takes memory in the viewer."""


def recordings(target: Path) -> list[Path]:
    """The recordings of a folder, sorted by path.

    Raises:
        ConfigError: There are none, or too many to open at once.
    """
    found = sorted(target.rglob("*.rrd"))
    if not found:
        raise ConfigError(f"{target}: no recording (*.rrd) in it; `replan evaluate` without --no-recording writes them")
    if len(found) > MOST:
        raise ConfigError(
            f"{target}: {len(found)} recordings are too many to open at once (at most {MOST});"
            f" name a log's folder or a recording, for example {found[0]}"
        )
    return found


def save_log(log: Path, out: Path, settings: LogSettings | None = None) -> None:
    """Write a log of any format as a recording; LogError where it cannot be read, ReplanError where `out` cannot."""
    from replay.recording import write_log_recording

    scenario = read_log(log, settings)
    try:
        write_log_recording(out, scenario)
    except OSError as error:
        raise ReplanError(f"{out}: cannot be written: {error.strerror or error}") from None


def show(files: list[Path], memory_limit: str, *, web: bool = False) -> None:
    """Run the viewer on recordings until it is closed.

    Raises:
        ReplanError: It ended with an error (no display, no graphics driver).
    """
    command = [sys.executable, "-m", "rerun", "--memory-limit", memory_limit, *map(str, files)]
    if web:
        command.append("--web-viewer")
    if subprocess.run(command, check=False).returncode:
        raise ReplanError(
            "the viewer ended with an error (above); without a display, copy the .rrd to a machine with one and open it"
            " there with `rerun FILE.rrd`, or add --web to see it in a browser"
        )
