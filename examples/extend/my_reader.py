"""A reader of text files with `t x y yaw`, a line each."""

import pandas as pd

from replan import LogError, Reader, from_frames


def read(path, settings):
    """Read one log; raises LogError."""
    try:
        table = pd.read_csv(path, sep=" ", names=["t", "x", "y", "yaw"])
    except ValueError as error:
        raise LogError(str(error), file=path) from None
    return from_frames(table, name=path.stem)


READER = Reader(
    "txy", "t x y yaw, a line each", "*.txy", (".txy",), lambda path: path.suffix == ".txy", read
)
