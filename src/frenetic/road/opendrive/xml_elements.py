"""XML elements of an OpenDRIVE file: parsing, numbers and polynomials."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.errors import RoadError
from frenetic.road.road_values import MAX_COORDINATE

MAX_ELEMENTS: Final = 1_000_000
"""Most elements of a file; ours: a map of a town has 200,000."""


class _Tree(ElementTree.TreeBuilder):
    """A builder of element trees that refuses harmful content.

    A document type is refused, and with it every entity: those that expand to gigabytes (the
    "billion laughs"), and those that would be fetched from elsewhere.
    """

    elements = 0

    def doctype(self, *_: object) -> None:
        raise RoadError("it has a document type (DOCTYPE), which no OpenDRIVE file needs")

    def start(self, tag: str, attrs: dict[str, str], /) -> Element:
        self.elements += 1
        if self.elements > MAX_ELEMENTS:
            raise RoadError(
                f"it has more than {MAX_ELEMENTS} elements: take the part of the map that you need"
            )
        return super().start(tag.rpartition("}")[2], attrs)  # any namespace


def parse_xml(data: bytes) -> Element:
    """Return the root element.

    Raises:
        RoadError: the data are no well-formed XML, have a document type, or too many elements.
    """
    try:
        return ElementTree.XML(data, ElementTree.XMLParser(target=_Tree()))  # noqa: S314 - no DTD
    except ElementTree.ParseError as error:
        raise RoadError(f"it is not XML: {error}") from None
    except RoadError:
        raise
    except (LookupError, ValueError):
        raise RoadError("it is not XML in an encoding that can be read: save it as UTF-8") from None


def number_of(
    element: Element, name: str, default: float | None = None, *, most: float = MAX_COORDINATE
) -> float:
    """Return an attribute of an element as a number of at most ``most`` in either direction.

    Raises:
        RoadError: the attribute is missing and there is no default, its text is no number, or the
            number is too large.
    """
    text = element.get(name)
    if text is None:
        if default is None:
            raise RoadError(f"a <{element.tag}> has no '{name}'")
        return default
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= most:
        raise RoadError(
            f"a <{element.tag}> has {name}={text[:40]!r}: a number of at most {most:g} in either"
            " direction is needed"
        )
    return value


def is_true(element: Element, name: str) -> bool:
    """Return whether an attribute is true; a missing attribute is false."""
    return element.get(name, "").strip().lower() in ("true", "1")


def coefficients_of(element: Element, suffix: str = "") -> list[float]:
    """Return the coefficients a, b, c, d of a polynomial; missing coefficients are 0."""
    return [number_of(element, name + suffix, 0.0) for name in "abcd"]


def evaluate_cubics(
    elements: Sequence[Element], name: str, places: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return values (n,) and slopes (n,) of piecewise cubics at places (n,) in m along the road.

    Each element's cubic holds from its attribute ``name`` on, in m; before the first, all is 0.
    """
    elements = sorted(elements, key=lambda element: number_of(element, name))
    starts = np.array([0.0, *(number_of(element, name) for element in elements)])
    cubics = np.array([[0.0] * 4, *map(coefficients_of, elements)])
    rows = np.searchsorted(starts[1:], places, side="right")
    p = places - starts[rows]
    a, b, c, d = cubics[rows].T
    return a + p * (b + p * (c + p * d)), b + p * (2.0 * c + p * 3.0 * d)
