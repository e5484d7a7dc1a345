"""Legends: samples of lines, areas, dots and signs, each with its word."""

from __future__ import annotations

from collections.abc import Sequence

from replan.draw.charts.svg import LETTER_PX, dot, line, rect, shortened, text

AREA_PX = 16.0  # Width of a sample
WORD_PX = 21.0  # From the begin of a sample to its word
SAMPLE_PX = 34.0  # Width of an entry without its word: the sample, and spaces around the word
SLACK_PX = 8.0  # A row may be wider than its legend by less than the space after its last word
LEGEND_PX = 14.0  # Height of a row

Entry = tuple[str, str, str]
"""An entry of a legend: element ("line", "area", "dot", or a sign), class and word."""


def entry_width(word: str) -> float:
    """The width of an entry, pixels."""
    return SAMPLE_PX + LETTER_PX * len(word)


def legend_words(words: Sequence[str], width: float) -> list[str]:
    """Words for a legend of this width in pixels: as they are if they fit, otherwise each shortened
    to its share.
    """
    if sum(map(entry_width, words)) <= width:
        return list(words)
    return [shortened(word, width / len(words) - SAMPLE_PX) for word in words]


def legend_rows(entries: Sequence[Entry], width: float) -> list[list[Entry]]:
    """The entries in rows of at most this width in pixels."""
    rows, taken = list[list[Entry]](), 0.0
    for entry in entries:
        _, _, word = entry
        if not rows or taken + entry_width(word) > width + SLACK_PX:
            rows.append([])
            taken = 0.0
        rows[-1].append(entry)
        taken += entry_width(word)
    return rows


def legend(x: float, y: float, entries: Sequence[Entry]) -> str:
    """Samples in a row, each with its word; `y` is the line on which the words stand."""
    samples, middle = "", 0.5 * AREA_PX
    for element, kind, word in entries:
        if element == "area":
            samples += rect(x, y - 8.0, AREA_PX, 8.0, kind)
        elif element == "dot":
            samples += dot(x + middle, y - 4.0, 3.0, kind)
        elif element == "line":
            samples += line(x, y - 3.5, x + AREA_PX, y - 3.5, kind)
        else:
            samples += text(x + middle, y, element, f"sign {kind}")
        samples += text(x + WORD_PX, y, word, "small")
        x += entry_width(word)
    return samples
