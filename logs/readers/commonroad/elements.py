"""Values in the elements of a CommonRoad XML file: numbers, intervals, points; what is wrong is named with its place.

Each function takes the place for the error's line and raises LogError where the value is missing or no number.
"""

from __future__ import annotations

from xml.etree.ElementTree import Element

import numpy as np

from logs.errors import LogError
from logs.kernel import FloatArray

LARGEST = 1e9
"""Any larger number is no length, time or speed."""


def number(text: str | None, place: str) -> float:
    """The number in a text; LogError where it is none, or none that can be meant."""
    try:
        value = float(text or "")
    except ValueError:
        raise LogError(f"{text!r} is no number", topic=place, remedy="correct the element") from None
    if not abs(value) < LARGEST:
        raise LogError(f"value is {value}", topic=place, remedy="correct the element")
    return value


def integer(text: str | None, place: str) -> int:
    """The whole number in a text."""
    return int(number(text, place))


def child(parent: Element, path: str, place: str) -> Element:
    """The element that the format requires there."""
    found = parent.find(path)
    if found is None:
        raise LogError(f"<{path}> is missing", topic=place, remedy="the format requires it")
    return found


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
    """What the children of that tag refer to."""
    return tuple(integer(e.get("ref"), f"{place}/{tag}@ref") for e in parent.findall(tag))


def point_in(element: Element, place: str) -> tuple[float, float]:
    """The point of an element with <x> and <y>, m."""
    x, y = (number(child(element, axis, place).text, f"{place}/{axis}") for axis in ("x", "y"))
    return x, y


def points_in(element: Element, place: str) -> FloatArray:
    """The points `(n, 2)` of an element, m."""
    return np.array([point_in(each, place) for each in element.findall("point")]).reshape(-1, 2)
