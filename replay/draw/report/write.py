"""The reports of a result folder, as files: report.md, junit.xml, report.html.

They are made of the results as they are read back, so that a folder from elsewhere has them too, and hold no path but
those within the folder: whatever holds them, their bytes are the same.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from logs.errors import writing
from replay.draw.report.attempts import Attempts
from replay.draw.report.html import write_html
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
        over: What they say of it.
        out: Folder for them; made if it is not there. The links of report.md need it to be the result folder.

    Returns:
        What they say, with the charts and files that could not be made: an error in one of them costs that one only.
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
