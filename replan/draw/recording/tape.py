"""A recording as a file, written in columns (rows of instances at instants, on both timelines); its
text and fills.

A row may hold any number of instances, 0 included (then the entity is empty at that instant). The
counts of the rows must add up to the number of instances: a wrong sum would lose rows silently, so
it is an error here.

A glyph that the viewer's font lacks terminates the headless viewer, so every text goes through
`plain` (one line), `cell` (one line inside Markdown) or `document` (Markdown that replan wrote).
Many names come from users.

The viewer's 2D views draw lines, not areas: an outline is filled with strokes. It is cut by
vertical lines of equal distance; between its first and second crossing, third and fourth, and so
on, the line is inside (even-odd rule).
"""

from __future__ import annotations

import os
import shutil
import tempfile
import unicodedata
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb

from replan.core.arrays import FloatArray, IntArray
from replan.core.errors import writing
from replan.core.names import ShortNames
from replan.draw.recording.colours import PackedArray

MARKDOWN = "text/markdown"
_ASCII = frozenset(chr(code) for code in range(0x20, 0x7F))
_LATIN = frozenset(chr(code) for code in range(0xA1, 0x100) if code != 0xAD)
_GREEK = frozenset("ΑΒΓΔΕΖΗΘΙΚΛΜΝΞΟΠΡΣΤΥΦΧΨΩαβγδεζηθικλμνξοπρςστυφχψω")
DRAWABLE = _ASCII | _LATIN | _GREEK | frozenset("≤≥√∑→←↑↓")
"""The characters that the viewer's font has (tried with the headless viewer)."""

_MARKDOWN = str.maketrans({mark: f"\\{mark}" for mark in "\\`*_[]<>|#~"})


def plain(text: object) -> str:
    """One line of drawable characters: white space becomes a space, any other character "?"."""
    composed = unicodedata.normalize("NFC", " ".join(str(text).split()))
    return _drawable(composed)


def cell(text: object) -> str:
    """One line inside Markdown: special characters of Markdown are escaped."""
    return plain(text).translate(_MARKDOWN)


def document(lines: Iterable[str]) -> str:
    """Markdown that replan wrote, made drawable.

    Names from users in it must have been escaped by `cell`.
    """
    return "\n".join(map(_drawable, lines))


def _drawable(text: str) -> str:
    return "".join(mark if mark in DRAWABLE else "?" for mark in text)


class Marked(str):
    """A cell of a table that is Markdown already, and is not escaped."""


def link(words: object, file: Path) -> Marked:
    """A link that opens a recording; the words alone if its path cannot be drawn."""
    path = file.as_posix()
    can = DRAWABLE.issuperset(path) and not set("<>|\\") & set(path)
    return Marked(f"[{cell(words)}](<{path}>)" if can else cell(words))


def table(header: Iterable[str], rows: Iterable[Iterable[object]]) -> list[str]:
    """The lines of a Markdown table, with an empty line before and after it."""
    names = list(header)
    body = [
        "| "
        + " | ".join(value if isinstance(value, Marked) else cell(value) for value in row)
        + " |"
        for row in rows
    ]
    return ["", "| " + " | ".join(names) + " |", "|" + " --- |" * len(names), *body, ""]


def path_parts(words: Iterable[str]) -> dict[str, str]:
    """An escaped part of an entity path for each distinct word; different words never share one."""
    parts: dict[str, str] = {}
    for word in words:
        if word not in parts:
            name, count = plain(word) or "?", 1
            while (part := rr.escape_entity_path_part(name)) in parts.values():
                count += 1
                name = f"{plain(word) or '?'} {count}"
            parts[word] = part
    return parts


def field_name(word: str) -> str:
    """A word as a name of a recording property: letters, digits and underscores."""
    return "".join(mark if mark.isascii() and mark.isalnum() else "_" for mark in word) or "_"


def application_name(words: str) -> str:
    """The name under which the viewer stores a layout: at most 100 characters of a small set."""
    return "".join(
        mark if mark.isascii() and (mark.isalnum() or mark in " _-") else "-" for mark in words
    )[:100]


SIM_TIME = "sim_time"
FRAME = "frame"
SPACER = "room"  # Entity of an empty text view that reserves layout space
REMOVED = "world/removed"  # Entity of the tracks that a repair of the log removed
NO_NAMES = ShortNames(())
CHUNK_BYTES = 1024 * 1024


@dataclass(frozen=True, eq=False)
class Instants:
    """Instants of rows: `t` `(n,)` s since the scenario's start, and the index `(n,)` of the frame
    then in force.
    """

    t: FloatArray
    frame: IntArray

    @classmethod
    def among(cls, t: FloatArray, frames: FloatArray) -> Instants:
        """The instants `t` among frames at the times `frames` (increasing, not empty)."""
        return cls(t, np.maximum(np.searchsorted(frames, t + 1e-9, side="right") - 1, 0))

    def __len__(self) -> int:
        return len(self.t)

    def within(self, frames: range) -> Instants:
        """The instants at which some frames are in force."""
        in_force = (self.frame >= frames.start) & (self.frame < frames.stop)
        return Instants(self.t[in_force], self.frame[in_force])

    def columns(self) -> list[rr.TimeColumn]:
        """Both timelines.

        Times are rounded to the nanosecond (the viewer's own conversion truncates).
        """
        nanoseconds = np.round(self.t * 1e9).astype("timedelta64[ns]")
        return [
            rr.TimeColumn(SIM_TIME, duration=nanoseconds),
            rr.TimeColumn(FRAME, sequence=self.frame),
        ]


@dataclass(frozen=True, eq=False)
class Tape:
    """The recording being written, and the short names of its road users."""

    stream: rr.RecordingStream
    short: ShortNames = NO_NAMES

    def static(self, entity: str, *archetypes: rr.AsComponents) -> None:
        """Data that hold at all times."""
        for archetype in archetypes:
            self.stream.log(entity, archetype, static=True)

    def rows(
        self,
        entity: str,
        instants: Instants,
        columns: Iterable[rr.ComponentColumn],
        counts: Sequence[int] | IntArray | None = None,
    ) -> None:
        """Write one row per instant, with `counts` `(n,)` instances (None: one instance per row).

        ValueError if the counts do not add up to the instances of a column.
        """
        filled = list(columns)
        if counts is not None:
            for column in filled:
                present = len(column.component_batch.as_arrow_array())
                if present != int(np.sum(counts)):
                    raise ValueError(
                        f"{entity}: {present} instances for rows of {int(np.sum(counts))}"
                    )
            filled = [column.partition(counts) for column in filled]
        if len(instants):
            self.stream.send_columns(entity, instants.columns(), filled)

    def lines(
        self,
        entity: str,
        instants: Instants,
        points: FloatArray,
        lengths: Sequence[int] | IntArray,
        counts: Sequence[int] | IntArray | None = None,
        shades: PackedArray | None = None,
        **style: Any,
    ) -> None:
        """Write rows of line strips: runs of `lengths` points `(m, 2)` or `(m, 3)`, with `shades`,
        all in `style`.
        """
        kind = rr.LineStrips2D if points.shape[1] == 2 else rr.LineStrips3D
        self.static(entity, kind.from_fields(**style))
        self.rows(
            entity, instants, kind.columns(strips=strips(points, lengths), colors=shades), counts
        )


def strips(points: FloatArray, lengths: Sequence[int] | IntArray) -> pa.Array:
    """Line strips for the viewer: consecutive runs of `lengths` points out of `(m, 2)` or
    `(m, 3)`.
    """
    dimension = points.shape[1]
    flat = pa.array(np.ascontiguousarray(points, dtype=np.float32).reshape(-1))
    offsets = pa.array(np.r_[0, np.cumsum(lengths)].astype(np.int32))
    field = pa.field("item", pa.float32(), nullable=False)
    inner = pa.FixedSizeListArray.from_arrays(flat, type=pa.list_(field, dimension))
    return pa.ListArray.from_arrays(
        offsets, inner, type=pa.list_(pa.field("item", inner.type, nullable=False))
    )


def pixels(radius: float) -> float:
    """A radius in pixels that does not zoom: the viewer takes negative radii as pixels."""
    return -radius


def joined(rows: Sequence[FloatArray], dimension: int) -> tuple[FloatArray, list[int]]:
    """The rows `(k_i, dimension)` one after the other, and their lengths."""
    return np.concatenate([np.empty((0, dimension)), *rows]), [len(row) for row in rows]


@contextmanager
def recording_file(
    path: Path,
    application: str,
    name: str,
    digest: str,
    layout: rrb.Blueprint,
    short: ShortNames = NO_NAMES,
) -> Iterator[Tape]:
    """An open recording under a temporary name, renamed when it is complete; errors of the library
    are raised.

    Its texts use the names `short`. OutputError if the file cannot be written.
    """
    unfinished = path.with_name(f".{path.name}.part")
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    strict = rr.strict_mode()
    rr.set_strict_mode(True)
    stream = rr.RecordingStream(
        application_name(application), recording_id=digest, send_properties=False
    )
    try:
        with writing(path):
            with _outlet(unfinished) as pipe:
                try:
                    stream.set_log_time_enabled(False)
                    stream.save(pipe, default_blueprint=layout)
                    stream.send_recording_name(plain(name))
                    yield Tape(stream, short)
                finally:
                    stream.disconnect()
            unfinished.replace(path)
    finally:
        rr.set_strict_mode(strict)
        unfinished.unlink(missing_ok=True)


@contextmanager
def _outlet(file: Path) -> Iterator[Path]:
    """The path to which the library writes; its stream must be disconnected inside, then `file`
    holds all data.

    The library itself raises nothing if a disk is full: it leaves a truncated file, or waits
    forever. Here it writes to a pipe, which is always read to its end, and an OSError from writing
    the file is raised. Without pipes in the file system (Windows) the library writes the file.
    """
    if not hasattr(os, "mkfifo"):
        yield file
        return
    with tempfile.TemporaryDirectory() as folder:
        pipe = Path(folder) / file.name
        os.mkfifo(pipe)
        reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
        # The pipe ends when both the library and this process have closed it
        writer = os.open(pipe, os.O_WRONLY)
        os.set_blocking(reader, True)
        errors: list[OSError] = []
        thread = Thread(target=_drain, args=(reader, file, errors))
        thread.start()
        try:
            yield pipe
        finally:
            os.close(writer)
            thread.join()
    if errors:
        raise errors[0]


def _drain(reader: int, file: Path, errors: list[OSError]) -> None:
    """Copy all data of the pipe into the file; after an error, discard them."""
    with open(reader, "rb", buffering=0) as source:
        try:
            with file.open("wb") as target:
                shutil.copyfileobj(source, target, CHUNK_BYTES)
        except OSError as error:
            errors.append(error)
            while source.read(CHUNK_BYTES):
                pass


@dataclass(frozen=True)
class PlaneWindow:
    """The visible part of a plane, in its own units."""

    x: tuple[float, float]
    y: tuple[float, float]


def _edges(points: FloatArray, lengths: IntArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Both ends `(m, 2)` of the edges of closed outlines, and the outline `(m,)` that each belongs
    to.
    """
    owner = np.repeat(np.arange(len(lengths)), lengths)
    last = np.cumsum(lengths) - 1
    after = np.arange(len(points)) + 1
    after[last] = last - lengths + 1
    return points, points[after], owner


def strokes(
    points: FloatArray, lengths: IntArray, window: PlaneWindow, spacing: float
) -> tuple[FloatArray, IntArray]:
    """The vertical strokes that fill closed outlines inside a window.

    `points`: `(m, 2)` corners, outline after outline. `lengths`: `(n,)` corners of each outline, at
    least 1. `window`: the visible part; strokes lie on its vertical lines and end at its borders.

    Returns:
        The strokes `(k, 2, 2)` from bottom to top, and the outline `(k,)` of each, sorted by
            outline, then x, then y.
    """
    start, end, owner = _edges(points, lengths)
    columns = max(1, round((window.x[1] - window.x[0]) / spacing))
    low, high = np.minimum(start[:, 0], end[:, 0]), np.maximum(start[:, 0], end[:, 0])
    first, stop = (
        np.clip(np.ceil((x - window.x[0]) / spacing - 0.5), 0, columns).astype(np.int64)
        for x in (low, high)
    )
    crossings = np.maximum(stop - first, 0)
    edge = np.repeat(np.arange(len(start)), crossings)
    column = (
        np.arange(len(edge)) - np.repeat(np.cumsum(crossings) - crossings, crossings) + first[edge]
    )
    x = window.x[0] + (column + 0.5) * spacing
    u = (x - start[edge, 0]) / (end[edge, 0] - start[edge, 0])
    y = start[edge, 1] + u * (end[edge, 1] - start[edge, 1])
    order = np.lexsort((y, column, owner[edge]))
    x, y, owner = x[order], np.clip(y[order], *window.y), owner[edge][order]
    pairs = np.stack(
        [np.column_stack([x[0::2], y[0::2]]), np.column_stack([x[1::2], y[1::2]])], axis=1
    )
    inside = pairs[:, 1, 1] > pairs[:, 0, 1]
    return pairs[inside], owner[0::2][inside]


def outline_segments(
    points: FloatArray, lengths: IntArray, window: PlaneWindow
) -> tuple[FloatArray, IntArray]:
    """The edges of closed outlines cut to a window (Liang and Barsky, 1984): `(k, 2, 2)`, and the
    outline of each.
    """
    start, end, owner = _edges(points, lengths)
    delta = end - start
    enter, leave = np.zeros(len(start)), np.ones(len(start))
    outside = np.zeros(len(start), dtype=bool)
    for axis, (low, high) in ((0, window.x), (1, window.y)):
        moving = np.abs(delta[:, axis]) > 1e-9  # a step too small to divide by is taken as zero
        outside |= ~moving & ((start[:, axis] < low) | (start[:, axis] > high))
        step = np.where(moving, delta[:, axis], 1.0)
        crossings = np.sort(
            np.stack([(low - start[:, axis]) / step, (high - start[:, axis]) / step]), axis=0
        )
        enter = np.where(moving, np.maximum(enter, crossings[0]), enter)
        leave = np.where(moving, np.minimum(leave, crossings[1]), leave)
    is_inside = ~outside & (enter < leave)
    cut = [start[is_inside] + u[is_inside, None] * delta[is_inside] for u in (enter, leave)]
    return np.stack(cut, axis=1), owner[is_inside]
