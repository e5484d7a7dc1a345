"""The reports of a result folder, as files: report.md, junit.xml, report.html, and the summary of a
step in CI.

They are made from the results on disk, so that they can be made for any folder, and contain no path
outside of the folder and no time of day: the same results give the same bytes, wherever the folder
is.

JUnit, which CI systems show, has a test per log and gate, a suite per planner and loop. In it,
`classname` is PLANNER.LOOP.LOG and `name` the rule of the gate:

    failure     the log breaks the gate's bound
    skipped     it is inconclusive
    error       the log could not be driven to the end, or not at all: one test "evaluated" per log,
                whose time is the simulated time of the drive

A verdict on all logs together (a mean, a share of passes, too little evidence) is a test of the
class PLANNER.LOOP.all logs, or of its group; a single log does not fail such a gate. There is also
a suite "run" for failures and gates without a planner, and with a baseline a suite "compare" for
its rules. So a test fails if `replan` ends with 1, and has an error if it ends with 3. Ant's schema
requires a timestamp and a host, which are the epoch and "localhost". Elements and attributes are
those that the schemas of Ant and Jenkins have in common.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import Any

from replan.core.errors import writing
from replan.draw.report.attempts import Attempts
from replan.draw.report.comparison_sections import comparison_sections
from replan.draw.report.html import write_html
from replan.draw.report.overview import WORST, Overview, failure_lines, without_folders
from replan.draw.report.rendering import rendered
from replan.draw.report.run_sections import run_sections
from replan.draw.report.section import ReportSection
from replan.metrics.judge.gates import Outcome
from replan.results.tables import REPORTS, write_text

MARKDOWN, JUNIT, HTML = REPORTS


def write_reports(over: Overview, folder: Path) -> Overview:
    """Write the reports of a run, and the summary of the CI step if there is one.

    `folder`: folder for the reports; created if needed. report.md has links only if it is the
    result folder.

    Returns:
        The overview, with the charts and files that could not be made: an error in one affects no
            other.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    attempt = Attempts()
    charts = attempt(HTML, lambda: write_html(over, folder / HTML), tuple[str, ...]())
    attempt(JUNIT, lambda: write_text(folder / JUNIT, junit(over)), None)
    over = replace(over, broken=(*attempt.broken, *charts))
    links = (HTML, JUNIT) if folder.resolve() == over.results.path.resolve() else None
    attempt(MARKDOWN, lambda: write_text(folder / MARKDOWN, markdown(over, links=links)), None)
    append_step_summary(over)
    return replace(over, broken=(*attempt.broken, *charts))


# JUnit --------------------------------------------------------------------------------------------

TAGS = {Outcome.FAIL.value: "failure", Outcome.INCONCLUSIVE.value: "skipped", "error": "error"}
EVALUATED = "evaluated"


@dataclass(frozen=True)
class JunitCase:
    """A test: `outcome` of a gate, or "error"; time is simulated, s."""

    classname: str
    name: str
    outcome: str
    reason: str = ""
    time_s: float = 0.0

    @property
    def tag(self) -> str:
        """The element that says how it ended; "" if it passed."""
        return TAGS.get(self.outcome, "")


def junit(over: Overview) -> str:
    """The JUnit XML of a run, and of its comparison, if there is a baseline."""
    results = over.results
    failures = [failure for failure in results.summary["failures"] if not failure["log"]]
    unjudged = [gate for gate in over.gates if not gate.planner]
    # planners that could not be loaded, gates without a planner to judge
    run = [JunitCase("run", EVALUATED, "error", failure["message"]) for failure in failures]
    run += [JunitCase("run.all logs", gate.rule, gate.outcome, gate.reason) for gate in unjudged]
    suites = {"run": run}
    for planner, mode in results.run.drives:
        cases = [*_of_all_logs(over, planner, mode), *_of_each_log(over, planner, mode)]
        suites[f"{planner}.{mode}"] = cases
    if over.comparison is not None:
        suites["compare"] = [
            JunitCase("compare", verdict.rule, verdict.outcome.value, verdict.reason)
            for verdict in over.comparison.verdicts
        ]
    return junit_xml(suites, over.replan, over.config)


def junit_xml(suites: Mapping[str, Sequence[JunitCase]], replan: str, config: str) -> str:
    """Suites of tests, which may contain any names; `replan` and `config` are their properties."""
    return rendered("junit.xml", suites=suites, replan=replan, config=config)


def _of_all_logs(over: Overview, planner: str, mode: str) -> Iterator[JunitCase]:
    """The gates over all logs of one planner and loop, and those with too little evidence."""
    for gate in over.gates:
        inconclusive = gate.outcome == Outcome.INCONCLUSIVE.value
        if (gate.planner, gate.mode) == (planner, mode) and (gate.over != WORST or inconclusive):
            classname = f"{planner}.{mode}.{gate.group or 'all logs'}"
            yield JunitCase(classname, gate.rule, gate.outcome, gate.reason)


def _of_each_log(over: Overview, planner: str, mode: str) -> Iterator[JunitCase]:
    """The tests of each log with one planner and loop."""
    results, short = over.results, without_folders(over.results)
    together = {gate.rule for gate in over.gates if gate.over != WORST}
    verdicts = over.verdicts.query("planner == @planner and mode == @mode")
    is_single = ~verdicts["gate"].isin(together)
    verdicts = verdicts[is_single & (verdicts["outcome"] != Outcome.NOT_ASKED.value)]
    lines = dict(failure_lines(over))
    by_log = dict(iter(verdicts.groupby("log", sort=False)))
    drives = results.drives.query("planner == @planner and mode == @mode")
    ends_s = dict(zip(drives["log"], drives["t_end_s"].astype(float), strict=True))
    for log in results.logs["log"]:
        classname = f"{planner}.{mode}.{short(str(log)).replace('.', '_')}"
        errors = [
            failure["message"]
            for failure in results.summary["failures"]
            if (failure["log"], failure["planner"] or planner, failure["mode"] or mode)
            == (log, planner, mode)
        ]
        if log not in ends_s and not errors:
            errors = ["no result"]
        outcome = "error" if errors else "pass"
        yield JunitCase(
            classname, EVALUATED, outcome, short("; ".join(errors)), ends_s.get(log, 0.0)
        )
        if log in ends_s and log in by_log:
            for row in list[Any](by_log[log].itertuples()):
                time = f" at {row.time_s:.2f} s" if isfinite(row.time_s) else ""
                value = f"{row.value:.4g}{time}" if isfinite(row.value) else ""
                reason = ": ".join(filter(None, (value, row.reason)))
                line = lines.get((row.gate, log, planner, mode), reason)
                yield JunitCase(classname, row.gate, row.outcome, line)


# Markdown -----------------------------------------------------------------------------------------

STEP_SUMMARY = "GITHUB_STEP_SUMMARY"
"""The environment variable with the path of the file that CI shows as the summary of a step."""
STEP_BYTES = 1 << 20  # GitHub's limit for a step summary; it shows nothing of a longer one
MAX_OPEN = 25  # Longest table or list that is not folded


def markdown(over: Overview, *, links: Sequence[str] | None = ()) -> str:
    """The report.

    `links`: files beside the report to link to first ("report.html"), before those of the drives;
    None: no links at all, for a report by itself.
    """
    text = rendered(
        "report.md",
        overview=over,
        sections=run_sections(over),
        compared=comparison_sections(over.comparison) if over.comparison else [],
        links=links,
        linked=links is not None,
        most=MAX_OPEN,
    )
    return f"{text.rstrip()}\n"


def section_text(section: ReportSection, *, linked: bool = False) -> str:
    """A section; behind its title if it is folded, and the part beyond `MAX_OPEN` rows or lines."""
    return rendered("section.md", section=section, linked=linked, most=MAX_OPEN)


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
