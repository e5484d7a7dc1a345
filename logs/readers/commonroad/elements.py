"""Reads numbers, points and references in elements of CommonRoad XML.

Functions take an element's place in the file for the error, and raise LogError where a value is
missing or is no number.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from replan.core.arrays import FloatArray
from replan.core.errors import LogError

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

LARGEST = 1e9
"""A larger number is not a valid length, time or speed."""


def number(text: str | None, place: str) -> float:
    """The number in a text; LogError where the text is not a number, or the number is
    implausible.
    """
    try:
        value = float(text or "")
    except ValueError:
        raise LogError(
            f"{text!r} is no number", topic=place, remedy="correct the element"
        ) from None
    if not abs(value) < LARGEST:
        raise LogError(f"value is {value}", topic=place, remedy="correct the element")
    return value


def integer(text: str | None, place: str) -> int:
    """The whole number in a text."""
    return int(number(text, place))


def child(parent: Element, path: str, place: str) -> Element:
    """Return a required child element; LogError if it is missing."""
    element = parent.find(path)
    if element is None:
        raise missing(path, place)
    return element


def missing(path: str, place: str) -> LogError:
    """Return the error of a required child element that is missing."""
    return LogError(f"<{path}> is missing", topic=place, remedy="the format requires it")


def interval(parent: Element, tag: str, place: str) -> tuple[float, float] | None:
    """Bounds of an exact value or an interval; None where the element is absent."""
    element = parent.find(tag)
    if element is None:
        return None
    exact = element.find("exact")
    if exact is not None:
        value = number(exact.text, f"{place}/{tag}")
        return value, value
    ends = (child(element, end, f"{place}/{tag}") for end in ("intervalStart", "intervalEnd"))
    low, high = (number(end.text, f"{place}/{tag}") for end in ends)
    return low, high


def middle(parent: Element, tag: str, place: str) -> float:
    """Exact value, or the middle of an interval; NaN where the element is absent."""
    bounds = interval(parent, tag, place)
    return float("nan") if bounds is None else 0.5 * (bounds[0] + bounds[1])


def references(parent: Element, tag: str, place: str) -> tuple[int, ...]:
    """Return the ids to which the children with that tag refer."""
    return tuple(integer(e.get("ref"), f"{place}/{tag}@ref") for e in parent.findall(tag))


def point_in(element: Element, place: str) -> tuple[float, float]:
    """The point of an element with <x> and <y>, m."""
    x, y = (number(child(element, axis, place).text, f"{place}/{axis}") for axis in ("x", "y"))
    return x, y


def points_in(element: Element, place: str) -> FloatArray:
    """The points `(n, 2)` of an element, m."""
    points = [point_in(point, place) for point in element.findall("point")]
    return np.array(points).reshape(-1, 2)
