"""The public names of replan in one place: `import replan`.

scenario = replan.from_frames(ego, agents)      a team's own log from pandas tables, in ten lines
scenario = replan.read_log("drive.mcap")        a log of any format (`replan convert --formats`)
replan.write_log("drive.mcap", scenario)        as native MCAP, for `replan evaluate`
result = replan.load("results/run-001")         the tables and drives of a run (`replay.results`)
"""

from __future__ import annotations

from logs.mcap.writer import write_scenario as write_log
from logs.readers import LogSettings, Reader, read_log
from logs.readers.table import from_frames
from replay.results import DriveResult, Results, load

__all__ = ["DriveResult", "LogSettings", "Reader", "Results", "from_frames", "load", "read_log", "write_log"]
