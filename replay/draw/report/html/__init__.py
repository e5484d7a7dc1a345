"""The report as one HTML file: opens from disk, asks nothing of any network, works without script as one long page.

page.py     `write_html`: overview, comparison and a page per drive, from the overview and the results
drive.py    what the page of a drive says
templates/  the page (jinja2, everything escaped), its style and its script
"""

from replay.draw.report.html.page import write_html

__all__ = ["write_html"]
