"""The index of a result folder: its drives, worst first, each a link that opens its recording.

Order: by what the gates say (fail, inconclusive, pass, not judged), then by how many numbers are out of bounds, as in
the reports.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from logs.names import counted
from replay.draw.recording.file import recording_file
from replay.draw.recording.text import MARKDOWN, Marked, cell, document, link, table
from replay.draw.report.model import DriveRow
from replay.draw.report.overview import ORDER, overview
from replay.results.load import load


def write_index(path: Path, folder: Path, most: int) -> tuple[Path, list[Path]]:
    """Write the index of a folder; its file, and the recordings of the worst drives, at most `most`, the worst last.

    The viewer shows what was opened last, and lists recordings by name.

    Raises:
        ConfigError: It is no folder of results.
        OutputError: The file cannot be written.
    """
    over = overview(load(folder))
    rows = sorted(over.drives, key=lambda row: (_weight(row), -row.trouble, row.log))
    opened = [row for row in rows if row.recording][:most]
    lines = [f"# {cell(over.outcome)}: {counted(len(rows), 'drive')}, worst first", "", *_said(rows, opened, folder)]
    names = [column.title.replace("\n", " ") for column in over.columns]
    body = [
        (_link(row, folder), row.shown, row.verdict or "not judged", row.end.text, *(c.text for c in row.cells))
        for row in rows
    ]
    lines += table(("log", "planner", "gates", "end", *names), body)
    digest = sha256("".join(lines).encode()).hexdigest()[:32]
    view = rrb.TextDocumentView(origin="/index", name="Index")
    layout = rrb.Blueprint(
        view, rrb.BlueprintPanel(state="expanded"), rrb.SelectionPanel(state="hidden"), rrb.TimePanel(state="hidden")
    )
    with recording_file(path, "replan index", "index", digest, layout) as tape:
        tape.static("index", rr.TextDocument(document(lines), media_type=MARKDOWN))
    return path, [folder / row.recording for row in opened[::-1]]


def _link(row: DriveRow, folder: Path) -> Marked | str:
    """The log's name, which opens the recording of its closed loop, else of its open one."""
    return link(row.log, (folder / row.recording).resolve()) if row.recording else row.log


def _weight(row: DriveRow) -> int:
    return ORDER.index(row.verdict) if row.verdict in ORDER else len(ORDER)


def _said(rows: Sequence[DriveRow], opened: Sequence[DriveRow], folder: Path) -> list[str]:
    """What is open, and how the others are opened: by a click, or by a command."""
    there = [row for row in rows if row.recording]
    lines = [f"Open beside this page: {len(opened)} of {counted(len(there), 'recording')}, those of the worst drives."]
    if there:
        lines[0] += " A click on the name of a log opens its recording."
    if len(there) > len(opened):
        lines += ["", f"Both loops of one: `replan view {document([shlex.quote(str(folder))])} --log LOG`."]
    without = len(rows) - len(there)
    return [*lines, *(["", f"Without recording: {counted(without, 'drive')}."] if without else [])]
