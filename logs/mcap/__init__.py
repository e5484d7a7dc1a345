"""The only package that reads and writes MCAP: logs in, logs and traces out.

Modules:
    native.py      the messages of the native log: one definition gives schema, names with units, validation, and a page
    container.py   an MCAP file as topics of messages, or one sentence that states what is wrong with it
    reader.py      native messages -> Scenario          osi.py      ASAM OSI ground truth -> Scenario
    complete.py    fills in what a log leaves out
    writer.py      Scenario -> native log               trace_file.py  Trace -> native log and back
    records.py     salvage of damaged files, parts of remote ones
"""

from logs.mcap.reader import read_scenario
from logs.mcap.trace_file import read_moment, read_trace, write_trace
from logs.mcap.writer import is_written_here, write_scenario

__all__ = ["is_written_here", "read_moment", "read_scenario", "read_trace", "write_scenario", "write_trace"]
