"""The index of a result folder: its drives, the worst first, each with a link that opens its recording.

They are ordered by verdict (fail, inconclusive, pass, not judged), then by the count of values out of bounds, as in the
reports.
"""

from __future__ import annotations

import shlex
from hashlib import sha256
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from logs.names import counted
from replay.draw.recording.tape import recording_file
from replay.draw.recording.text import MARKDOWN, cell, document, link, table
from replay.draw.report.overview import ORDER, overview
from replay.results.load import load


def write_index(path: Path, folder: Path, most: int) -> tuple[Path, list[Path]]:
    """Write the index of a folder; returns it, and the recordings of the worst drives, at most `most`, the worst last.

    The viewer shows what was opened last, and lists recordings by name.

    Raises:
        ConfigError: It is no folder of results.
        OutputError: The file cannot be written.
    """
    over = overview(load(folder))
    weight = {verdict: i for i, verdict in enumerate(ORDER)}
    rows = sorted(over.drives, key=lambda row: (weight.get(row.verdict, len(ORDER)), -row.trouble, row.log))
    opened = [row for row in rows if row.recording][:most]
    lines = [f"# {cell(over.outcome)}: {counted(len(rows), 'drive')}, worst first", ""]
    there = sum(bool(row.recording) for row in rows)
    click = " A click on the name of a log opens its recording." if there else ""
    beside = f"Open beside this page: {len(opened)} of {counted(there, 'recording')}, those of the worst drives."
    lines.append(beside + click)
    if there > len(opened):
        lines += ["", f"Both loops of one: `replan view {document([shlex.quote(str(folder))])} --log LOG`."]
    if there < len(rows):
        lines += ["", f"Without recording: {counted(len(rows) - there, 'drive')}."]
    names = [column.title.replace("\n", " ") for column in over.columns]
    body = []
    for row in rows:
        name = link(row.log, (folder / row.recording).resolve()) if row.recording else row.log
        body.append((name, row.shown, row.verdict or "not judged", row.end.text, *(c.text for c in row.cells)))
    lines += table(("log", "planner", "gates", "end", *names), body)
    digest = sha256("".join(lines).encode()).hexdigest()[:32]
    view = rrb.TextDocumentView(origin="/index", name="Index")
    layout = rrb.Blueprint(
        view, rrb.BlueprintPanel(state="expanded"), rrb.SelectionPanel(state="hidden"), rrb.TimePanel(state="hidden")
    )
    with recording_file(path, "replan index", "index", digest, layout) as tape:
        tape.static("index", rr.TextDocument(document(lines), media_type=MARKDOWN))
    return path, [folder / row.recording for row in opened[::-1]]
