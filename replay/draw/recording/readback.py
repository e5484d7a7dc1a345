"""What a recording says of itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
from rerun.chunk import RrdReader

from logs.errors import ConfigError
from replay.draw.recording.columns import SIM_TIME


def span(recording: Path) -> tuple[float, float]:
    """When a recording begins and ends, s; ConfigError where nothing in it has a time."""
    times = [
        np.asarray(chunk.to_record_batch().column(SIM_TIME).cast(pa.int64())) / 1e9
        for chunk in RrdReader(str(recording)).stream().to_chunks()
        if not chunk.is_static and SIM_TIME in chunk.to_record_batch().schema.names
    ]
    times = [some for some in times if len(some)]
    if not times:
        raise ConfigError(f"{recording}: nothing in it has a time")
    return float(min(some.min() for some in times)), float(max(some.max() for some in times))
