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
"""Largest number of elements of a file; our choice: a map of a town has 200,000."""


class _Tree(ElementTree.TreeBuilder):
    """A builder of element trees that refuses harmful content.

    A document type is refused, and with it every entity: entities that expand to gigabytes (the
    "billion laughs"), and entities that would be fetched from elsewhere.
    """

    elements = 0
    """Number of elements so far."""

    def doctype(self, *_: object) -> None:
        """Refuse a document type."""
        raise RoadError("it has a document type (DOCTYPE), which no OpenDRIVE file needs")

    def start(self, tag: str, attrs: dict[str, str], /) -> Element:
        """Open an element; its tag loses its namespace."""
        self.elements += 1
        if self.elements > MAX_ELEMENTS:
            raise RoadError(
                f"it has more than {MAX_ELEMENTS} elements: take the part of the map that you need"
            )
        return super().start(tag.rpartition("}")[2], attrs)


def parse_xml(data: bytes) -> Element:
    """Return the root element of an XML file's content.

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
    """Return an attribute of an element as a number.

    Args:
        element: the element.
        name: name of the attribute.
        default: number for a missing attribute; None if the attribute is needed.
        most: largest number that is allowed, in either direction.

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
    """Return the coefficients a, b, c, d of an element's cubic polynomial; a missing one is 0.

    Args:
        element: the element.
        suffix: end of the attributes' names, such as ``U`` of ``aU``.
    """
    return [number_of(element, name + suffix, 0.0) for name in "abcd"]


def evaluate_cubics(
    elements: Sequence[Element], name: str, distances: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the values (n,) and slopes (n,) of a piecewise cubic; 0 before its first piece.

    Args:
        elements: elements with the coefficients of a piece each.
        name: name of the attribute with the distance in m from which a piece holds.
        distances: distances along the road, or in another direction, (n,) in m.
    """
    elements = sorted(elements, key=lambda element: number_of(element, name))
    starts = np.array([0.0, *(number_of(element, name) for element in elements)])
    cubics = np.array([[0.0] * 4, *map(coefficients_of, elements)])
    rows = np.searchsorted(starts[1:], distances, side="right")
    p = distances - starts[rows]
    a, b, c, d = cubics[rows].T
    return a + p * (b + p * (c + p * d)), b + p * (2.0 * c + p * 3.0 * d)
