"""Writing in columns: rows of instances at instants, each on both timelines of a recording.

A row may hold any number of instances, 0 included (then the entity is empty at that instant). The counts of the rows
must add up to the number of instances: a wrong sum would lose rows silently, so it is an error here.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import rerun as rr

from logs.kernel import FloatArray, IntArray
from logs.names import ShortNames

SIM_TIME = "sim_time"
FRAME = "frame"
ROOM = "room"
"""A page without words."""
REMOVED = "world/removed"
"""Entity of what a repair of the log took away."""
NO_NAMES = ShortNames(())


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
        """Those in which some frames are in force."""
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
        """What holds at all times."""
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
