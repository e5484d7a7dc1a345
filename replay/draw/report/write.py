"""The reports of a result folder, as files: report.md, junit.xml, report.html.

They are made from the results on disk, so that they can be made for any folder, and hold no path outside of the folder:
their bytes do not depend on where it is.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from logs.errors import writing
from replay.draw.report.html import Attempts, write_html
from replay.draw.report.junit import junit
from replay.draw.report.markdown import append_step_summary, markdown
from replay.draw.report.model import Overview
from replay.results.load import Results
from replay.results.tables import REPORTS, write_text

MARKDOWN, JUNIT, HTML = REPORTS


def write_reports(results: Results, over: Overview, out: Path) -> Overview:
    """Write the reports of a run, and the summary of the CI step where there is one.

    Args:
        results: The run.
        over: The overview of the run.
        out: Folder for them; created if needed. report.md has links only if it is the result folder.

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
