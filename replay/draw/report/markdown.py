"""The report of a run as Markdown (GitHub's): `report.md`, and the summary of a step in CI.

The sections are those of `replay.draw.report.sections`. Names of logs, planners and road users may contain anything:
`_text` escapes Markdown in them. Long parts are folded.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypeVar
from urllib.parse import quote

from logs.errors import writing
from metrics.judge.gates import Outcome
from replay.draw.report.contents import Cell, Overview
from replay.draw.report.sections import ReportSection, comparison_sections, run_sections

T = TypeVar("T")

STEP_SUMMARY = "GITHUB_STEP_SUMMARY"
"""The environment variable with the path of the file that CI shows as the summary of a step."""
STEP_BYTES = 1 << 20  # GitHub's limit for a step summary; it shows nothing of a longer one
MAX_OPEN = 25  # Longest table or list that is not folded


def markdown(over: Overview, *, links: Iterable[str] | None = ()) -> str:
    """The report.

    Args:
        over: The contents.
        links: Files beside the report to link to first ("report.html"), before those of the drives; None: no links at
            all, for a report by itself.
    """
    parts = [f"# replan: {over.outcome}"]
    if not over.shard:
        fail, unsure = (sum(gate.outcome == word for gate in over.gates) for word in ("fail", "inconclusive"))
        verdicts = f"{fail} of {len(over.gates)} verdicts of the gates fail, {unsure} are inconclusive"
        parts.append(f"**{over.outcome.upper()}** (exit code {over.exit_code}): {verdicts}.")
        parts.append("\n".join(f"- **{_text(each.planner)}**: {_text(each.text)}" for each in over.answers))
    parts.append(f"replan {_text(over.replan)}, configuration {over.config}")
    parts.append(", ".join(f"[{_text(link)}]({quote(link)})" for link in links or ()))
    linked = links is not None
    look = [_link(f"{row.log}, {row.shown}", row.file if linked else "") for row in over.first]
    parts.append(f"Look first at {'; '.join(look)}." if look else "")
    parts += (section_text(section, linked=linked) for section in run_sections(over))
    if over.comparison is not None:
        parts.append(f"# Compared: {_text(over.comparison.baseline)} -> {_text(over.comparison.candidate)}")
        parts += (section_text(section, linked=linked) for section in comparison_sections(over.comparison))
    return "\n\n".join(part for part in parts if part) + "\n"


def section_text(section: ReportSection, *, linked: bool = False) -> str:
    """A section; behind its title if it is folded, and the part beyond `MAX_OPEN` rows or lines."""
    right = [i for i, column in enumerate(section.columns) if column.is_number]
    head = [_text(column.title) for column in section.columns]
    table = [[_cell(cell, linked=linked) for cell in row] for row in section.rows]
    body = _in_sight(table, "rows", lambda rows: _table(head, rows, right), section)
    listed = [f"- {_text(line)}" for line in section.lines]
    body += _in_sight(listed, "lines", "\n".join, section)
    body += [_text(line) for line in section.says]
    text = "\n\n".join(body)
    return _fold(_text(section.title), text) if section.folded else f"## {_text(section.title)}\n\n{text}"


def _in_sight(some: list[T], what: str, render: Callable[[list[T]], str], section: ReportSection) -> list[str]:
    """Rows or lines; those beyond `MAX_OPEN` are folded."""
    most = len(some) if section.folded else MAX_OPEN
    more = [_fold(f"{len(some) - most} more {what}", render(some[most:]))] if len(some) > most else []
    return [render(some[:most]), *more] if some else []


def _link(words: str, file: str) -> str:
    shown = _text(words)
    return f"[{_BRACKETS.sub(_ESCAPED, shown)}]({quote(file)})" if file else shown


def _cell(cell: Cell, *, linked: bool) -> str:
    if linked and cell.file:
        return _link(cell.text, cell.file)
    word = cell.text.replace("fail", "FAIL", 1) if cell.outcome == Outcome.FAIL.value else cell.text
    return f"**{_text(word)}**" if cell.bad else _text(word)


def append_step_summary(over: Overview, environment: Mapping[str, str] = os.environ) -> None:
    """Append the report to the summary of the CI step, if there is one; shortened to GitHub's limit."""
    name = environment.get(STEP_SUMMARY)
    if name:
        path = Path(name)
        left = STEP_BYTES - (path.stat().st_size if path.exists() else 0)
        with writing(path), path.open("a", encoding="utf-8", newline="\n") as file:
            file.write(shortened(markdown(over, links=None), left))


def shortened(text: str, most: int) -> str:
    """The text, if it has no more than `most` bytes; otherwise the lines that fit, and a sentence about the rest."""
    if len(text.encode()) <= most:
        return text
    end = "\n\nThis report is shortened: all of it is in report.md of the result folder.\n"
    room = most - len(end.encode()) - len("\n\n</details>")
    if room < 0:
        return ""
    head = text.encode()[:room].decode(errors="ignore").rpartition("\n")[0]
    folded = "\n\n</details>" if head.count("<details>") > head.count("</details>") else ""
    return head + folded + end


# Markdown ---------------------------------------------------------------------------------------------------------


def _text(words: str) -> str:
    """Any text on one line, escaped so that Markdown shows it unchanged."""
    shown = "".join(c if c.isprintable() or c.isspace() else "\N{REPLACEMENT CHARACTER}" for c in words)
    line = re.sub(r"\s+", " ", shown)
    return _SPECIAL.sub(lambda found: f"&amp;{found[0][1:]}" if found[0][0] == "&" else f"\\{found[0]}", line)


_BRACKETS, _ESCAPED = re.compile(r"(?<!\\)([\[\]])"), r"\\\1"
_SPECIAL = re.compile(
    r"[\\`*|~$]"  # anywhere
    r"|(?<![^\W_])_|_(?![^\W_])"  # an underscore that is not within a word
    r"|<(?=[A-Za-z/!?])|](?=[(\[:])|&(?=#?\w+;)"  # tags, links, entities
    r"|^[-+=#>\[]|(?<=^\d)[.)](?=\s)|(?<=^\d\d)[.)](?=\s)"  # marks that begin a block
)


def _table(head: Sequence[str], rows: Iterable[Sequence[str]], right: Iterable[int] = ()) -> str:
    """A table of cells that are Markdown already; `right` are the columns of numbers."""
    numbers = set(right)
    rule = ["---:" if i in numbers else "---" for i in range(len(head))]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (head, rule, *rows))


def _fold(title: str, text: str) -> str:
    return f"<details>\n<summary>{title}</summary>\n\n{text}\n\n</details>"
