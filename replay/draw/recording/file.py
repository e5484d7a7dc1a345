"""A recording as a file: it appears only when it is whole."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from logs.errors import writing
from logs.names import ShortNames
from replay.draw.recording.columns import NO_NAMES, Tape
from replay.draw.recording.outlet import outlet
from replay.draw.recording.text import application_name, plain


@contextmanager
def recording_file(
    path: Path, application: str, name: str, digest: str, layout: rrb.Blueprint, short: ShortNames = NO_NAMES
) -> Iterator[Tape]:
    """The open recording under a temporary name, renamed when all is written; errors of the library are raised.

    What it shows has the names `short`.
    """
    unfinished = path.with_name(f"{path.name}.part")
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    strict = rr.strict_mode()
    rr.set_strict_mode(True)
    stream = rr.RecordingStream(application_name(application), recording_id=digest, send_properties=False)
    try:
        with writing(path):
            with outlet(unfinished) as pipe:
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
