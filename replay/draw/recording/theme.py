"""The viewer's theme, set by a click in its settings: a headless viewer reads none, and its client has no call for it.

The viewer's own server for agents (MCP: a JSON message a line on its stdin and stdout) clicks.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from replay.draw.viewer import LOOPBACK, Theme

SETTINGS = "about:settings"
AWAY = (1, 1)
"""Where the pointer is left: in the header, which no picture has."""


def clicked(theme: Theme, binary: Path, port: int, variables: Mapping[str, str], timeout: float) -> str:
    """Click a theme in the settings, which must be shown; what went wrong, "" where nothing did.

    Args:
        theme: Which.
        binary: Of the viewer.
        port: Of the viewer that runs.
        variables: Of the environment.
        timeout: s.
    """
    actions = [
        {"name": "wait_for", "args": {"label_contains": theme.title()}},
        {"name": "click", "args": {"label_contains": theme.title()}},
        {"name": "hover", "args": {"pos": AWAY}},
    ]
    start = {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "replan", "version": "1"}}
    messages: list[dict[str, Any]] = [
        {"id": 1, "method": "initialize", "params": start},
        {"method": "notifications/initialized"},
        {"id": 2, "method": "tools/call", "params": {"name": "batch", "arguments": {"actions": actions}}},
    ]
    said = "".join(json.dumps({"jsonrpc": "2.0", **message}) + "\n" for message in messages)
    command = [str(binary), "viewer-mcp", "--endpoint", f"http://{LOOPBACK}:{port}"]
    try:
        done = subprocess.run(
            command, input=said, env=dict(variables), capture_output=True, text=True, timeout=timeout, check=False
        )
    except subprocess.TimeoutExpired:
        return f"its server for agents did not answer within {timeout:g} s"
    answers = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    result = next((one.get("result", one) for one in answers if one.get("id") == 2), {"isError": True})
    return str(result.get("content", done.stderr)) if result.get("isError", True) else ""
