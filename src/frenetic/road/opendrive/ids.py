"""Ids of roads, in the texts by which users choose roads and in messages."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import Final
from xml.etree.ElementTree import Element

from frenetic.errors import RoadError

_PLAIN_ID: Final = re.compile(r'[^\s,@"]([^,@"]*[^\s,@"])?')
"""An id that needs no quotes."""
_ID_IN_LIST: Final = re.compile(r'\s*("(?:[^"\\]|\\.)*"|[^,@"]*)(?:@([^,]*))?\s*(,|$)')
"""An id, a start after an @, and the comma after both."""
_MAX_LETTERS: Final = 80
"""Length of the longest text that a message shows in full; our choice."""
_END_LETTERS: Final = 20
"""Number of letters that a message shows of a longer text's end; our choice."""
QUOTING: Final = "an id with a comma, an @ or a quote stands in double quotes"
"""Rule for quotes, for messages."""


def parse_ids(text: str, known: Collection[str]) -> list[tuple[str, str]]:
    """Return the roads in a text for `RoadMap.stretches`: each id with the text after its @.

    Example: ``12@240,13`` gives ``("12", "240")`` and ``("13", "")``.

    Args:
        text: the user's text.
        known: ids of the map's roads. A text that is such an id is one road, even with commas.

    Raises:
        RoadError: a quote is not closed, or text follows a closing quote.
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
    if len(text) <= _MAX_LETTERS:
        return text
    return f"{text[: _MAX_LETTERS - _END_LETTERS - 2]}..{text[-_END_LETTERS:]}"


@contextmanager
def name_in_errors(*roads: Element) -> Iterator[None]:
    """Put the roads' ids in front of `RoadError` messages that the block raises."""
    try:
        yield
    except RoadError as error:
        names = shortened(",".join(quoted_id(road.get("id", "")) for road in roads))
        raise RoadError(f"road {names}: {error}") from None
