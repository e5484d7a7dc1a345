"""A recording as a file, written in columns: rows of instances at instants, each on both timelines.

A row may hold any number of instances, 0 included (then the entity is empty at that instant). The counts of the rows
must add up to the number of instances: a wrong sum would lose rows silently, so it is an error here.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Thread

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb

from logs.errors import writing
from logs.kernel import FloatArray, IntArray
from logs.short_names import ShortNames
from replay.draw.recording.text import application_name, plain

SIM_TIME = "sim_time"
FRAME = "frame"
ROOM = "room"
"""Entity of a page without words."""
REMOVED = "world/removed"
"""Entity of the tracks that a repair of the log removed."""
NO_NAMES = ShortNames(())
CHUNK_BYTES = 1 << 20


@dataclass(frozen=True, eq=False)
class Instants:
    """When rows hold: `t` `(n,)` s since the scenario's start, and the index `(n,)` of the frame then in force."""

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
        mine = (self.frame >= frames.start) & (self.frame < frames.stop)
        return Instants(self.t[mine], self.frame[mine])

    def columns(self) -> list[rr.TimeColumn]:
        """Both timelines; times are rounded to the nanosecond (the viewer's own conversion truncates)."""
        nanoseconds = np.round(self.t * 1e9).astype("timedelta64[ns]")
        return [rr.TimeColumn(SIM_TIME, duration=nanoseconds), rr.TimeColumn(FRAME, sequence=self.frame)]


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
        """One row per instant; `counts` `(n,)` instances each, None for one each.

        Raises:
            ValueError: The counts do not add up to the instances of a column.
        """
        kept = list(columns)
        if counts is not None:
            for column in kept:
                present = len(column.component_batch.as_arrow_array())
                if present != int(np.sum(counts)):
                    raise ValueError(f"{entity}: {present} instances for rows of {int(np.sum(counts))}")
            kept = [column.partition(counts) for column in kept]
        if len(instants):
            self.stream.send_columns(entity, instants.columns(), kept)


def strips(points: FloatArray, lengths: Sequence[int] | IntArray) -> pa.Array:
    """Line strips for the viewer: consecutive runs of `lengths` points out of `(m, 2)` or `(m, 3)`."""
    dimension = points.shape[1]
    flat = pa.array(np.ascontiguousarray(points, dtype=np.float32).reshape(-1))
    offsets = pa.array(np.r_[0, np.cumsum(lengths)].astype(np.int32))
    field = pa.field("item", pa.float32(), nullable=False)
    inner = pa.FixedSizeListArray.from_arrays(flat, type=pa.list_(field, dimension))
    return pa.ListArray.from_arrays(offsets, inner, type=pa.list_(pa.field("item", inner.type, nullable=False)))


def pixels(radius: float) -> float:
    """A radius that does not zoom: the viewer takes negative ones as pixels."""
    return -radius


def joined(rows: Sequence[FloatArray], dimension: int) -> tuple[FloatArray, list[int]]:
    """The rows `(k_i, dimension)` one after the other, and their lengths."""
    return np.concatenate([np.empty((0, dimension)), *rows]), [len(row) for row in rows]


@contextmanager
def recording_file(
    path: Path, application: str, name: str, digest: str, layout: rrb.Blueprint, short: ShortNames = NO_NAMES
) -> Iterator[Tape]:
    """An open recording under a temporary name, renamed when it is complete; errors of the library are raised.

    Its texts use the names `short`.

    Raises:
        OutputError: The file cannot be written.
    """
    unfinished = path.with_name(f"{path.name}.part")
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    strict = rr.strict_mode()
    rr.set_strict_mode(True)
    stream = rr.RecordingStream(application_name(application), recording_id=digest, send_properties=False)
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
    """The path to which the library writes, whose stream must be disconnected inside; then all is in `file`.

    The library itself raises nothing if a disk is full: it leaves a truncated file, or waits forever. Here it writes to
    a pipe, which is always read to its end, and an OSError from writing the file is raised. Without pipes in the file
    system (Windows) the library writes the file.
    """
    if not hasattr(os, "mkfifo"):
        yield file
        return
    with tempfile.TemporaryDirectory() as folder:
        pipe = Path(folder) / file.name
        os.mkfifo(pipe)
        reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
        writer = os.open(pipe, os.O_WRONLY)  # ours: the pipe ends when the library and we have closed it
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
