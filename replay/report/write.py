"""The reports of a result folder, as files: report.md, junit.xml.

They are made of the results as they are read back, so that a folder from elsewhere has them too, and hold no path but
those within the folder: whatever holds them, their bytes are the same.
"""

from __future__ import annotations

from pathlib import Path

from replay.batch.tables import write_text
from replay.report.junit import junit
from replay.report.markdown import markdown
from replay.report.overview import Overview
from replay.results import Results

MARKDOWN, JUNIT = "report.md", "junit.xml"


def write_reports(results: Results, over: Overview, out: Path) -> tuple[Path, ...]:
    """Write the reports of a run.

    Args:
        results: The run.
        over: What they say of it.
        out: Folder for them; made if it is not there. The links of report.md need it to be the result folder.

    Returns:
        What was written.
    """
    out.mkdir(parents=True, exist_ok=True)
    beside = out.resolve() == results.path.resolve()
    written = out / MARKDOWN, out / JUNIT
    write_text(written[0], markdown(over, links=(JUNIT,) if beside else None))
    write_text(written[1], junit(results, over))
    return written
