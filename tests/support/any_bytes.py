"""What holds for every reader: any bytes are a scenario or a LogError, and a scenario survives
native MCAP.
"""

from dataclasses import replace
from pathlib import Path
from time import process_time

import numpy as np
from differences import differences
from hypothesis import strategies as st

from replan.core.errors import LogError
from replan.logs.mcap import read_scenario, write_scenario
from replan.logs.readers import read_log
from replan.logs.scenario import Scenario

CHANGES = st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), max_size=8)
"""Places and the bytes that are written there."""


def changed(raw: bytes, changes: list[tuple[int, int]]) -> bytes:
    out = bytearray(raw)
    for place, value in changes:
        out[place % len(out)] = value
    return bytes(out)


def spoiled(content: bytes, data: st.DataObject) -> bytes:
    """The content with one bit flipped, cut off, or with eight bytes replaced."""
    how = data.draw(st.sampled_from(["flip", "cut", "fill"]))
    at = data.draw(st.integers(0, len(content) - 1))
    if how == "cut":
        return content[:at]
    if how == "fill":
        return content[:at] + data.draw(st.binary(min_size=8, max_size=8)) + content[at + 8 :]
    return (
        content[:at] + bytes([content[at] ^ 1 << data.draw(st.integers(0, 7))]) + content[at + 1 :]
    )


def read_or_refused(log: Path, seconds: float = np.inf) -> None:
    """A scenario, or one line that names the log; within so much time."""
    begin = process_time()
    try:
        scenario = read_log(log)
        assert len(scenario.ego) and np.isfinite(scenario.ego.x).all()
    except LogError as error:
        assert str(log) in str(error) and "\n" not in str(error)
    assert process_time() - begin < seconds


def goes_round(scenario: Scenario, folder: Path) -> None:
    """Written as native MCAP and read again it is the same; metadata have no order."""
    write_scenario(folder / "native.mcap", scenario)
    both = (scenario, read_scenario(folder / "native.mcap"))
    one, other = (replace(each, metadata=dict(sorted(each.metadata.items()))) for each in both)
    assert differences(other, one) == []
