"""The roads of an OpenDRIVE file in the order in which a lane is driven, and the lane's ids."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias
from xml.etree.ElementTree import Element

from frenetic.errors import LaneError, RoadError

_OTHER: Final = {"start": "end", "end": "start"}

_End: TypeAlias = "tuple[str, str]"
"""A road's id, and its ``start`` or ``end``."""


@dataclass(frozen=True)
class Stretch:
    """A road that is driven from its start to its end, or backwards."""

    road: Element
    backwards: bool


def driven_stretches(roads: Sequence[Element], *, backwards: bool) -> list[Stretch]:
    """The roads of a file in driving order, which have to be one chain of linked roads.

    Args:
        roads: all of the file, without junctions.
        backwards: whether the chain is driven from its end to its start. It starts where a road
            starts without a predecessor, the first in the file if both its ends are such.

    Raises:
        RoadError: they are no such chain.
    """
    chain = [Stretch(roads[0], False)] if len(roads) == 1 else _chain(roads)
    if backwards:
        chain = [Stretch(stretch.road, not stretch.backwards) for stretch in reversed(chain)]
    return chain


def _chain(roads: Sequence[Element]) -> list[Stretch]:
    count = f"it has {len(roads)} roads"
    by_id = {road.get("id", ""): road for road in roads}
    if len(by_id) < len(roads):
        raise RoadError(f"{count}, some with the same id or none: linked roads are read")
    links = _links(by_id)
    free = [
        (name, side) for side in ("start", "end") for name in by_id if (name, side) not in links
    ]
    if not free:
        raise RoadError(f"{count} in a closed loop: a chain with a start and an end is read")
    end: _End | None = free[0]
    chain: list[Stretch] = []
    while end is not None:
        name, side = end
        chain.append(Stretch(by_id[name], side == "end"))
        end = links.get((name, _OTHER[side]))
    if len(chain) < len(roads):
        raise RoadError(
            f"{count}, of which {len(chain)} are linked from road {free[0][0]!r:.40} on: a single"
            " road, or one chain of linked ones (successor, predecessor), is read"
        )
    return chain


def _links(by_id: dict[str, Element]) -> dict[_End, _End]:
    """Meeting ends of roads, both ways."""
    links: dict[_End, _End] = {}
    for name, road in by_id.items():
        for kind, side in (("predecessor", "start"), ("successor", "end")):
            link = road.find(f"link/{kind}")
            if link is None:
                continue
            place = f"the {kind} of road {name!r:.40}"
            if link.get("elementType", "road") != "road":
                raise RoadError(f"{place} is a {link.get('elementType')!r:.40}: a road is needed")
            there = (link.get("elementId", ""), link.get("contactPoint", "start"))
            if there[0] not in by_id or there[1] not in _OTHER:
                raise RoadError(f"{place} is missing in the file, or where the two meet")
            for here, other in (((name, side), there), (there, (name, side))):
                if links.setdefault(here, other) != other:
                    raise RoadError(f"{place} is another one than the other road says")
    return links


def sections_of(road: Element) -> list[Element]:
    """The lane sections of a road, at least one.

    Raises:
        RoadError: there is none.
    """
    sections = road.findall("lanes/laneSection")
    if not sections:
        raise RoadError("its road has no lanes")
    return sections


def lane_ids(stretches: Sequence[Stretch], lane: int) -> list[list[int]]:
    """Ids of a lane in each section of each stretch, sections in the order of the file.

    The lane's own links are followed; where it has none, its id stays, with the other sign in a
    road that is driven the other way round.

    Args:
        stretches: in driving order.
        lane: its id where the chain starts, if the chain's first road is not backwards in it.

    Raises:
        RoadError: there is no such lane somewhere.
    """
    here = abs(lane) if stretches[0].backwards else -abs(lane)
    found = []
    for number, stretch in enumerate(stretches):
        sections = sections_of(stretch.road)
        forwards, onward = (1, "successor") if not stretch.backwards else (-1, "predecessor")
        ids = []
        for section in sections[::forwards]:
            ids.append(here)
            element = lane_of(section, here)
            link = element.find(f"link/{onward}")
            is_last = len(ids) == len(sections)
            following = stretches[number + 1 : number + 2] if is_last else [stretch]
            if following and following[0].backwards != stretch.backwards:
                here = -here
            if following and link is not None:
                here = _linked(link, following[0])
        found.append(ids[::forwards])
    return found


def _linked(link: Element, stretch: Stretch) -> int:
    text = link.get("id", "")
    try:
        lane = int(text[:9])
    except ValueError:
        lane = 0
    if lane == 0 or (lane > 0) != stretch.backwards:
        raise RoadError(
            f"a lane leads to lane {text!r:.40}, which is driven the other way or nowhere"
        )
    return lane


def lane_of(section: Element, lane: int) -> Element:
    """A section's lane with an id.

    Raises:
        RoadError: there is none, with the ids of those that can be driven.
    """
    side = "right" if lane < 0 else "left"
    for element in section.findall(f"{side}/lane"):
        if element.get("id") == str(lane):
            return element
    raise _unfit(f"its lane {lane}, {side} of the centre, is missing", section)


def driving_lane(section: Element, lane: int) -> Element:
    """A section's lane with an id, which is a driving lane for right-hand traffic.

    Raises:
        RoadError: there is none, or it is another kind of lane.
    """
    element = lane_of(section, lane)
    kind = element.get("type")
    if kind != "driving":
        side = "right" if lane < 0 else "left"
        raise _unfit(
            f"its lane {lane}, {side} of the centre, is of type {kind!r:.40}: a driving lane is"
            " needed there",
            section,
        )
    if element.get("direction", "standard") != "standard":
        raise RoadError(
            f"its lane {lane} is driven against the road's rule (direction): right-hand traffic is"
            " read"
        )
    return element


def _unfit(what: str, section: Element) -> RoadError:
    """The error of a lane, with the driving lanes that a section has."""
    lanes = [lane for side in ("right", "left") for lane in section.findall(f"{side}/lane")]
    ids = [lane.get("id", "")[:9] for lane in lanes if lane.get("type") == "driving"]
    if not ids:
        return RoadError(what)
    return LaneError(f"{what} (driving lanes, to be chosen as 'lane': {', '.join(ids[:8])})")
