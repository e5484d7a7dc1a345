"""The Rerun viewer: how it is started, and pictures and videos of a recording without a display.

The viewer listens on this machine only, and sends nothing to another. Version 0.41 asks two servers
for newer versions, and no setting prevents it. Its HTTP client obeys the usual proxy variables, so
they name a proxy that refuses every connection: the viewer does not even look up the servers'
names.

Pictures are screenshots of the real viewer, which runs headless on a local port. It draws
asynchronously: a picture is complete when two screenshots in a row are equal. It needs a Vulkan
driver; a software one is enough (Mesa's lavapipe).

A picture has no header (menu, warnings about the driver) and no time panel; the tabs that hold its
contents are open. A headless viewer reads no theme from its settings, and its client cannot set
one: the viewer's own server for agents (MCP: one JSON message per line on stdin and stdout) clicks
on the theme in the settings. Videos are made of pictures, by Pillow (.gif, .png) or by ffmpeg if it
is installed.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
from PIL import Image
from rerun.chunk import RrdReader
from rerun.experimental import ViewerClient

from replan.core.errors import ConfigError, ReplanError
from replan.draw.recording.tape import SIM_TIME
from replan.results.tables import write_file, write_png

Theme = Literal["dark", "light"]
LAYOUTS = ("overview", "planner", "control")  # The tabs of a recording, each a whole window
LOOPBACK = "127.0.0.1"
CLOSED = f"http://{LOOPBACK}:9"
"""A proxy that does not exist: port 9 (discard, RFC 863) has no server on current systems."""
SETTINGS = {
    "analytics_enabled": False,
    "analytics_id": "",
    "metadata": {},
    "config_file_path": "",
    "data_dir_path": "",
}


@contextmanager
def environment(**more: str) -> Iterator[dict[str, str]]:
    """The environment of a viewer: no analytics, no network, temporary files in a folder that is
    removed at the end.

    The user's own settings of the viewer are not changed. On Windows the viewer reads them in any
    environment.
    """
    with tempfile.TemporaryDirectory(prefix="replan-viewer-") as folder:
        variable, subfolder = "XDG_CONFIG_HOME", ""
        if sys.platform == "darwin":
            variable, subfolder = "HOME", "Library/Application Support"
        file = Path(folder) / subfolder / "rerun" / "analytics.json"
        file.parent.mkdir(parents=True)
        file.write_text(json.dumps(SETTINGS), encoding="utf-8")
        ours = {
            key: value for key, value in os.environ.items() if not key.lower().endswith("_proxy")
        }
        ours |= dict.fromkeys(
            ("ALL_PROXY", "HTTP_PROXY", "HTTPS_PROXY", "http_proxy", "https_proxy"), CLOSED
        )
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
        # A port that has just been closed is free
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, port))
        except OSError:
            return True
    return False


TIMEOUT_S = 60.0  # Time limit for the start of the viewer, for loading, and for each picture
PAUSE_S = 0.3
HEADER_PX = 36  # Height of the viewer's header
AWAY = (1, 1)  # Final position of the pointer: in the header, which is cut off
FRAMES_PER_S = 10.0  # The usual planning rate
BY_PILLOW, BY_FFMPEG = (".gif",), (".mp4", ".mkv", ".mov", ".webm")
"""Suffixes of videos that Pillow writes, and those that need ffmpeg."""
EVEN = "pad=ceil(iw/2)*2:ceil(ih/2)*2"
"""Filter of ffmpeg for even width and height: most players need colours with half the
resolution.
"""

DRIVERS = (
    "/usr/share/vulkan/icd.d",
    "/usr/local/share/vulkan/icd.d",
    "/etc/vulkan/icd.d",
    "/run/opengl-driver/share/vulkan/icd.d",
)
"""Folders in which Vulkan's loader finds drivers on Linux; the last one is NixOS'."""

Blueprint = dict[str, dict[str, dict[str, Any]]]
"""A blueprint as the viewer reports it: values by entity, archetype and field."""


class ScreenshotError(ReplanError):
    """The viewer did not start, died, or never settled on a picture."""


@dataclass(frozen=True)
class Picture:
    """One picture to take."""

    out: Path
    t: float  # Time in the recording, s
    view: str | None = None  # Name of one view; None: the whole window
    layout: str = LAYOUTS[0]  # One of `LAYOUTS`; a view that it does not have is taken from another


def take_pictures(
    recording: Path, pictures: Sequence[Picture], *, size: str = "1920x1080", theme: Theme = "dark"
) -> list[str]:
    """Take pictures of a recording.

    ConfigError if there is no such layout or view, or the size is invalid; ScreenshotError if there
    is no graphics driver, the viewer died, or a picture never settled; OutputError if a picture
    cannot be written.

    `size`: size of a picture of the whole window, pixels: WIDTHxHEIGHT.

    Returns:
        The viewer's reports about its views after the last picture, one line each; empty for a
            healthy recording.
    """
    if re.fullmatch(r"[1-9]\d{2,3}x[1-9]\d{2,3}", size) is None:
        raise ConfigError(f"--size {size}: WIDTHxHEIGHT in pixels, for example 1920x1080")
    width, height = (int(part) for part in size.split("x"))
    with _viewer(f"{width}x{height + HEADER_PX}", theme) as (client, alive):
        client.open([str(recording.resolve())])
        _until(lambda: not client.get_state().loading, alive, "the recording does not load")
        recorded = client.get_blueprint("recording").blueprint
        shown = None
        for picture in pictures:
            if (picture.layout, picture.view) != shown:
                parts, view = arranged(recorded, picture.layout, picture.view)
                client.set_blueprint(parts, "recording")
                shown = picture.layout, picture.view
            if any(recording.timelines for recording in client.get_state().recordings):
                client.set_time(SIM_TIME, duration=picture.t, play_state="paused")
            _settle(client, picture, view, alive)
        return [
            f"{view.name}: {report.summary}"
            for view in client.get_state().views
            for report in view.reports
        ]


def arranged(recorded: Blueprint, layout: str, view: str | None) -> tuple[Blueprint, str | None]:
    """A blueprint without header and time panel, in which the tabs that hold a layout or a view of
    it are open.

    `recorded`: the blueprint as the viewer reports it: fields by entity and archetype. `layout`:
    one of `LAYOUTS`. `view`: name of a view; if several have it, the one in the layout, otherwise
    the first. ConfigError if there is no such layout or view.

    Returns:
        The blueprint, and the view's id.
    """
    parts = {
        name: {kind: dict(fields) for kind, fields in part.items()}
        for name, part in recorded.items()
    }
    parts["/top_panel"] = {"PanelBlueprint": {"state": "Hidden"}}
    parts.setdefault("/time_panel", {}).setdefault("TimePanelBlueprint", {})["state"] = "Hidden"
    parents = {}
    for name, part in parts.items():
        contents: str | list[str] = part.get("ContainerBlueprint", {}).get("contents", [])
        for child in [contents] if isinstance(contents, str) else contents:
            parents[child] = name.removeprefix("/")
    titles = dict[str, str]()
    for name, part in parts.items():
        for kind in part.keys() & {"ContainerBlueprint", "ViewBlueprint"}:
            titles[name.removeprefix("/")] = str(part[kind].get("display_name", ""))
    layouts = {title.lower(): name for name, title in titles.items() if title.lower() in LAYOUTS}
    if layout != LAYOUTS[0] and layout not in layouts:
        raise ConfigError(
            f"this recording has no layout {layout!r}; there are: "
            f"{', '.join(sorted(layouts)) or 'one'}"
        )
    target = layouts.get(layout)
    if view is not None:
        views = {name: title for name, title in titles.items() if name.startswith("view/")}
        matches = [name for name, title in views.items() if title == view]
        if not matches:
            known = sorted({title for title in views.values() if title.strip()})
            raise ConfigError(f"no view {view!r}; there are: {', '.join(known)}")
        in_layout = (name for name in matches if target in _above(name, parents))
        target = next(in_layout, matches[0])
    for child in _above(target, parents) if target else ():
        parent = parts.get(f"/{parents.get(child, '')}", {}).get("ContainerBlueprint", {})
        if parent.get("container_kind") == "Tabs":
            parent["active_tab"] = child
    return parts, target.removeprefix("view/") if view is not None and target else None


def _above(name: str, parents: Mapping[str, str]) -> list[str]:
    """A part and its containers, the innermost first."""
    parts = [name]
    while parts[-1] in parents:
        parts.append(parents[parts[-1]])
    return parts


def _settle(client: Any, picture: Picture, view: str | None, alive: Callable[[], None]) -> None:
    last = b""

    def settled() -> bool:
        nonlocal last
        time.sleep(PAUSE_S)
        before, last = last, client.take_screenshot(view_id=view)
        return before == last

    _until(settled, alive, f"the picture at {picture.t} s never settled")
    if view is None:  # the place of the hidden header is empty
        shot, cut = Image.open(BytesIO(last)), BytesIO()
        shot.crop((0, HEADER_PX, shot.width, shot.height)).save(cut, "PNG")
        last = cut.getvalue()
    write_png(picture.out, last)


def _until(done: Callable[[], bool], alive: Callable[[], None], complaint: str) -> None:
    end = time.monotonic() + TIMEOUT_S
    while not done():
        alive()
        if time.monotonic() > end:
            raise ScreenshotError(f"{complaint} within {TIMEOUT_S:g} s")
        time.sleep(0.02)


@contextmanager
def _viewer(size: str, theme: Theme) -> Iterator[tuple[Any, Callable[[], None]]]:
    """A headless viewer, its client, and a check that it is alive; it ends with the block."""
    binary = Path(str(files("rerun_cli").joinpath("rerun")))
    port = free_port()
    command = [
        str(binary),
        "--headless",
        "--port",
        str(port),
        "--bind",
        LOOPBACK,
        "--window-size",
        size,
    ]
    with tempfile.TemporaryFile("w+") as log, environment(RUST_LOG="error") as variables:
        process = subprocess.Popen(command, env=variables, stdout=log, stderr=subprocess.STDOUT)

        def alive() -> None:
            if process.poll() is not None:
                log.seek(0)
                raise ScreenshotError(
                    f"the viewer ended with code {process.returncode}: {_why_ended(log.read())}"
                )

        try:
            client = _connect(port, alive)
            if theme != "dark":  # the default
                client.set_location("about:settings")
                if error := click_theme(theme, binary, port, variables, TIMEOUT_S):
                    raise ScreenshotError(f"the viewer's theme cannot be set: {error}")
            yield client, alive
        except (OSError, RuntimeError) as error:  # the client lost the viewer
            with suppress(subprocess.TimeoutExpired):
                process.wait(PAUSE_S)
            alive()
            raise ScreenshotError(f"the viewer does not answer: {error}") from error
        finally:
            process.terminate()
            try:
                process.wait(5.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _why_ended(said: str) -> str:
    """Describe the end of the viewer: without a Vulkan driver it cannot draw, and its output does
    not say so.
    """
    folders = [Path(place) for place in DRIVERS]
    if sys.platform == "linux" and not any(next(folder.glob("*.json"), None) for folder in folders):
        return (
            "it cannot draw, as there is no Vulkan driver; install one (Debian, Ubuntu: "
            "mesa-vulkan-drivers)"
        )
    lines = said.splitlines()
    first = next((k for k, line in enumerate(lines) if "panicked" in line), max(len(lines) - 5, 0))
    return " ".join(" ".join(lines[first : first + 5]).split())[:400]


def _connect(port: int, alive: Callable[[], None]) -> Any:
    end = time.monotonic() + TIMEOUT_S
    while True:
        alive()
        try:
            client = ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy")
            client.get_state()
            return client
        except (ConnectionError, RuntimeError, OSError, ValueError) as error:
            if time.monotonic() > end:
                raise ScreenshotError(
                    f"the viewer did not answer within {TIMEOUT_S:g} s: {error}"
                ) from error
            time.sleep(0.05)


START, CLICKS = 1, 2  # Ids of messages


def click_theme(
    theme: Theme, binary: Path, port: int, variables: Mapping[str, str], timeout: float
) -> str:
    """Click a theme in the settings, which must be visible; returns the error, "" if there is none.

    `timeout`: time limit, s.
    """
    actions = [
        {"name": "wait_for", "args": {"label_contains": theme.title()}},
        {"name": "click", "args": {"label_contains": theme.title()}},
        {"name": "hover", "args": {"pos": AWAY}},
    ]
    start = {
        "protocolVersion": "2025-06-18",
        "capabilities": {},
        "clientInfo": {"name": "replan", "version": "1"},
    }
    messages: list[dict[str, Any]] = [
        {"id": START, "method": "initialize", "params": start},
        {"method": "notifications/initialized"},
        {
            "id": CLICKS,
            "method": "tools/call",
            "params": {"name": "batch", "arguments": {"actions": actions}},
        },
    ]
    sent = "".join(json.dumps({"jsonrpc": "2.0", **message}) + "\n" for message in messages)
    command = [str(binary), "viewer-mcp", "--endpoint", f"http://{LOOPBACK}:{port}"]
    try:
        server = subprocess.run(
            command,
            input=sent,
            env=dict(variables),
            capture_output=True,
            text=True,
            timeout=timeout,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"its server for agents did not answer within {timeout:g} s"
    answers = [json.loads(line) for line in server.stdout.splitlines() if line.startswith("{")]
    results = {answer.get("id"): answer.get("result", answer) for answer in answers}
    result = results.get(CLICKS, {"isError": True})
    return str(result.get("content", server.stderr)) if result.get("isError", True) else ""


# videos -------------------------------------------------------------------------------------------


def span(recording: Path) -> tuple[float, float]:
    """The first and the last time of a recording, s.

    Raises ConfigError if no data in it have a time.
    """
    batches = [
        chunk.to_record_batch()
        for chunk in RrdReader(str(recording)).stream().to_chunks()
        if not chunk.is_static
    ]
    times = [
        np.asarray(batch.column(SIM_TIME).cast(pa.int64())) / 1e9
        for batch in batches
        if SIM_TIME in batch.schema.names and len(batch)
    ]
    if not times:
        raise ConfigError(f"{recording}: nothing in it has a time")
    first, last = min(map(np.min, times)), max(map(np.max, times))
    return float(first), float(last)


def film(
    recording: Path,
    out: Path,
    begin: float | None,
    end: float | None,
    *,
    layout: str,
    size: str,
    theme: Theme,
) -> int:
    """Write the video of a recording; returns the number of its frames.

    `out`: the video file; its suffix gives the format. `begin`: start, s; None: that of the
    recording; `end` likewise. `layout`: one of `LAYOUTS`. `size`: pixels: WIDTHxHEIGHT. ConfigError
    if there is no such layout, no time in the span, or no ffmpeg for this ending; ReplanError if
    ffmpeg fails, or the viewer does; OutputError if the video cannot be written.
    """
    if out.suffix not in BY_PILLOW and shutil.which("ffmpeg") is None:
        raise ConfigError(
            f"{out}: ffmpeg is not installed here; it writes {out.suffix or 'videos'}, or name a "
            "FILE.gif"
        )
    first, last = span(recording)
    begin, end = first if begin is None else begin, last if end is None else end
    times = begin + np.arange(np.floor((end - begin) * FRAMES_PER_S + 1e-9) + 1) / FRAMES_PER_S
    if not len(times):
        raise ConfigError(f"--from {begin:g} --to {end:g}: no time between them")
    with tempfile.TemporaryDirectory() as folder:
        pictures = [
            Picture(Path(folder) / f"{i:05d}.png", float(t), layout=layout)
            for i, t in enumerate(times)
        ]
        take_pictures(recording, pictures, size=size, theme=theme)

        def write(partial: Path) -> None:
            if out.suffix in BY_PILLOW:
                frame, *others = [Image.open(picture.out).convert("RGB") for picture in pictures]
                frame.save(
                    partial,
                    save_all=True,
                    comment="replan",
                    append_images=others,
                    duration=round(1e3 / FRAMES_PER_S),
                    loop=0,
                )
                return
            command = ["ffmpeg", "-y", "-loglevel", "error", "-framerate", f"{FRAMES_PER_S:g}"]
            command += ["-i", str(Path(folder) / "%05d.png"), "-vf", EVEN, "-pix_fmt", "yuv420p"]
            command += ["-metadata", "comment=replan", str(partial)]
            ffmpeg = subprocess.run(command, capture_output=True, text=True, check=False)
            if ffmpeg.returncode:
                error = " ".join(ffmpeg.stderr[-400:].split())
                raise ReplanError(f"{out}: ffmpeg failed: {error}")

        write_file(out, write)
    return len(pictures)
