"""How the Rerun viewer is started: it listens on this machine only, and sends nothing to another.

Version 0.41 asks two servers for newer versions, and no setting prevents it. Its HTTP client obeys the usual proxy
variables, so they name a proxy that refuses every connection: the viewer does not even look up the servers' names.
"""

from __future__ import annotations

import json
import os
import socket
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

Theme = Literal["dark", "light"]
LAYOUTS = ("overview", "planner", "control")
"""The tabs of a recording, each a whole window."""
LOOPBACK = "127.0.0.1"
CLOSED = f"http://{LOOPBACK}:9"
"""A proxy that does not exist: port 9 (discard, RFC 863) has no server on current systems."""
SETTINGS = {"analytics_enabled": False, "analytics_id": "", "metadata": {}, "config_file_path": "", "data_dir_path": ""}


@contextmanager
def environment(**more: str) -> Iterator[dict[str, str]]:
    """The environment of a viewer: no analytics, no network, temporary files in a folder that is removed at the end.

    The user's own settings of the viewer are not changed. On Windows the viewer reads them in any environment.
    """
    with tempfile.TemporaryDirectory(prefix="replan-viewer-") as folder:
        variable, below = (
            ("HOME", "Library/Application Support") if sys.platform == "darwin" else ("XDG_CONFIG_HOME", "")
        )
        file = Path(folder) / below / "rerun" / "analytics.json"
        file.parent.mkdir(parents=True)
        file.write_text(json.dumps(SETTINGS), encoding="utf-8")
        ours = {key: value for key, value in os.environ.items() if not key.lower().endswith("_proxy")}
        ours |= dict.fromkeys(("ALL_PROXY", "HTTP_PROXY", "HTTPS_PROXY", "http_proxy", "https_proxy"), CLOSED)
        ours |= {"NO_PROXY": f"{LOOPBACK},localhost", variable: folder}
        yield {**ours, **dict.fromkeys(("TMPDIR", "TEMP", "TMP"), folder), **more}


def free_port() -> int:
    """A port that is not in use."""
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        port: int = probe.getsockname()[1]
        return port


def in_use(port: int) -> bool:
    """Whether a port of this machine is in use, or may not be used."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # one that has just been closed is free
        try:
            probe.bind((LOOPBACK, port))
        except OSError:
            return True
    return False
