"""The reports of a result folder, as files: report.md, junit.xml, report.html; and the verdicts as JUnit XML.

They are made from the results on disk, so that they can be made for any folder, and contain no path outside of the
folder and no time of day: the same results give the same bytes, wherever the folder is.

JUnit, which CI systems show: a test per log and gate, a suite per planner and loop. In it, `classname` is
PLANNER.LOOP.LOG and `name` the rule of the gate:

    failure     the log breaks the gate's bound
    skipped     it is inconclusive
    error       the log could not be driven to the end, or not at all: one test "evaluated" per log, whose time is the
                simulated time of the drive

A verdict on all logs together (a mean, a share of passes, too little evidence) is a test of the class PLANNER.LOOP.all
logs, or of its group; a single log does not fail such a gate. There
is also a suite "run" for failures and gates without a
planner, and with a baseline a suite "compare" for its rules. So a test fails if `replan` ends with 1, and has an error
if it ends with 3. Ant's schema requires a timestamp and a host, which are `TIMESTAMP` and "localhost". Elements and
attributes are those that the schemas of Ant and Jenkins have in common.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pandas as pd

from logs.errors import writing
from metrics.judge.gates import Outcome
from replay.draw.drawn_results import Results
from replay.draw.report.contents import Overview
from replay.draw.report.html import Attempts, write_html
from replay.draw.report.markdown import append_step_summary, markdown
from replay.draw.report.overview import log_outcomes, without_folders
from replay.results.tables import REPORTS, write_text

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

    Args:
        results: The run.
        over: The overview of the run, with its comparison, if there is a baseline.
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
        suites.append(("compare", [JunitCase("compare", one.rule, one.outcome.value, one.reason) for one in rules]))
    root = ElementTree.Element("testsuites")
    for i, (name, cases) in enumerate((name, cases) for name, cases in suites if cases):
        root.append(_suite(i, name, cases, over))
    ElementTree.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _of_drives(
    results: Results, over: Overview, verdicts: pd.DataFrame, planner: str, mode: str
) -> Iterator[JunitCase]:
    """The tests of one planner and loop: gates over all logs, then each log."""
    for gate in over.gates:
        if (gate.planner, gate.mode) == (planner, mode) and (gate.over != WORST or gate.outcome == "inconclusive"):
            yield JunitCase(f"{planner}.{mode}.{gate.group or 'all logs'}", gate.rule, gate.outcome, gate.reason)
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
            failure["message"] for failure in results.summary["failures"]
            if failure["log"] == log and failure["planner"] in (None, planner) and failure["mode"] in (None, mode)
        )  # fmt: skip
        why = short("; ".join(errors)) or ("" if log in drives else "no result")
        yield JunitCase(where, EVALUATED, "error" if why else "pass", why, drives.get(log, 0.0))
        if log in drives and log in rows:
            for row in list[Any](rows[log].itertuples()):
                when = f" at {row.time_s:.2f} s" if isfinite(row.time_s) else ""
                value = f"{row.value:.4g}{when}" if isfinite(row.value) else ""
                yield JunitCase(where, row.gate, row.outcome, ": ".join(filter(None, (value, row.reason))))


def _suite(number: int, name: str, cases: Iterable[JunitCase], over: Overview) -> ElementTree.Element:
    tests = []
    for case in cases:
        names = {"name": _legal(case.name), "classname": _legal(case.classname), "time": f"{case.time_s:.3f}"}
        test = ElementTree.Element("testcase", names)
        if case.outcome in TAGS:
            about = {"type": case.outcome, "message": _legal(case.reason or case.outcome)}
            ElementTree.SubElement(test, TAGS[case.outcome], about)
        tests.append(test)
    count = {tag: sum(test.find(tag) is not None for test in tests) for tag in TAGS.values()}
    suite = ElementTree.Element(
        "testsuite",
        {
            "name": _legal(name), "package": "replan", "id": str(number), "timestamp": TIMESTAMP,
            "hostname": "localhost", "tests": str(len(tests)), "failures": str(count["failure"]),
            "errors": str(count["error"]), "skipped": str(count["skipped"]),
            "time": f"{sum(float(test.attrib['time']) for test in tests):.3f}",
        },
    )  # fmt: skip
    properties = ElementTree.SubElement(suite, "properties")
    for key, value in (("replan", over.replan), ("config", over.config)):
        ElementTree.SubElement(properties, "property", name=key, value=_legal(value))
    suite.extend(tests)
    for tag in ("system-out", "system-err"):
        ElementTree.SubElement(suite, tag)
    return suite


def _legal(text: str) -> str:
    """The text, with characters replaced that XML 1.0 does not allow (section 2.2, Char)."""
    return re.sub("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]", "\N{REPLACEMENT CHARACTER}", text)


MARKDOWN, JUNIT, HTML = REPORTS


def write_reports(results: Results, over: Overview, out: Path) -> Overview:
    """Write the reports of a run, and the summary of the CI step if there is one.

    `out`: folder for the reports; created if needed. report.md has links only if it is the result folder.

    Returns:
        The overview, with the charts and files that could not be made: an error in one affects no other.
    """
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
    beside = out.resolve() == results.path.resolve()
    attempt = Attempts()
    broken = attempt(HTML, lambda: write_html(over, results, out / HTML), tuple[str, ...]())
    over = replace(over, broken=(*attempt.broken, *broken))
    attempt(JUNIT, lambda: write_text(out / JUNIT, junit(results, over)), None)
    over = replace(over, broken=(*attempt.broken, *broken))
    attempt(MARKDOWN, lambda: write_text(out / MARKDOWN, markdown(over, links=(HTML, JUNIT) if beside else None)), None)
    append_step_summary(over)
    return replace(over, broken=(*attempt.broken, *broken))
