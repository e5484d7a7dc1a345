"""The only package that reads and writes MCAP: logs in, logs and traces out."""

from replan.logs.mcap.reader import read_scenario
from replan.logs.mcap.trace_file import read_moment, read_trace, write_trace
from replan.logs.mcap.writer import is_written_here, write_scenario

__all__ = [
    "is_written_here",
    "read_moment",
    "read_scenario",
    "read_trace",
    "write_scenario",
    "write_trace",
]
