"""replan's messages (docs/bring_planner.md, "Messages, version 1") on two descriptors.

A message is 4 bytes, the length of the rest, and a MessagePack map. A column is a binary of
little-endian float64, points are x, y after one another.
"""

from __future__ import annotations

import os
import struct
from typing import Any

import msgpack
import numpy as np
from numpy.typing import NDArray

Message = dict[str, Any]


PIECE_BYTES = 1_048_576
"""Bytes that are read at once."""


class MessageChannel:
    """Receives and sends messages."""

    def __init__(self, source: int, target: int) -> None:
        self._source, self._target = source, target

    @classmethod
    def of_process(cls) -> MessageChannel:
        """The channel on stdin and stdout; what is printed from now on goes to stderr."""
        channel = cls(os.dup(0), os.dup(1))
        nothing = os.open(os.devnull, os.O_RDONLY)
        os.dup2(nothing, 0)
        os.dup2(2, 1)
        return channel

    def receive(self) -> Message | None:
        """The next message; None if replan has closed the channel."""
        head = self._read(4)
        body = self._read(struct.unpack("<I", head)[0]) if head else b""
        return msgpack.unpackb(body, strict_map_key=False) if body else None

    def send(self, message: Message) -> None:
        """Send a message."""
        body = msgpack.packb(message)
        left = memoryview(struct.pack("<I", len(body)) + body)
        while left:
            left = left[os.write(self._target, left) :]

    def _read(self, size: int) -> bytes:
        parts = []
        while size > 0:
            part = os.read(self._source, min(size, PIECE_BYTES))
            if not part:
                return b""
            parts.append(part)
            size -= len(part)
        return b"".join(parts)


def column(data: Any) -> NDArray[np.float64]:
    """A column `(n,)`."""
    return np.frombuffer(data, "<f8") if isinstance(data, bytes) else np.array(data, np.float64)


def points(data: Any) -> NDArray[np.float64]:
    """Points `(n, 2)`."""
    return column(data).reshape(-1, 2)
