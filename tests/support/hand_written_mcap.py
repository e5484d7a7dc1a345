"""Logs in MCAP as others than this project would write them: message by message."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType, Writer

RECORD = {"replan.scenario": {"format_version": "1", "name": "by hand"}}
STATE = {"x_m": 1.0, "y_m": 2.0, "yaw_rad": 0.1, "v_mps": 3.0, "a_mps2": 0.0, "kappa_per_m": 0.0}
TABLE = {"id": ["a"], "kind": ["car"], "length_m": [4.0], "width_m": [2.0], "static": [False]}


def write_by_hand(
    path: Path,
    messages: Iterable[tuple[str, int, Any]],
    records: Mapping[str, Mapping[str, str]] = RECORD,
    compression: CompressionType = CompressionType.ZSTD,
) -> Path:
    """A log as other tools write it: (topic, log time, JSON value or raw bytes)."""
    with path.open("wb") as file:
        writer: Any = Writer(file, compression=compression)
        writer.start()
        for name, record in records.items():
            writer.add_metadata(name, dict(record))
        channels: dict[str, int] = {}
        for topic, time, value in messages:
            if topic not in channels:
                schema = writer.register_schema(
                    f"by.hand{topic}", "jsonschema", b'{"type":"object"}'
                )
                channels[topic] = writer.register_channel(topic, "json", schema)
            payload = value if isinstance(value, bytes) else json.dumps(value).encode()
            writer.add_message(channels[topic], time, payload, time)
        writer.finish()
    return path


def ego_states(n: int = 5, **changes: Any) -> list[tuple[str, int, Any]]:
    return [("/ego", 100_000_000 * k, {**STATE, "x_m": 3.0 * k, **changes}) for k in range(n)]
