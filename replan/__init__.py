"""The public names of replan in one place: `import replan`. Each is imported when it is first asked for.

scenario = replan.from_frames(ego, agents)      a team's own log from pandas tables, in ten lines
scenario = replan.read_log("drive.mcap")        a log of any format (`replan convert --formats`)
replan.write_log("drive.mcap", scenario)        as native MCAP, for `replan evaluate`
result = replan.load("results/run-001")         the tables and drives of a run (`replay.results`, docs/results.md)

`python -m replan` is the command line.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from logs.mcap.writer import write_scenario as write_log
    from logs.readers import LogSettings, Reader, read_log
    from logs.readers.table import from_frames
    from replay.results import DriveResult, Results, load

__all__ = ["DriveResult", "LogSettings", "Reader", "Results", "from_frames", "load", "read_log", "write_log"]

_FROM = {
    "DriveResult": "replay.results",
    "LogSettings": "logs.readers",
    "Reader": "logs.readers",
    "Results": "replay.results",
    "from_frames": "logs.readers.table",
    "load": "replay.results",
    "read_log": "logs.readers",
    "write_log": "logs.mcap.writer:write_scenario",
}


def __getattr__(name: str) -> Any:
    """A public name, from where it stands."""
    if name not in _FROM:
        raise AttributeError(f"module 'replan' has no attribute {name!r}")
    module, _, own = _FROM[name].partition(":")
    globals()[name] = value = getattr(import_module(module), own or name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


if __name__ == "__main__":
    from replay.cli import main

    main()
