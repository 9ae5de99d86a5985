"""XML from strangers: a tree of elements with their attributes, without anything harmful."""

from __future__ import annotations

import math
from typing import Final
from xml.etree import ElementTree
from xml.parsers import expat

from frenetic.errors import RoadError

MAX_ELEMENTS: Final = 200_000
"""Most elements of a file; a road has two per geometry."""
MAX_DEPTH: Final = 50
"""Deepest nesting of elements."""
MAX_NUMBER: Final = 1e7
"""Largest number in a file, in m or its own unit, unless another limit is given."""


def parse_xml(data: bytes) -> ElementTree.Element:
    """The root element; text between the elements is left out.

    A document type is refused, and with it every entity: those that expand to gigabytes (the
    "billion laughs"), and those that would be fetched from elsewhere.

    Raises:
        RoadError: no well-formed XML, a document type, too many elements or too deep ones.
    """
    builder = ElementTree.TreeBuilder()
    parser = expat.ParserCreate()
    elements = depth = 0

    def refuse_document_type(*_: object) -> None:
        raise RoadError("it has a document type (DOCTYPE), which no OpenDRIVE file needs")

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal elements, depth
        elements += 1
        depth += 1
        if elements > MAX_ELEMENTS or depth > MAX_DEPTH:
            raise RoadError(
                f"more than {MAX_ELEMENTS} elements, or some nested deeper than {MAX_DEPTH}: no"
                " file of a single road is that large"
            )
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    parser.StartDoctypeDeclHandler = refuse_document_type
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        what = expat.ErrorString(error.code)
        raise RoadError(
            f"it is not XML: {what} in line {error.lineno}, column {error.offset + 1}"
        ) from None
    except (LookupError, ValueError) as error:
        if isinstance(error, RoadError):
            raise
        raise RoadError("it is not XML in an encoding that can be read: save it as UTF-8") from None
    return builder.close()


def number(
    element: ElementTree.Element,
    name: str,
    default: float | None = None,
    *,
    most: float = MAX_NUMBER,
) -> float:
    """A number among an element's attributes, at most ``most`` in either direction.

    Raises:
        RoadError: it is missing and there is no default, it is no finite number, or too large.
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
    if not math.isfinite(value):
        raise RoadError(f"a <{element.tag}> has {name}={text[:40]!r}: a finite number is needed")
    if abs(value) > most:
        raise RoadError(
            f"a <{element.tag}> has {name}={text[:40]!r}: at most {most:g} in either direction is"
            " read"
        )
    return value
