"""Nothing leaves this machine, and nothing of it can be reached from elsewhere: sockets are watched."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

from logs.mcap import read_scenario
from replay.cli import app
from replay.recording import write_log_recording

pytestmark = pytest.mark.skipif(not Path("/proc/net/tcp").exists(), reason="sockets are read from /proc")
REPLAN = [sys.executable, "-c", "from replay.cli import main; main()"]
LOOPBACK = ("0100007F", "00000000000000000000000001000000", "0000000000000000FFFF00000100007F")
AUDIT = """
import sys
def watch(event, args):
    if event in ("socket.connect", "socket.getaddrinfo", "socket.bind", "socket.sendto"):
        sys.stderr.write(f"SOCKET {event} {args}\\n")
sys.addaudithook(watch)
from replay.cli import main
main()
"""


def tree(pid: int) -> set[int]:
    """A process and all that come of it."""
    parents = {}
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            parents[int(entry.name)] = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
        except (OSError, IndexError):
            continue
    found = {pid}
    while more := {child for child, parent in parents.items() if parent in found} - found:
        found |= more
    return found


def sockets(pid: int) -> set[tuple[str, str, str]]:
    """Local and remote address and state of all of a tree's internet sockets, as /proc has them."""
    inodes = set()
    for one in tree(pid):
        for file in Path(f"/proc/{one}/fd").glob("*"):
            try:
                inodes.add(str(file.readlink()).removeprefix("socket:[").removesuffix("]"))
            except OSError:
                continue
    rows = []
    for kind in ("tcp", "tcp6", "udp", "udp6"):
        table = Path(f"/proc/net/{kind}")
        rows += [line.split() for line in table.read_text().splitlines()[1:]] if table.exists() else []
    return {(row[1], row[2], row[3]) for row in rows if row[9] in inodes}


def abroad(found: set[tuple[str, str, str]]) -> set[tuple[str, str, str]]:
    """Those that are bound or connected to something else than this machine; all zeros is no address yet."""
    return {one for one in found if any(end.strip("0") != ":" and not end.startswith(LOOPBACK) for end in one[:2])}


def watched(words: list[str], folder: Path) -> tuple[set[tuple[str, str, str]], str]:
    """Sockets of a command over its life, and what it said."""
    environment = {**os.environ, "HOME": str(folder), "PYTHONPATH": os.pathsep.join([str(Path.cwd()), *sys.path])}
    command = [sys.executable, "-c", AUDIT, *words]
    seen: set[tuple[str, str, str]] = set()
    with (folder / "said").open("w+") as said:
        process = subprocess.Popen(command, cwd=folder, env=environment, stdout=said, stderr=said)
        while process.poll() is None:
            seen |= sockets(process.pid)
            time.sleep(0.02)
        said.seek(0)
        return seen, said.read()


def test_the_watch_sees_what_it_looks_for() -> None:
    with socket.socket() as everywhere, socket.socket() as here:
        everywhere.bind(("0.0.0.0", 0))
        everywhere.listen()
        here.bind(("127.0.0.1", 0))
        here.listen()
        found = sockets(os.getpid())
        port = f"{everywhere.getsockname()[1]:04X}"
        assert {one[0] for one in abroad(found)} >= {f"00000000:{port}"}
        assert not any(f"{here.getsockname()[1]:04X}" in one[0] for one in abroad(found))


@pytest.mark.slow
def test_no_command_opens_a_socket(logs: Path, tmp_path: Path) -> None:
    log, out = str(logs / "a.mcap"), "out"
    for words in (
        ["evaluate", log, "-p", "constant_speed", "--workers", "1", "-o", out],
        ["report", out],
        ["compare", out, out],
        ["baseline", out, "-o", "baseline.parquet"],
        ["plot", out, "-o", "plot.png"],
        ["view", log, "--save", "log.rrd"],
        ["inspect", log],
        ["convert", log, "-o", "copy.mcap"],
        ["synth", "paper/free_road", "-o", "logs"],
        ["list"],
    ):
        seen, said = watched(words, tmp_path)
        assert not seen, words
        assert "SOCKET" not in said and "Traceback" not in said, said


@pytest.mark.slow
def test_the_viewer_listens_on_this_machine_only_and_has_no_analytics(logs: Path, tmp_path: Path) -> None:
    write_log_recording(tmp_path / "log.rrd", read_scenario(logs / "a.mcap"))
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    environment = {**os.environ, "HOME": str(tmp_path), "BROWSER": "true", "PYTHONPATH": os.pathsep.join(sys.path)}
    for name in ("XDG_CONFIG_HOME", "DISPLAY", "WAYLAND_DISPLAY"):
        environment.pop(name, None)
    words = ["view", str(tmp_path / "log.rrd"), "--web", "--port", str(port)]
    process = subprocess.Popen(
        [*REPLAN, *words], env=environment, cwd=tmp_path, start_new_session=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        seen, end = set[tuple[str, str, str]](), time.monotonic() + 60.0
        while not any(one[0].endswith(f":{port:04X}") for one in seen) and time.monotonic() < end:
            assert process.poll() is None
            seen |= sockets(process.pid)
            time.sleep(0.05)
        until = time.monotonic() + 2.0
        while time.monotonic() < until:
            seen |= sockets(process.pid)
            time.sleep(0.05)
        assert {one[0] for one in seen if one[2] == "0A"} and not abroad(seen), seen
        again = CliRunner().invoke(app, words)
        assert again.exit_code == 2 and f"port {port} is in use" in again.stderr
    finally:
        os.killpg(process.pid, signal.SIGTERM)
        process.wait(30.0)
    assert not list(tmp_path.rglob("analytics.json"))


def test_no_display_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    (tmp_path / "log.rrd").touch()
    done = CliRunner().invoke(app, ["view", str(tmp_path / "log.rrd")])
    assert done.exit_code == 3 and "there is no display here" in done.stderr and "--web" in done.stderr
