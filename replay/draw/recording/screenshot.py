"""Pictures of a recording without a display, for documents and tests.

The real viewer runs headless on a local port and is asked for pictures. It draws asynchronously: a picture counts when
two in a row are equal. Needs a Vulkan driver; a software one will do (Mesa's lavapipe).

A picture has no header (menu, warnings about the driver) and no time panel; the tabs that hold what it shows are open.
"""

from __future__ import annotations

import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from typing import IO, Any

from PIL import Image
from rerun.experimental import ViewerClient

from logs.errors import ConfigError, ReplanError
from replay.draw.recording.columns import SIM_TIME
from replay.draw.recording.theme import SETTINGS, clicked
from replay.draw.viewer import LAYOUTS, LOOPBACK, Theme, environment, free_port
from replay.results.tables import write_file

PAUSE_S = 0.3
HEADER_PX = 36
"""Height of the viewer's header."""

Blueprint = dict[str, dict[str, dict[str, Any]]]
"""As the viewer tells it: entity, archetype, field."""


class ScreenshotError(ReplanError):
    """The viewer did not start, died, or never settled on a picture."""


@dataclass(frozen=True)
class Picture:
    """One picture to take.

    Attributes:
        out: The PNG file.
        t: Time in the recording, s.
        view: Name of one view; None: the whole window.
        layout: One of `LAYOUTS`; a view that it does not have is taken from another.
    """

    out: Path
    t: float
    view: str | None = None
    layout: str = LAYOUTS[0]


def take_pictures(
    recording: Path,
    pictures: Sequence[Picture],
    *,
    size: str = "1920x1080",
    theme: Theme = "dark",
    timeout: float = 60.0,
) -> list[str]:
    """Take pictures of a recording.

    Args:
        recording: The .rrd file.
        pictures: What to take, in this order.
        size: Of a picture of the whole window, pixels: WIDTHxHEIGHT.
        theme: Of the viewer.
        timeout: For starting, loading and each picture, s.

    Returns:
        What the viewer reports about its views after the last picture, a line each; empty for a healthy recording.

    Raises:
        ConfigError: There is no such layout or view.
        ScreenshotError: No graphics driver, the viewer died, or a picture never settled.
        OutputError: A picture cannot be written.
    """
    width, height = (int(part) for part in size.split("x"))
    with _viewer(f"{width}x{height + HEADER_PX}", theme, timeout) as (client, alive):
        client.open([str(recording.resolve())])
        _until(lambda: not client.get_state().loading, timeout, alive, "the recording does not load")
        kept = client.get_blueprint("recording").blueprint
        shown = None
        for picture in pictures:
            if (picture.layout, picture.view) != shown:
                view = _arrange(client, kept, picture)
                shown = picture.layout, picture.view
            if any(recording.timelines for recording in client.get_state().recordings):
                client.set_time(SIM_TIME, duration=picture.t, play_state="paused")
            _settle(client, picture, view, timeout, alive)
        return [f"{view.name}: {report.summary}" for view in client.get_state().views for report in view.reports]


def _arrange(client: Any, kept: Blueprint, picture: Picture) -> str | None:
    """Open the layout and the view of a picture, without header and time panel; the id of the view."""
    parts, view = arranged(kept, picture.layout, picture.view)
    client.set_blueprint(parts, "recording")
    return view


def arranged(kept: Blueprint, layout: str, view: str | None) -> tuple[Blueprint, str | None]:
    """A blueprint with the tabs open that hold a layout, or a view of it, without header and time panel.

    Args:
        kept: As the viewer tells it: fields by entity and archetype.
        layout: One of `LAYOUTS`.
        view: Name of a view; of several the one in the layout, else the first.

    Returns:
        The blueprint, and the view's id.

    Raises:
        ConfigError: There is no such layout or view.
    """
    parts = {name: {kind: dict(fields) for kind, fields in part.items()} for name, part in kept.items()}
    parts["/top_panel"] = {"PanelBlueprint": {"state": "Hidden"}}
    parts.setdefault("/time_panel", {}).setdefault("TimePanelBlueprint", {})["state"] = "Hidden"
    parents = {
        child: name.removeprefix("/")
        for name, part in parts.items()
        for child in _listed(part.get("ContainerBlueprint", {}).get("contents", []))
    }
    titles = {
        name.removeprefix("/"): str(fields.get("display_name", ""))
        for name, part in parts.items()
        for kind, fields in part.items()
        if kind in ("ContainerBlueprint", "ViewBlueprint")
    }
    layouts = {title.lower(): name for name, title in titles.items() if title.lower() in LAYOUTS}
    if layout != LAYOUTS[0] and layout not in layouts:
        raise ConfigError(f"this recording has no layout {layout!r}; there are: {', '.join(sorted(layouts)) or 'one'}")
    target = layouts.get(layout)
    if view is not None:
        found = [name for name, title in titles.items() if title == view and name.startswith("view/")]
        if not found:
            there = sorted({title for name, title in titles.items() if name.startswith("view/") and title.strip()})
            raise ConfigError(f"no view {view!r}; there are: {', '.join(there)}")
        found.sort(key=lambda name: target not in _above(name, parents))
        target = found[0]
    for child in _above(target, parents) if target else ():
        parent = parts.get(f"/{parents.get(child, '')}", {}).get("ContainerBlueprint", {})
        if parent.get("container_kind") == "Tabs":
            parent["active_tab"] = child
    return parts, target.removeprefix("view/") if view is not None and target else None


def _listed(contents: str | list[str]) -> list[str]:
    return [contents] if isinstance(contents, str) else contents


def _above(name: str, parents: Mapping[str, str]) -> list[str]:
    """A part and the containers that it is in, inside first."""
    out = [name]
    while out[-1] in parents:
        out.append(parents[out[-1]])
    return out


def _settle(client: Any, picture: Picture, view: str | None, timeout: float, alive: Callable[[], None]) -> None:
    last = b""

    def settled() -> bool:
        nonlocal last
        time.sleep(PAUSE_S)
        before, last = last, client.take_screenshot(view_id=view)
        return before == last

    _until(settled, timeout, alive, f"the picture at {picture.t} s never settled")
    if view is None:
        last = _without_header(last)
    write_file(picture.out, lambda partial: partial.write_bytes(last))


def _without_header(png: bytes) -> bytes:
    """A picture of the window without the place of the header, which stays empty where that is hidden."""
    shot = Image.open(BytesIO(png))
    cut = BytesIO()
    shot.crop((0, HEADER_PX, shot.width, shot.height)).save(cut, "PNG")
    return cut.getvalue()


def _until(done: Callable[[], bool], timeout: float, alive: Callable[[], None], complaint: str) -> None:
    end = time.monotonic() + timeout
    while not done():
        alive()
        if time.monotonic() > end:
            raise ScreenshotError(f"{complaint} within {timeout:g} s")
        time.sleep(0.02)


@contextmanager
def _viewer(size: str, theme: Theme, timeout: float) -> Iterator[tuple[Any, Callable[[], None]]]:
    """A headless viewer, its client, and a check that it is alive; it ends with the block."""
    binary = Path(str(files("rerun_cli").joinpath("rerun")))
    port = free_port()
    command = [str(binary), "--headless", "--port", str(port), "--bind", LOOPBACK, "--window-size", size]
    with tempfile.TemporaryFile("w+") as log, environment(RUST_LOG="error") as variables:
        process = subprocess.Popen(command, env=variables, stdout=log, stderr=subprocess.STDOUT)
        try:
            client = _connect(port, timeout, lambda: _check(process, log))
            if theme != "dark":  # which it is
                client.set_location(SETTINGS)
                wrong = clicked(theme, binary, port, variables, timeout)
                if wrong:
                    raise ScreenshotError(f"the viewer's theme cannot be set: {wrong}")
            yield client, lambda: _check(process, log)
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
