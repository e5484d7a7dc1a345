"""Open recordings in the Rerun viewer: a recording, a log, or all recordings of a result folder."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from logs.errors import ConfigError, ReplanError
from logs.readers import LogSettings, read_log
from replay.viewer import LOOPBACK, environment, free_port, in_use

ELSEWHERE = (
    "copy the .rrd to a machine with one and open it there with `rerun FILE.rrd`, or add --web to see it in a browser"
)
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
    """Write a log of any format as a recording; LogError where it cannot be read, OutputError where `out` cannot."""
    from replay.recording import write_log_recording

    write_log_recording(out, read_log(log, settings))


def show(files: list[Path], memory_limit: str, *, web: bool = False, port: int = 9090) -> None:
    """Run the viewer on recordings until it is closed; it listens on this machine only.

    Args:
        files: The recordings.
        memory_limit: Of the viewer ("2GB", "50%").
        web: In the browser.
        port: Of the page, with `web`.

    Raises:
        ConfigError: The port is in use.
        ReplanError: There is no display, or the viewer ended with an error (no graphics driver).
    """
    if not web and sys.platform == "linux" and not {"DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"} & {*os.environ}:
        raise ReplanError(f"there is no display here (DISPLAY and WAYLAND_DISPLAY are not set); {ELSEWHERE}")
    if web and in_use(port):
        raise ConfigError(f"port {port} is in use; close what uses it (another viewer?), or name another with --port")
    command = [sys.executable, "-m", "rerun", "--bind", LOOPBACK, "--port", str(free_port())]
    command += ["--memory-limit", memory_limit]
    command += ["--web-viewer", "--web-viewer-port", str(port)] if web else []
    with environment() as variables:
        code = subprocess.run([*command, *map(str, files)], env=variables, check=False).returncode
    if code:
        raise ReplanError(f"the viewer ended with an error (above); without a display or graphics driver, {ELSEWHERE}")
