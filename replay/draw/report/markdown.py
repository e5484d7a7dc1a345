"""The report of a run as Markdown (GitHub's): `report.md`, and the summary of a step in CI.

Names of logs, planners and road users may contain anything: `_text` escapes Markdown in them. Long parts are folded.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import isfinite
from pathlib import Path
from urllib.parse import quote

import pandas as pd

from logs.errors import writing
from logs.names import counted
from metrics.comparison import Comparison
from metrics.judge.gates import Outcome
from replay.draw.report.contents import BROKEN, NOTHING, Overview, PassShare, legend

STEP_SUMMARY = "GITHUB_STEP_SUMMARY"
"""The environment variable with the path of the file that CI shows as the summary of a step."""
STEP_BYTES = 1 << 20
"""GitHub's limit for a step summary; it shows nothing of a longer one."""
MAX_OPEN = 25
"""Longest list that is not folded."""
MAX_COMPARED = 50
"""Largest number of listed regressions or groups of a comparison."""


def markdown(over: Overview, *, links: Iterable[str] | None = ()) -> str:
    """The report.

    Args:
        over: The contents.
        links: Files beside the report to link to first ("report.html"), before those of the drives; None: no links at
            all, for a report by itself.
    """
    parts = [f"# replan: {over.outcome}"]
    rows = [(gate.outcome.upper(), gate.rule, gate.mode or NOTHING, gate.found) for gate in over.gates]
    bad, good = ([row for row in rows if (row[0] == "PASS") is passed] for passed in (False, True))
    if over.shard:
        parts.append(f"Shard {over.shard}, not judged: `replan merge` judges all shards together.")
    else:
        fail, unsure = (sum(gate.outcome == word for gate in over.gates) for word in ("fail", "inconclusive"))
        verdicts = f"{fail} of {len(rows)} verdicts of the gates fail, {unsure} are inconclusive"
        parts.append(f"**{over.outcome.upper()}** (exit code {over.exit_code}): {verdicts}.")
        parts.append("\n".join(f"- **{_text(each.planner)}**: {_text(each.text)}" for each in over.answers))
        look = [(row.log, row.shown, row.verdict.upper() or NOTHING, row.end.text) for row in over.first]
        parts.append(_table(("look first at", "planner", "verdict", "closed loop ended by"), look) if look else "")
        parts.append(f"replan {_text(over.replan)}, configuration {over.config}")
    parts.append(", ".join(f"[{_text(link)}]({quote(link)})" for link in links or ()))
    parts.append(_list(f"Could not be evaluated ({len(over.failures)})", over.failures))
    if not over.shard:  # the gates that do not pass, and folded those that do
        names = ("outcome", "rule", "loop", "what was found")
        parts += ["## Gates", _table(names, bad) if bad else ""]
        parts.append(_fold(f"{len(good)} verdicts pass", _table(names, good)) if good else "")
        unasked = f"{len(over.not_asked)} gates were not asked of some drives"
        parts.append(_fold(unasked, _list("", over.not_asked)) if over.not_asked else "")
    if over.diagnosis is not None:
        said = [line.strip() for line in over.diagnosis["said"]]
        parts.append(_list(f"Why {over.diagnosis['planner']} fails", said))
    if over.comparison is not None:
        parts += _comparison(over.comparison)
    parts += [*_shares(over), *_drives(over, linked=links is not None)]
    if len(over.planners) > 1:
        each = [(label, *texts) for label, texts in over.compared]
        parts.append(f"## Planners\n\n{_table(('over all logs', *over.planners), each)}")
    parts.append(_list("Driven", over.driven))
    parts.append(_list(f"Ensemble: {len(over.fragile)} of {over.ensembles} verdicts are fragile", over.fragile))
    parts += [_list(BROKEN, over.broken), _list("Notes", over.notes)]
    times = [
        (row.planner, row.stage, *(f"{ms:.2f}" for ms in (row.p50_ms, row.p95_ms, row.p99_ms)),
         f"{100.0 * row.share:.0f}%" if isfinite(row.share) else NOTHING)
        for row in over.latency
    ]  # fmt: skip
    if times:
        head = ("planner", "stage", "p50 [ms]", "p95 [ms]", "p99 [ms]", "share")
        title = f"Planning time (wall clock, {counted(over.frames, 'plan')})"
        parts.append(_fold(title, _table(head, times, right=range(2, 6))))
    return "\n\n".join(part for part in parts if part) + "\n"


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


def _shares(over: Overview) -> Iterator[str]:
    if not over.whole:
        return
    head = ("logs", "planner", "loop", "pass", "share", "95 % interval", "fail", "inconclusive", "not evaluated")

    def table(shares: Iterable[PassShare]) -> str:
        rows = [
            (share.name, share.planner, share.mode, f"{share.passed} of {share.logs}", f"{100.0 * share.share:.0f}%",
             f"{100.0 * share.low:.0f} to {100.0 * share.high:.0f}%",
             *map(str, (share.failed, share.inconclusive, share.missing)))
            for share in shares
        ]  # fmt: skip
        return _table(head, rows, right=range(3, 9))

    yield "## Logs that pass"
    yield table(over.whole)
    yield "Shares of all logs: a log that is inconclusive or could not be evaluated does not pass."
    if over.grouped:
        yield _fold("By family, tag and dataset", table(over.grouped))


def _drives(over: Overview, *, linked: bool) -> Iterator[str]:
    """A row per log and planner, the worst first."""
    if not over.drives:
        return
    first = over.first_closed
    names = [column.words for column in over.columns]
    ended = ["closed loop ended by"] if first < len(names) else []
    head = ("log", "planner", "verdict", *names[:first], *ended, *names[first:], *(["files"] if linked else []))
    rows = []
    for row in over.ranked:
        cells = [*row.cells[:first], *([row.end] if ended else []), *row.cells[first:]]
        texts = [f"**{_text(cell.text)}**" if cell.bad else _text(cell.text) for cell in cells]
        files = [" ".join(f"[{_text(Path(file).name)}]({quote(file)})" for file in row.files)] if linked else []
        word = row.verdict.upper() if row.verdict == Outcome.FAIL.value else row.verdict or NOTHING
        rows.append([_text(row.log), _text(row.shown), word, *texts, *files])
    names, right = [_text(name) for name in head], [i for i in range(3, len(head)) if i != 3 + first]
    yield "## Drives"
    yield _raw_table(names, rows[:MAX_OPEN], right)
    if len(rows) > MAX_OPEN:
        more = f"{counted(len(rows) - MAX_OPEN, 'drive')} more, none of them worse"
        yield _fold(more, _raw_table(names, rows[MAX_OPEN:], right))
    yield "\n".join(f"- {_text(line)}" for line in legend(over.columns))


# with a baseline --------------------------------------------------------------------------------------------------


def _comparison(found: Comparison) -> Iterator[str]:
    yield f"## Compared: {_text(found.baseline)} -> {_text(found.candidate)}"
    rules = [(verdict.outcome.value.upper(), verdict.rule, verdict.reason) for verdict in found.verdicts]
    if rules:
        yield _table(("outcome", "rule", "what was found"), rules)
    yield _list("Inputs that differ", found.differences, level=3)
    yield _list("Only in the baseline", found.only_in_baseline, level=3)
    yield _list("Only in the candidate", found.only_in_candidate, level=3)
    yield _frame("Flips", found.flips, ("log", "planner", "mode", "gate", "before", "after", "time_s", "reason"))
    names = ("log", "planner", "mode", "metric", "unit", "baseline", "candidate", "worse", "time_s", "reason")
    yield " ".join(found.by_loop)
    yield _frame("Worst regressions", found.regressions(MAX_COMPARED), names)
    yield _frame("Greatest improvements", found.improvements(MAX_COMPARED), names)
    sure = found.groups[found.groups["significant"].astype(bool)] if len(found.groups) else found.groups
    moved = ("kind", "group", "planner", "mode", "metric", "logs", "baseline", "candidate", "delta", "low", "high")
    yield _frame("Means that changed beyond chance (95 %)", sure.head(MAX_COMPARED), moved)
    yield _frame("First differences of drives", found.partings, ("log", "planner", "mode", "t_s", "stage", "what"))


def _frame(title: str, rows: pd.DataFrame, names: Sequence[str]) -> str:
    """Columns of a frame as a table; "" if it has no row."""
    if not len(rows):
        return ""

    def value(cell: object) -> str:
        return str(cell) if not isinstance(cell, float) else f"{cell:.4g}" if isfinite(cell) else NOTHING

    table = _table(names, (map(value, row) for row in rows[list(names)].itertuples(index=False)))
    return f"### {title}\n\n{table if len(rows) <= MAX_OPEN else _fold(f'{len(rows)} rows', table)}"


# Markdown ---------------------------------------------------------------------------------------------------------


def _text(words: str) -> str:
    """Any text on one line, escaped so that Markdown shows it unchanged."""
    shown = "".join(c if c.isprintable() or c.isspace() else "\N{REPLACEMENT CHARACTER}" for c in words)
    line = re.sub(r"\s+", " ", shown)
    return _SPECIAL.sub(lambda found: f"&amp;{found[0][1:]}" if found[0][0] == "&" else f"\\{found[0]}", line)


_SPECIAL = re.compile(
    r"[\\`*|~$]"  # anywhere
    r"|(?<![^\W_])_|_(?![^\W_])"  # an underscore that is not within a word
    r"|<(?=[A-Za-z/!?])|](?=[(\[:])|&(?=#?\w+;)"  # tags, links, entities
    r"|^[-+=#>\[]|(?<=^\d)[.)](?=\s)|(?<=^\d\d)[.)](?=\s)"  # marks that begin a block
)


def _table(head: Iterable[str], rows: Iterable[Iterable[str]], right: Iterable[int] = ()) -> str:
    return _raw_table([_text(word) for word in head], [[_text(word) for word in row] for row in rows], right)


def _raw_table(head: Sequence[str], rows: Iterable[Sequence[str]], right: Iterable[int] = ()) -> str:
    """A table of cells that are Markdown already; `right` are the columns of numbers."""
    numbers = set(right)
    rule = ["---:" if i in numbers else "---" for i in range(len(head))]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (head, rule, *rows))


def _list(title: str, lines: Sequence[str], level: int = 2) -> str:
    """A heading and a list, folded if it is long; "" if it has no lines."""
    if not lines:
        return ""
    text = "\n".join(f"- {_text(line)}" for line in lines)
    text = text if len(lines) <= MAX_OPEN else _fold(f"{len(lines)} lines", text)
    return f"{'#' * level} {_text(title)}\n\n{text}"


def _fold(title: str, text: str) -> str:
    return f"<details>\n<summary>{title}</summary>\n\n{text}\n\n</details>"
