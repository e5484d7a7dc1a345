"""How the Rerun viewer is started: it listens on this machine only, and reports to no one."""

from __future__ import annotations

import json
import os
import socket
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

LOOPBACK = "127.0.0.1"
SETTINGS = {
    "analytics_enabled": False,
    "analytics_id": "",
    "metadata": {},
    "config_file_path": "",
    "data_dir_path": "",
}


@contextmanager
def environment(**more: str) -> Iterator[dict[str, str]]:
    """Ours, with settings of the viewer in a folder of its own, its analytics off; the user's stay as they are.

    On Windows the viewer takes the user's settings whatever the environment says.
    """
    with tempfile.TemporaryDirectory(prefix="replan-viewer-") as folder:
        variable, below = (
            ("HOME", "Library/Application Support") if sys.platform == "darwin" else ("XDG_CONFIG_HOME", "")
        )
        file = Path(folder) / below / "rerun" / "analytics.json"
        file.parent.mkdir(parents=True)
        file.write_text(json.dumps(SETTINGS), encoding="utf-8")
        yield {**os.environ, variable: folder, **more}


def free_port() -> int:
    """A port that is not in use."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        port: int = probe.getsockname()[1]
        return port


def in_use(port: int) -> bool:
    """Whether something listens on a port of this machine, or it may not be taken."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # one that has just been closed is free
        try:
            probe.bind((LOOPBACK, port))
        except OSError:
            return True
    return False
