"""Ids of roads in the texts that users write and in messages."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import Final
from xml.etree.ElementTree import Element

from frenetic.errors import RoadError

_PLAIN_ID: Final = re.compile(r'[^\s,@"]([^,@"]*[^\s,@"])?')
"""Id that needs no quotes."""
_ID_IN_LIST: Final = re.compile(r'\s*("(?:[^"\\]|\\.)*"|[^,@"]*)(?:@([^,]*))?\s*(,|$)')
"""Id, start behind an @, and the comma behind both."""
_MAX_LETTERS: Final = 80
"""Longest text that a message shows in full; ours."""
QUOTING: Final = "an id with a comma, an @ or a quote stands in double quotes"
"""Rule for quotes, for messages."""


def parse_ids(text: str, known: Collection[str]) -> list[tuple[str, str]]:
    """Return the roads in a text for `RoadMap.stretches`: each id with the text behind its @.

    Args:
        text: the user's text, such as ``12@240,13``.
        known: ids of the map's roads. A text that is such an id is one road, whatever its commas.

    Raises:
        RoadError: a quote has no end, or something stands behind it.
    """
    ids = []
    position = 0
    is_last = False
    while not is_last:
        match = _ID_IN_LIST.match(text, position)
        if match is None:
            if text.strip() in known:
                return [(text.strip(), "")]
            raise RoadError(f"{shortened(text)!r} is not ID[@METRES][,ID..]: {QUOTING}")
        road_id, start, comma = match[1].strip(), match[2] or "", match[3]
        if road_id.startswith('"'):
            try:
                road_id = str(json.loads(road_id, strict=False))
            except ValueError as error:
                raise RoadError(f"{shortened(road_id)} cannot be read: {error}") from None
        ids.append((road_id, start))
        position, is_last = match.end(), not comma
    if text.strip() in known and any(road_id not in known for road_id, _ in ids):
        return [(text.strip(), "")]
    return ids


def quoted_id(road_id: str) -> str:
    """Return a road's id for a text of `RoadMap.stretches`, in double quotes if it needs them."""
    if road_id.isprintable() and _PLAIN_ID.fullmatch(road_id):
        return road_id
    return json.dumps(road_id, ensure_ascii=not road_id.isprintable())


def shortened(text: str) -> str:
    """Return a text for a message, without its middle if it is long."""
    return text if len(text) <= _MAX_LETTERS else f"{text[: _MAX_LETTERS - 22]}..{text[-20:]}"


@contextmanager
def name_in_errors(*roads: Element) -> Iterator[None]:
    """Put the roads' ids in front of errors that the block raises."""
    try:
        yield
    except RoadError as error:
        names = shortened(",".join(quoted_id(road.get("id", "")) for road in roads))
        raise RoadError(f"road {names}: {error}") from None
