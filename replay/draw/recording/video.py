"""A drive as a video: frames by the viewer, put together by Pillow (.gif, .png) or by ffmpeg where it is installed."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from logs.errors import ConfigError, ReplanError, writing
from replay.draw.recording.screenshot import Picture, take_pictures
from replay.draw.viewer import Theme

FRAMES_PER_S = 10.0
"""As often as planners plan."""
BY_PILLOW = (".gif", ".png")
"""Animated; anything else needs ffmpeg."""
EVEN = "pad=ceil(iw/2)*2:ceil(ih/2)*2"
"""Width and height are even where colours have half the resolution, as most players want it."""


def can_write(out: Path) -> None:
    """ConfigError where a video of this ending cannot be made here: known before the frames are taken."""
    if out.suffix not in BY_PILLOW and shutil.which("ffmpeg") is None:
        raise ConfigError(
            f"{out}: ffmpeg is not installed here; it writes {out.suffix or 'videos'}, or name a FILE.gif"
        )


def film(
    recording: Path, out: Path, begin: float, end: float, folder: Path, *, layout: str, size: str, theme: Theme
) -> int:
    """Write the video of a recording from `begin` to `end`, s; the frames go to `folder`; how many there are.

    Raises:
        ConfigError: There is no such layout, no time in the span, or no ffmpeg for this ending.
        ReplanError: ffmpeg fails, or the viewer does.
    """
    can_write(out)
    times = begin + np.arange(np.floor((end - begin) * FRAMES_PER_S + 1e-9) + 1) / FRAMES_PER_S
    if not len(times):
        raise ConfigError(f"--from {begin:g} --to {end:g}: no time between them")
    pictures = [Picture(folder / f"{i:05d}.png", float(t), layout=layout) for i, t in enumerate(times)]
    take_pictures(recording, pictures, size=size, theme=theme)
    with writing(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        (_by_pillow if out.suffix in BY_PILLOW else _by_ffmpeg)([picture.out for picture in pictures], out)
    return len(pictures)


def _by_pillow(frames: Sequence[Path], out: Path) -> None:
    first, *others = [Image.open(frame).convert("RGB") for frame in frames]
    first.save(out, save_all=True, append_images=others, duration=round(1e3 / FRAMES_PER_S), loop=0)


def _by_ffmpeg(frames: Sequence[Path], out: Path) -> None:
    command = ["ffmpeg", "-y", "-loglevel", "error", "-framerate", f"{FRAMES_PER_S:g}"]
    command += ["-i", str(frames[0].parent / "%05d.png"), "-vf", EVEN, "-pix_fmt", "yuv420p", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ReplanError(f"{out}: ffmpeg failed: {' '.join(done.stderr[-400:].split())}")
