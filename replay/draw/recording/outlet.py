"""Where the viewer's library writes a recording: through a pipe, so that we write the file.

By itself the library raises nothing where a disk is full: it leaves a file that is cut, or waits for ever. The pipe is
always read, so that it ends; what the system says of the file is raised. Without pipes in the file system (Windows) the
library writes the file.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread

CHUNK_BYTES = 1 << 20


@contextmanager
def outlet(file: Path) -> Iterator[Path]:
    """The path for the library, whose stream must be disconnected inside; then all is in `file`, else OSError."""
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
    """All that comes out of the pipe goes into the file; after an error, nowhere."""
    with open(reader, "rb", buffering=0) as source:
        try:
            with file.open("wb") as target:
                shutil.copyfileobj(source, target, CHUNK_BYTES)
        except OSError as error:
            errors.append(error)
            while source.read(CHUNK_BYTES):
                pass
