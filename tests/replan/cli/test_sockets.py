"""Nothing leaves this machine, and nothing of it can be reached from elsewhere: sockets are
watched.
"""

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest
from command_line import replan
from process_tree import descendants

from replan.draw.recording import write_log_recording
from replan.draw.recording.pictures import environment
from replan.logs.mcap import read_scenario

pytestmark = pytest.mark.skipif(
    not Path("/proc/net/tcp").exists(), reason="sockets are read from /proc"
)
REPLAN = [sys.executable, "-c", "from replan.cli import main; main()"]
LOOPBACK = ("0100007F", "00000000000000000000000001000000", "0000000000000000FFFF00000100007F")
AUDIT = """
import sys
def watch(event, args):
    if event in ("socket.connect", "socket.getaddrinfo", "socket.bind", "socket.sendto"):
        sys.stderr.write(f"SOCKET {event} {args}\\n")
sys.addaudithook(watch)
from replan.cli import main
main()
"""


def sockets(pid: int) -> set[tuple[str, str, str]]:
    """Local and remote address and state of all of a tree's internet sockets, as /proc has them."""
    inodes = set()
    for one in {pid, *descendants(pid)}:
        for file in Path(f"/proc/{one}/fd").glob("*"):
            try:
                inodes.add(str(file.readlink()).removeprefix("socket:[").removesuffix("]"))
            except OSError:
                continue
    rows = []
    for kind in ("tcp", "tcp6", "udp", "udp6"):
        table = Path(f"/proc/net/{kind}")
        rows += (
            [line.split() for line in table.read_text().splitlines()[1:]] if table.exists() else []
        )
    return {(row[1], row[2], row[3]) for row in rows if row[9] in inodes}


def abroad(found: set[tuple[str, str, str]]) -> set[tuple[str, str, str]]:
    """Those that are bound or connected to something else than this machine.

    All zeros is no address yet.
    """
    return {
        one
        for one in found
        if any(end.strip("0") != ":" and not end.startswith(LOOPBACK) for end in one[:2])
    }


def watched(words: list[str], folder: Path) -> tuple[set[tuple[str, str, str]], str]:
    """Sockets of a command over its life, and what it said."""
    environment = {**os.environ, "HOME": str(folder), "PYTHONPATH": os.pathsep.join(sys.path)}
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
@pytest.mark.nightly
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


VISITOR = """
import sys, tempfile, urllib.request
sys.addaudithook(lambda event, args: print(args[0]) if event == "socket.getaddrinfo" else None)
tempfile.mkdtemp()
try:
    urllib.request.urlopen("https://example.org", timeout=5)
except OSError:
    pass
"""


def test_a_program_in_the_viewers_environment_reaches_no_other_machine_and_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("TMPDIR", "TEMP", "TMP"):
        monkeypatch.setenv(name, str(tmp_path))
    monkeypatch.setenv("no_proxy", "*")  # of the user: it would let all through
    monkeypatch.setattr(tempfile, "tempdir", None)
    with environment() as variables:
        done = subprocess.run(
            [sys.executable, "-c", VISITOR], env=variables, capture_output=True, text=True
        )
    assert set(done.stdout.split()) == {"127.0.0.1"}, done
    assert not list(tmp_path.iterdir())


def called(trace: str) -> set[str]:
    """Addresses of internet protocols in the calls that `strace` has recorded."""
    return set(re.findall(r'inet_addr\("([^"]+)"\)', trace)) | set(
        re.findall(r'inet_pton\(AF_INET6, "([^"]+)"', trace)
    )


def test_the_trace_of_calls_shows_a_connection(tmp_path: Path) -> None:
    assert called(
        'connect(3, {sa_family=AF_INET, sin_port=htons(53), sin_addr=inet_addr("10.0.0.1")}, 16)'
    )
    ipv6 = (
        'connect(3, {sa_family=AF_INET6, sin6_port=htons(1), inet_pton(AF_INET6, "2001:db8::1", '
        "&sin6_addr)}, 28)"
    )
    assert called(ipv6) == {"2001:db8::1"}


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ["view", "LOG", "--screenshot", "a.png", "--theme", "light"],
        [
            "evaluate",
            "LOG",
            "-p",
            "replan.planners.idm:Idm",
            "--mode",
            "open",
            "--workers",
            "1",
            "-o",
            "out",
        ],
    ],
    ids=" ".join,
)
def test_system_calls_of_a_command_name_no_other_machine(
    logs: Path, tmp_path: Path, words: list[str]
) -> None:
    """Run in a network namespace without a route, where the user may make one: there the command
    must work, too.
    """
    if shutil.which("strace") is None:
        pytest.skip("strace is not installed (Debian: strace): connections cannot be watched")
    if "view" in words:
        needs_a_driver()
    apart = ["unshare", "--map-root-user", "--net"]
    if (
        shutil.which("unshare") is None
        or subprocess.run([*apart, "true"], capture_output=True, check=False).returncode
    ):
        apart = []
    scratch, home = tmp_path / "scratch", tmp_path / "home"
    scratch.mkdir()
    home.mkdir()
    calls, which = tmp_path / "calls", "trace=connect,sendto,sendmsg,sendmmsg"
    watch = ["strace", "-f", "-qq", "--seccomp-bpf", "-e", which, "-o", str(calls)]
    inside = [sys.executable, "-c", LOOPBACK_UP + "from replan.cli import main; main()"]
    environment = {
        **os.environ,
        "TMPDIR": str(scratch),
        "HOME": str(home),
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    command = [
        *apart,
        *watch,
        *inside,
        *(str(logs / "a.mcap") if word == "LOG" else word for word in words),
    ]
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode in (0, 1, 4) and "Traceback" not in done.stderr, done
    assert called(calls.read_text()) <= {"127.0.0.1", "::1"}
    assert not list(scratch.iterdir())


LOOPBACK_UP = """
import fcntl, socket, struct
from contextlib import suppress
with socket.socket() as link, suppress(PermissionError):  # in a namespace of its own the loopback device is down
    fcntl.ioctl(link, 0x8914, struct.pack("16sh14x", b"lo", 0x1 | 0x40))  # SIOCSIFFLAGS: up, running
"""  # noqa: E501


def needs_a_driver() -> None:
    if not any(
        list(Path(place).glob("*.json"))
        for place in ("/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d")
    ):
        pytest.skip("no Vulkan driver: the viewer cannot draw (Debian: mesa-vulkan-drivers)")


@pytest.mark.slow
def test_the_viewer_listens_on_this_machine_only_and_has_no_analytics(
    logs: Path, tmp_path: Path
) -> None:
    write_log_recording(tmp_path / "log.rrd", read_scenario(logs / "a.mcap"))
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    environment = {
        **os.environ,
        "HOME": str(tmp_path),
        "BROWSER": "true",
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    for name in ("XDG_CONFIG_HOME", "DISPLAY", "WAYLAND_DISPLAY"):
        environment.pop(name, None)
    words = ["view", str(tmp_path / "log.rrd"), "--web", "--port", str(port)]
    process = subprocess.Popen(
        [*REPLAN, *words],
        env=environment,
        cwd=tmp_path,
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
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
        again = replan(*words)
        assert again.exit_code == 2 and f"port {port} is in use" in again.stderr
    finally:
        os.killpg(process.pid, signal.SIGTERM)
        process.wait(30.0)
    assert not list(tmp_path.rglob("analytics.json"))


def test_no_display_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    (tmp_path / "log.rrd").touch()
    done = replan("view", tmp_path / "log.rrd")
    assert (
        done.exit_code == 3 and "there is no display here" in done.stderr and "--web" in done.stderr
    )
