"""Recordings read back."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow as pa
from rerun.chunk import RrdReader

from replan.core.arrays import FloatArray


class Recording:
    """A recording read back: columns by entity."""

    def __init__(self, path: Path) -> None:
        self.chunks = list(RrdReader(str(path)).stream().to_chunks())
        self.moving = {c.entity_path: c.to_record_batch() for c in self.chunks if not c.is_static}
        self.still: dict[str, list[pa.RecordBatch]] = {}
        for chunk in self.chunks:
            if chunk.is_static:
                self.still.setdefault(chunk.entity_path, []).append(chunk.to_record_batch())

    def times(self, entity: str) -> FloatArray:
        return np.asarray(self.moving[entity].column("sim_time").cast(pa.int64())) / 1e9

    def column(self, entity: str, name: str) -> pa.Array:
        return self.moving[entity].column(name)

    def counts(self, entity: str, name: str) -> FloatArray:
        return np.diff(np.asarray(self.column(entity, name).offsets))

    def scalars(self, entity: str) -> FloatArray:
        return np.asarray(self.column(entity, "Scalars:scalars").flatten())

    def points(self, entity: str, name: str) -> FloatArray:
        flat = self.column(entity, name)
        while pa.types.is_list(flat.type) or pa.types.is_fixed_size_list(flat.type):
            width = flat.type.list_size if pa.types.is_fixed_size_list(flat.type) else None
            flat = flat.flatten()
        return np.asarray(flat).reshape(-1, width)

    def static(self, entity: str, name: str) -> pa.Array:
        return next(
            batch.column(name) for batch in self.still[entity] if name in batch.schema.names
        )[0].values

    def texts(self) -> Iterator[str]:
        for chunk in self.chunks:
            for column in chunk.to_record_batch().columns:
                if pa.types.is_list(column.type) and pa.types.is_string(column.type.value_type):
                    yield from column.flatten().to_pylist()
