"""Errors are one line of bounded length, and the limits of the process are no bug of replan."""

import errno
import os
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from replan.core.errors import (
    LONGEST_ERROR,
    ConfigError,
    LimitError,
    LogError,
    OutputError,
    described,
    encodable,
    limit_error,
    writing,
)


@given(
    what=st.text(st.characters(), max_size=9).map(lambda text: text * 1000),
    end=st.sampled_from(["", "rename it"]),
)
def test_errors_are_bounded_and_can_be_written(what: str, end: str) -> None:
    for error in (ConfigError(f"{what}; {end}"), LogError(what, file="a.csv", remedy=end)):
        text = str(error)
        assert len(text) <= LONGEST_ERROR
        assert text.encode("utf-8")
        assert text.endswith(end)


@given(text=st.text())
def test_text_that_utf8_can_encode_stays(text: str) -> None:
    assert encodable(text) == text


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        OSError(errno.ENOMEM, os.strerror(errno.ENOMEM)),
        ImportError("libscipy_openblas.so: failed to map segment from shared object"),
        RuntimeError("can't start new thread"),
    ],
)
def test_no_memory_is_no_bug(error: Exception) -> None:
    assert isinstance(limit_error(error), LimitError)
    assert described(error).startswith("the memory is used up; ")


def test_too_many_open_files_name_the_file_and_the_remedy() -> None:
    error = OSError(errno.EMFILE, os.strerror(errno.EMFILE), "drive.mcap")
    assert str(limit_error(error)).startswith("drive.mcap: cannot be opened: too many open files;")
    with pytest.raises(LimitError, match="ulimit -n"), writing(Path("out.csv")):
        raise error


def test_other_errors_are_not_of_the_limits() -> None:
    assert limit_error(ValueError("cannot allocate memory")) is None
    assert limit_error(OSError(errno.ENOENT, "no such file", "memory.csv")) is None
    with pytest.raises(OutputError), writing(Path("out.csv")):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
