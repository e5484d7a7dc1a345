"""Pictures of a recording without a display, for documents and tests.

The real viewer runs headless on a local port and is asked for pictures. It draws asynchronously: a picture counts when
two in a row are equal. Needs a Vulkan driver; a software one will do (Mesa's lavapipe).
"""

from __future__ import annotations

import subprocess
import sysconfig
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from rerun.experimental import ViewerClient

from logs.errors import ReplanError
from replay.recording.columns import SIM_TIME
from replay.viewer import LOOPBACK, environment, free_port

PAUSE_S = 0.3


class ScreenshotError(ReplanError):
    """The viewer did not start, died, or never settled on a picture."""


@dataclass(frozen=True)
class Picture:
    """One picture to take.

    Attributes:
        out: The PNG file.
        t: Time in the recording, s.
        view: Name of one view; None: the whole window.
    """

    out: Path
    t: float
    view: str | None = None


def take_pictures(
    recording: Path, pictures: Sequence[Picture], *, size: str = "1920x1080", timeout: float = 60.0
) -> list[str]:
    """Take pictures of a recording.

    Args:
        recording: The .rrd file.
        pictures: What to take, in this order.
        size: Of the window, pixels.
        timeout: For starting, loading and each picture, s.

    Returns:
        What the viewer reports about its views after the last picture, a line each; empty for a healthy recording.

    Raises:
        ScreenshotError: No graphics driver, the viewer died, or a picture never settled.
    """
    with _viewer(size, timeout) as (client, alive):
        client.open([str(recording.resolve())])
        _until(lambda: not client.get_state().loading, timeout, alive, "the recording does not load")
        for picture in pictures:
            client.set_time(SIM_TIME, duration=picture.t, play_state="paused")
            _settle(client, picture, timeout, alive)
        return [f"{view.name}: {report.summary}" for view in client.get_state().views for report in view.reports]


def _settle(client: Any, picture: Picture, timeout: float, alive: Callable[[], None]) -> None:
    views = {view.name: view.view_id for view in client.get_state().views}
    if picture.view is not None and picture.view not in views:
        raise ScreenshotError(f"no view {picture.view!r}; there are: {', '.join(sorted(views))}")
    last = b""

    def settled() -> bool:
        nonlocal last
        time.sleep(PAUSE_S)
        before, last = last, client.take_screenshot(view_id=views.get(picture.view) if picture.view else None)
        return before == last

    _until(settled, timeout, alive, f"the picture at {picture.t} s never settled")
    picture.out.write_bytes(last)


def _until(done: Callable[[], bool], timeout: float, alive: Callable[[], None], complaint: str) -> None:
    end = time.monotonic() + timeout
    while not done():
        alive()
        if time.monotonic() > end:
            raise ScreenshotError(f"{complaint} within {timeout:g} s")
        time.sleep(0.02)


@contextmanager
def _viewer(size: str, timeout: float) -> Iterator[tuple[Any, Callable[[], None]]]:
    """A headless viewer, its client, and a check that it is alive; it ends with the block."""
    binary = Path(sysconfig.get_paths()["platlib"]) / "rerun_cli" / "rerun"
    port = free_port()
    command = [str(binary), "--headless", "--port", str(port), "--bind", LOOPBACK, "--window-size", size]
    with tempfile.TemporaryFile("w+") as log, environment(RUST_LOG="error") as variables:
        process = subprocess.Popen(command, env=variables, stdout=log, stderr=subprocess.STDOUT)
        try:
            yield _connect(port, timeout, lambda: _check(process, log)), lambda: _check(process, log)
        finally:
            process.terminate()
            try:
                process.wait(5.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _check(process: subprocess.Popen[bytes], log: IO[str]) -> None:
    if process.poll() is not None:
        log.seek(0)
        words = " ".join(log.read()[-400:].split())
        raise ScreenshotError(f"the viewer ended with code {process.returncode}: {words}")


def _connect(port: int, timeout: float, alive: Callable[[], None]) -> Any:
    end = time.monotonic() + timeout
    while True:
        alive()
        try:
            client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            client.get_state()
            return client
        except (ConnectionError, RuntimeError, OSError, ValueError) as error:
            if time.monotonic() > end:
                raise ScreenshotError(f"the viewer did not answer within {timeout:g} s: {error}") from error
            time.sleep(0.05)
