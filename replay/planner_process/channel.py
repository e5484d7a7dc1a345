"""Messages over a pair of file descriptors, with deadlines: 4 bytes of length (little-endian), then
MessagePack.
"""

from __future__ import annotations

import os
import select
import struct
import time
from contextlib import suppress
from typing import Any, Generic, Literal, TypeVar

import msgspec

from replan.logs.codec import array_as_bytes, array_of, scalar_as_number
from replan.replay.planner_process.messages import LARGEST_BYTES

T = TypeVar("T")

HEADER = struct.Struct("<I")
PIPE_BYTES = 1_048_576
"""Size of a pipe, which holds a whole frame (the default is 64 KiB; Linux allows 1 MiB without
privileges).
"""
PRINTED_BYTES = 4096  # Number of last bytes of the planner's output that are kept


class LateError(Exception):
    """The deadline has passed."""


class GoneError(Exception):
    """The other side has closed the channel."""


class GarbageError(Exception):
    """The other side sent an invalid message."""


class Channel(Generic[T]):
    """Sends any message, and receives messages of one type.

    Args:
        into: The descriptor from which the other side reads.
        out: The descriptor to which the other side writes.
        kind: The type of the messages that come.
        stderr: The descriptor to which the other side prints, read meanwhile so that it never
            blocks; -1: none.
        side: This side. "replan" has descriptors that do not block, keeps deadlines, sends arrays
            as bytes, and refuses messages above `LARGEST_BYTES`; "planner" has descriptors that
            block, waits for ever, sends numbers of NumPy as numbers, and takes messages of any
            size.
    """

    def __init__(
        self,
        into: int,
        out: int,
        kind: Any,
        stderr: int = -1,
        *,
        side: Literal["replan", "planner"] = "replan",
    ) -> None:
        self._into, self._out, self._stderr = into, out, stderr
        self._encoder = msgspec.msgpack.Encoder(
            enc_hook=scalar_as_number if side == "planner" else array_as_bytes
        )
        self._decoder = msgspec.msgpack.Decoder(kind, dec_hook=array_of)
        self._buffer, self._filled, self.printed = bytearray(PIPE_BYTES), 0, b""
        self._side = side
        for fd in {into, out, stderr} - {-1}:
            os.set_blocking(fd, side == "planner")
            widen(fd)

    def send(self, message: msgspec.Struct, deadline: float = float("inf")) -> None:
        """Send a message before the deadline (of `time.monotonic`).

        LateError if the other side did not take it in time; GoneError if it has closed the channel;
        TypeError if a value cannot be sent.
        """
        payload = self._encoder.encode(message)
        unsent = [memoryview(HEADER.pack(len(payload))), memoryview(payload)]
        while unsent:
            try:
                sent = os.writev(self._into, unsent)
            except BlockingIOError:
                self._wait(self._into, select.POLLOUT, deadline)
                continue
            except OSError:
                raise GoneError from None
            while unsent and sent >= len(unsent[0]):
                sent -= len(unsent.pop(0))
            if unsent:
                unsent[0] = unsent[0][sent:]

    def receive(self, deadline: float = float("inf")) -> T:
        """The next message before the deadline.

        LateError if it did not come in time, or was not decoded by then; GoneError if the channel
        was closed; GarbageError if it is not a message of the type.
        """
        self._read(HEADER.size, deadline)
        (size,) = HEADER.unpack_from(self._buffer)
        if size > LARGEST_BYTES and self._side == "replan":
            problem = f"a message of {size} bytes, more than {LARGEST_BYTES}"
            raise GarbageError(
                f"{problem} (keep less inside of plans, or give a smaller loop.apart.batch)"
            )
        end = HEADER.size + size
        self._read(end, deadline)
        try:
            message: T = self._decoder.decode(memoryview(self._buffer)[HEADER.size : end])
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise GarbageError(" ".join(str(error).split())) from None
        if time.monotonic() > deadline:
            raise LateError
        rest = self._buffer[end : self._filled]
        self._buffer[: len(rest)] = rest
        self._filled = len(rest)
        return message

    def _read(self, size: int, deadline: float) -> None:
        """Read until `size` bytes are in the buffer.

        Further bytes are kept for the next message.
        """
        if size > len(self._buffer):
            self._buffer = self._buffer.ljust(size, b"\0")
        while self._filled < size:
            if self._side == "replan":
                self._wait(self._out, select.POLLIN, deadline)
            try:
                came = os.readv(self._out, [memoryview(self._buffer)[self._filled :]])
            except OSError:
                raise GoneError from None
            if not came:
                raise GoneError
            self._filled += came

    def _wait(self, fd: int, event: int, deadline: float) -> None:
        """Wait until `fd` is ready; the end of output that is printed meanwhile is kept."""
        while True:
            poll = select.poll()
            poll.register(fd, event)
            if self._stderr >= 0:
                poll.register(self._stderr, select.POLLIN)
            left_s = deadline - time.monotonic()
            if left_s <= 0.0:
                raise LateError
            ready = dict(poll.poll(None if left_s == float("inf") else 1e3 * left_s))
            if self._stderr in ready:
                self.read_printed()
            if fd in ready:
                return

    def read_printed(self) -> None:
        """Read the output that the planner printed so far."""
        while self._stderr >= 0:
            try:
                part = os.read(self._stderr, PIPE_BYTES)
            except OSError:  # nothing more now
                return
            if not part:
                os.close(self._stderr)
                self._stderr = -1
                return
            self.printed = (self.printed + part)[-PRINTED_BYTES:]
            if len(part) < PIPE_BYTES:
                return

    def close(self) -> None:
        """Close all descriptors."""
        for fd in {self._into, self._out, self._stderr} - {-1}:
            with suppress(OSError):
                os.close(fd)
        self._into = self._out = self._stderr = -1


def widen(fd: int) -> None:
    """Enlarge a pipe so that it holds a whole frame, if the system can."""
    with suppress(OSError, ImportError, AttributeError):
        import fcntl

        fcntl.fcntl(fd, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
