"""Messages over a pair of file descriptors, with deadlines: 4 bytes of length (little-endian), then
MessagePack.
"""

from __future__ import annotations

import os
import select
import struct
import time
from contextlib import suppress
from typing import Any, Generic, TypeVar

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

    `into`: descriptor from which the other side reads. `stderr`: descriptor to which it prints,
    read meanwhile so that it never blocks; -1: none. `patient`: whether this side waits without
    deadlines, as a planner does.
    """

    def __init__(
        self, into: int, out: int, kind: Any, stderr: int = -1, *, patient: bool = False
    ) -> None:
        self._into, self._out, self._stderr = into, out, stderr
        self._encoder = msgspec.msgpack.Encoder(
            enc_hook=scalar_as_number if patient else array_as_bytes
        )
        self._decoder = msgspec.msgpack.Decoder(kind, dec_hook=array_of)
        self._buffer, self._filled, self.printed = bytearray(PIPE_BYTES), 0, b""
        self._patient = patient
        for fd in {into, out, stderr} - {-1}:
            os.set_blocking(fd, patient)
            widen(fd)

    def send(self, message: msgspec.Struct, deadline: float = float("inf")) -> None:
        """Send a message before the deadline (of `time.monotonic`).

        LateError if the other side did not take it in time; GoneError if it has closed the channel;
        TypeError if a value cannot be sent.
        """
        payload = self._encoder.encode(message)
        left = [memoryview(HEADER.pack(len(payload))), memoryview(payload)]
        while left:
            try:
                sent = os.writev(self._into, left)
            except BlockingIOError:
                self._wait(self._into, select.POLLOUT, deadline)
                continue
            except OSError:
                raise GoneError from None
            while left and sent >= len(left[0]):
                sent -= len(left.pop(0))
            if left:
                left[0] = left[0][sent:]

    def receive(self, deadline: float = float("inf")) -> T:
        """The next message before the deadline.

        LateError if it did not come in time, or was not decoded by then; GoneError if the channel
        was closed; GarbageError if it is not a message of the type.
        """
        self._read(HEADER.size, deadline)
        (size,) = HEADER.unpack_from(self._buffer)
        if size > LARGEST_BYTES and not self._patient:
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
            if not self._patient:
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
            left = deadline - time.monotonic()
            if left <= 0.0:
                raise LateError
            ready = dict(poll.poll(None if left == float("inf") else 1e3 * left))
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
