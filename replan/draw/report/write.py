"""The reports of a result folder, as files: report.md, junit.xml, report.html, and the summary of a
step in CI.

They are made from the results on disk, so that they can be made for any folder, and contain no path
outside of the folder and no time of day: the same results give the same bytes, wherever the folder
is.

JUnit, which CI systems show: a test per log and gate, a suite per planner and loop. In it,
`classname` is PLANNER.LOOP.LOG and `name` the rule of the gate:

    failure     the log breaks the gate's bound
    skipped     it is inconclusive
    error       the log could not be driven to the end, or not at all: one test "evaluated" per log,
                whose time is the
                simulated time of the drive

A verdict on all logs together (a mean, a share of passes, too little evidence) is a test of the
class PLANNER.LOOP.all logs, or of its group; a single log does not fail such a gate. There is also
a suite "run" for failures and gates without a planner, and with a baseline a suite "compare" for
its rules. So a test fails if `replan` ends with 1, and has an error if it ends with 3. Ant's schema
requires a timestamp and a host, which are `TIMESTAMP` and "localhost". Elements and attributes are
those that the schemas of Ant and Jenkins have in common.

The Markdown is GitHub's, with the sections of `replan.draw.report.sections`. Names of logs,
planners and road users may contain anything: `_text` escapes Markdown in them. Long parts are
folded.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import quote
from xml.etree import ElementTree

import pandas as pd

from replan.core.errors import writing
from replan.draw.drawn_results import Results
from replan.draw.report.contents import Cell, Overview
from replan.draw.report.html import Attempts, write_html
from replan.draw.report.overview import log_outcomes, without_folders
from replan.draw.report.sections import ReportSection, comparison_sections, run_sections
from replan.metrics.judge.gates import Outcome
from replan.results.tables import REPORTS, write_text

TIMESTAMP = "1970-01-01T00:00:00"
TAGS = {Outcome.FAIL.value: "failure", Outcome.INCONCLUSIVE.value: "skipped", "error": "error"}
EVALUATED = "evaluated"
WORST = "worst"


@dataclass(frozen=True)
class JunitCase:
    """A test: `outcome` of a gate, or "error"; time is simulated, s."""

    classname: str
    name: str
    outcome: str
    reason: str = ""
    time_s: float = 0.0


def junit(results: Results, over: Overview) -> str:
    """The JUnit XML of a run.

    `over`: the overview of the run, with its comparison, if there is a baseline.
    """
    verdicts = log_outcomes(results)
    failed = [failure["message"] for failure in results.summary["failures"] if not failure["log"]]
    unjudged = [gate for gate in over.gates if not gate.planner]
    run = [JunitCase("run", EVALUATED, "error", message) for message in failed]
    run += [JunitCase("run.all logs", gate.rule, gate.outcome, gate.reason) for gate in unjudged]
    suites = [("run", run)]  # planners that could not be loaded, gates without a planner to judge
    suites += [
        (f"{planner}.{mode}", list(_of_drives(results, over, verdicts, planner, mode)))
        for planner, mode in results.run.drives
    ]
    if over.comparison is not None:
        rules = over.comparison.verdicts
        suites.append(
            (
                "compare",
                [JunitCase("compare", one.rule, one.outcome.value, one.reason) for one in rules],
            )
        )
    root = ElementTree.Element("testsuites")
    for i, (name, cases) in enumerate((name, cases) for name, cases in suites if cases):
        root.append(_suite(i, name, cases, over))
    ElementTree.indent(root)
    return (
        '<?xml version="1.0" '
        f'encoding="UTF-8"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'
    )


def _of_drives(
    results: Results, over: Overview, verdicts: pd.DataFrame, planner: str, mode: str
) -> Iterator[JunitCase]:
    """The tests of one planner and loop: gates over all logs, then each log."""
    for gate in over.gates:
        if (gate.planner, gate.mode) == (planner, mode) and (
            gate.over != WORST or gate.outcome == "inconclusive"
        ):
            yield JunitCase(
                f"{planner}.{mode}.{gate.group or 'all logs'}", gate.rule, gate.outcome, gate.reason
            )
    together = {gate.rule for gate in over.gates if gate.over != WORST}
    asked = (verdicts["outcome"] != Outcome.NOT_ASKED.value) & ~verdicts["gate"].isin(together)
    verdicts = verdicts[(verdicts["planner"] == planner) & (verdicts["mode"] == mode) & asked]
    short = without_folders(results)
    rows = dict(iter(verdicts.groupby("log", sort=False)))
    mine = results.drives[(results.drives["planner"] == planner) & (results.drives["mode"] == mode)]
    drives = dict(zip(mine["log"], mine["t_end_s"].astype(float), strict=True))
    for log in results.logs["log"]:
        where = f"{planner}.{mode}.{short(str(log)).replace('.', '_')}"
        errors = (
            failure["message"]
            for failure in results.summary["failures"]
            if failure["log"] == log
            and failure["planner"] in (None, planner)
            and failure["mode"] in (None, mode)
        )
        why = short("; ".join(errors)) or ("" if log in drives else "no result")
        yield JunitCase(where, EVALUATED, "error" if why else "pass", why, drives.get(log, 0.0))
        if log in drives and log in rows:
            for row in list[Any](rows[log].itertuples()):
                when = f" at {row.time_s:.2f} s" if isfinite(row.time_s) else ""
                value = f"{row.value:.4g}{when}" if isfinite(row.value) else ""
                yield JunitCase(
                    where, row.gate, row.outcome, ": ".join(filter(None, (value, row.reason)))
                )


def _suite(
    number: int, name: str, cases: Iterable[JunitCase], over: Overview
) -> ElementTree.Element:
    tests = []
    for case in cases:
        names = {
            "name": _legal(case.name),
            "classname": _legal(case.classname),
            "time": f"{case.time_s:.3f}",
        }
        test = ElementTree.Element("testcase", names)
        if case.outcome in TAGS:
            about = {"type": case.outcome, "message": _legal(case.reason or case.outcome)}
            ElementTree.SubElement(test, TAGS[case.outcome], about)
        tests.append(test)
    count = {tag: sum(test.find(tag) is not None for test in tests) for tag in TAGS.values()}
    suite = ElementTree.Element(
        "testsuite",
        {
            "name": _legal(name),
            "package": "replan",
            "id": str(number),
            "timestamp": TIMESTAMP,
            "hostname": "localhost",
            "tests": str(len(tests)),
            "failures": str(count["failure"]),
            "errors": str(count["error"]),
            "skipped": str(count["skipped"]),
            "time": f"{sum(float(test.attrib['time']) for test in tests):.3f}",
        },
    )
    properties = ElementTree.SubElement(suite, "properties")
    for key, value in (("replan", over.replan), ("config", over.config)):
        ElementTree.SubElement(properties, "property", name=key, value=_legal(value))
    suite.extend(tests)
    for tag in ("system-out", "system-err"):
        ElementTree.SubElement(suite, tag)
    return suite


def _legal(text: str) -> str:
    """The text, with characters replaced that XML 1.0 does not allow (section 2.2, Char)."""
    return re.sub(
        "[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]", "\N{REPLACEMENT CHARACTER}", text
    )


MARKDOWN, JUNIT, HTML = REPORTS


def write_reports(results: Results, over: Overview, out: Path) -> Overview:
    """Write the reports of a run, and the summary of the CI step if there is one.

    `out`: folder for the reports; created if needed. report.md has links only if it is the result
    folder.

    Returns:
        The overview, with the charts and files that could not be made: an error in one affects no
            other.
    """
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
    beside = out.resolve() == results.path.resolve()
    attempt = Attempts()
    broken = attempt(HTML, lambda: write_html(over, results, out / HTML), tuple[str, ...]())
    over = replace(over, broken=(*attempt.broken, *broken))
    attempt(JUNIT, lambda: write_text(out / JUNIT, junit(results, over)), None)
    over = replace(over, broken=(*attempt.broken, *broken))
    attempt(
        MARKDOWN,
        lambda: write_text(out / MARKDOWN, markdown(over, links=(HTML, JUNIT) if beside else None)),
        None,
    )
    append_step_summary(over)
    return replace(over, broken=(*attempt.broken, *broken))


T = TypeVar("T")

STEP_SUMMARY = "GITHUB_STEP_SUMMARY"
"""The environment variable with the path of the file that CI shows as the summary of a step."""
STEP_BYTES = 1 << 20  # GitHub's limit for a step summary; it shows nothing of a longer one
MAX_OPEN = 25  # Longest table or list that is not folded


def markdown(over: Overview, *, links: Iterable[str] | None = ()) -> str:
    """The report.

    `links`: files beside the report to link to first ("report.html"), before those of the drives;
    None: no links at all, for a report by itself.
    """
    parts = [f"# replan: {over.outcome}"]
    if not over.shard:
        fail, unsure = (
            sum(gate.outcome == word for gate in over.gates) for word in ("fail", "inconclusive")
        )
        verdicts = (
            f"{fail} of {len(over.gates)} verdicts of the gates fail, {unsure} are inconclusive"
        )
        parts.append(f"**{over.outcome.upper()}** (exit code {over.exit_code}): {verdicts}.")
        parts.append(
            "\n".join(f"- **{_text(each.planner)}**: {_text(each.text)}" for each in over.answers)
        )
    parts.append(f"replan {_text(over.replan)}, configuration {over.config}")
    parts.append(", ".join(f"[{_text(link)}]({quote(link)})" for link in links or ()))
    linked = links is not None
    look = [_link(f"{row.log}, {row.shown}", row.file if linked else "") for row in over.first]
    parts.append(f"Look first at {'; '.join(look)}." if look else "")
    parts += (section_text(section, linked=linked) for section in run_sections(over))
    if over.comparison is not None:
        parts.append(
            f"# Compared: {_text(over.comparison.baseline)} -> {_text(over.comparison.candidate)}"
        )
        parts += (
            section_text(section, linked=linked) for section in comparison_sections(over.comparison)
        )
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
    return (
        _fold(_text(section.title), text)
        if section.folded
        else f"## {_text(section.title)}\n\n{text}"
    )


def _in_sight(
    some: list[T], what: str, render: Callable[[list[T]], str], section: ReportSection
) -> list[str]:
    """Rows or lines; those beyond `MAX_OPEN` are folded."""
    most = len(some) if section.folded else MAX_OPEN
    more = (
        [_fold(f"{len(some) - most} more {what}", render(some[most:]))] if len(some) > most else []
    )
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
    """Append the report to the summary of the CI step, if there is one.

    Shortened to GitHub's limit.
    """
    name = environment.get(STEP_SUMMARY)
    if name:
        path = Path(name)
        left = STEP_BYTES - (path.stat().st_size if path.exists() else 0)
        with writing(path), path.open("a", encoding="utf-8", newline="\n") as file:
            file.write(shortened(markdown(over, links=None), left))


def shortened(text: str, most: int) -> str:
    """The text, if it has no more than `most` bytes.

    Otherwise the lines that fit, and a sentence about the rest.
    """
    if len(text.encode()) <= most:
        return text
    end = "\n\nThis report is shortened: all of it is in report.md of the result folder.\n"
    room = most - len(end.encode()) - len("\n\n</details>")
    if room < 0:
        return ""
    head = text.encode()[:room].decode(errors="ignore").rpartition("\n")[0]
    folded = "\n\n</details>" if head.count("<details>") > head.count("</details>") else ""
    return head + folded + end


# Markdown -----------------------------------------------------------------------------------------


def _text(words: str) -> str:
    """Any text on one line, escaped so that Markdown shows it unchanged."""
    shown = "".join(
        c if c.isprintable() or c.isspace() else "\N{REPLACEMENT CHARACTER}" for c in words
    )
    line = re.sub(r"\s+", " ", shown)
    return _SPECIAL.sub(
        lambda found: f"&amp;{found[0][1:]}" if found[0][0] == "&" else f"\\{found[0]}", line
    )


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
