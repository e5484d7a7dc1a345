"""Renders the files of templates/ (jinja2): HTML and XML with everything escaped, Markdown by its
own filters.

The Markdown is GitHub's. Names of logs, planners and road users may contain anything: the filter
`markdown` escapes Markdown in them.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable
from functools import cache
from importlib import resources
from math import isfinite
from typing import Any
from urllib.parse import quote
from xml.sax.saxutils import quoteattr

from jinja2 import Environment, FunctionLoader, StrictUndefined, select_autoescape
from markupsafe import Markup

from replan.draw.charts.style import RULES, filled, roles
from replan.draw.charts.svg import printable
from replan.draw.report.section import MISSING, Cell, unit_suffix
from replan.metrics.judge.gates import Outcome

LEAST_SHOWN = 1e-12  # Smaller values are shown as 0


def rendered(template: str, **content: Any) -> str:
    """A file of templates/, filled in; pages get `style` and `script`, which all of them have."""
    return _environment().get_template(template).render(**content)


def _read(name: str) -> str:
    templates = resources.files("replan.draw.report").joinpath("templates")
    return templates.joinpath(name).read_text(encoding="utf-8")


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=FunctionLoader(_read),
        autoescape=select_autoescape(("html", "xml")),
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    # Files of replan: no escaping
    style = Markup(_read("style.css") + roles("auto") + filled(RULES, "auto"))
    environment.globals |= {"style": style, "script": Markup(_read("script.js"))}
    environment.filters |= {
        "number": number,
        "seconds": lambda seconds: f"{seconds:.2f} s" if isfinite(seconds) else "",
        "unit": unit_suffix,
        "line": printable,
        "sorts": sort_key,
        "shell": shlex.quote,
        "first_recording": first_recording,
        "attribute": xml_attribute,
        "markdown": markdown_text,
        "markdown_cell": markdown_cell,
        "markdown_link": markdown_link,
    }
    return environment


def first_recording(files: Iterable[str]) -> str:
    """The recording, or the trace if there is none; "" without files."""
    return min(files, key=lambda name: not name.endswith(".rrd"), default="")


def number(value: object) -> str:
    """Four digits; `MISSING` for a missing value."""
    if not isinstance(value, (int, float)) or not isfinite(value):
        return MISSING
    return f"{0.0 if abs(value) < LEAST_SHOWN else value:.4g}"


def sort_key(value: float) -> str:
    """The sort key of a cell; an empty key is last."""
    return f"{value:.9g}" if isfinite(value) else ""


def xml_attribute(text: str) -> Markup:
    """A text as the quoted value of an attribute, with characters replaced that XML 1.0 does not
    allow (section 2.2, Char).
    """
    legal = re.sub(
        "[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]", "\N{REPLACEMENT CHARACTER}", text
    )
    return Markup(quoteattr(legal))


# Markdown -----------------------------------------------------------------------------------------

_SPECIAL = re.compile(
    r"[\\`*|~$]"  # anywhere
    r"|(?<![^\W_])_|_(?![^\W_])"  # an underscore that is not within a word
    r"|<(?=[A-Za-z/!?])|](?=[(\[:])|&(?=#?\w+;)"  # tags, links, entities
    r"|^[-+=#>\[]|(?<=^\d)[.)](?=\s)|(?<=^\d\d)[.)](?=\s)"  # marks that begin a block
)
_BRACKET, _BACKSLASHED = re.compile(r"(?<!\\)([\[\]])"), r"\\\1"


def markdown_text(words: str) -> str:
    """Any text on one line, escaped so that Markdown shows it unchanged."""
    shown = "".join(
        c if c.isprintable() or c.isspace() else "\N{REPLACEMENT CHARACTER}" for c in words
    )
    return _SPECIAL.sub(_escaped, re.sub(r"\s+", " ", shown))


def _escaped(match: re.Match[str]) -> str:
    return f"&amp;{match[0][1:]}" if match[0].startswith("&") else f"\\{match[0]}"


def markdown_link(words: str, file: str) -> str:
    """A link to a file; the words alone if there is none."""
    shown = markdown_text(words)
    return f"[{_BRACKET.sub(_BACKSLASHED, shown)}]({quote(file)})" if file else shown


def markdown_cell(cell: Cell, linked: bool) -> str:
    """A cell of a table, with a link to its file if `linked`."""
    if linked and cell.file:
        return markdown_link(cell.text, cell.file)
    is_failure = cell.outcome == Outcome.FAIL.value
    words = markdown_text(cell.text.replace("fail", "FAIL", 1) if is_failure else cell.text)
    return f"**{words}**" if cell.bad else words
