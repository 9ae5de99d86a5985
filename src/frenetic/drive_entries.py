"""How roads are driven, in the words of a command line: entries of files of runs and roads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct, convert, field

from frenetic._support.bounds import Finite, Positive, Share
from frenetic._support.words import read_part
from frenetic.criteria import Profile
from frenetic.description import PARTS

if TYPE_CHECKING:
    from frenetic.domain import Domain
    from frenetic.road.classes import RoadClass

COMPETITION: Final = "competition"
"""Name of the roads that keep the competition's rules alone, in place of a road class."""


class DriveEntries(Struct, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """How a file says that roads are driven; what is left out is as for the command line."""

    driver: str | None = None
    """A part with its options, such as ``"planner,aggression=1.2"``, as on the command line."""
    simulator: str | None = None
    conditions: dict[str, Finite] = field(name="with", default_factory=dict)
    speed_limit: Positive | None = None
    oob_tolerance: Share | None = None
    criteria: str | dict[str, Any] | None = None
    """Criteria as on the command line, or a file's entries with a ``name``."""
    wall_limit: Positive | None = None
    """s of wall time that a drive may take; a worker is replaced after 1.5 times that and 10 s."""
    roads: str | dict[str, Any] | None = None
    """A road class as on the command line, or its values."""
    map_size: Positive | None = None
    objective: str | None = None

    def rules(self) -> dict[str, Any]:
        """Its rules, as `read_rules` gives them."""
        own = {"speed_limit": self.speed_limit, "oob_tolerance": self.oob_tolerance}
        return own if self.criteria is None else {**own, **read_rules(self.criteria)}

    def given(self) -> dict[str, Any]:
        """Its values by the names of options, as `frenetic.spec.Spec.replaced` takes them.

        Raises:
            ValueError: a part, class or criterion is none.
            FreneticError: there is no such class, or there are no such criteria.
        """
        given: dict[str, Any] = {
            "layers": self.conditions,
            **self.rules(),
            "wall_limit": self.wall_limit,
            "map_size": self.map_size,
            "road_class": None if self.roads is None else read_class(self.roads),
        }
        for kind in PARTS:
            if isinstance(text := getattr(self, kind, None), str):
                name, options = read_part(text)
                given |= {kind: name, f"{kind}_options": options}
        return given


def read_class(roads: str | Mapping[str, Any]) -> RoadClass | str:
    """The road class of a text such as ``rural-80,length=1500``, or of its values.

    Returns:
        `COMPETITION` for the competition's roads, which have no class.

    Raises:
        ValueError: the text or the values are wrong.
        FreneticError: there is no such class.
    """
    from frenetic.road.classes import class_of  # numba takes its time

    return class_of(roads) or COMPETITION


def read_rules(text: str | Mapping[str, Any]) -> dict[str, Any]:
    """The rules of a text such as ``after-iso-11270,lateral_jerk=4,speed_limit=60``, or of entries.

    Returns:
        Field of `frenetic.drive.Rules` -> its value. A text that says numbers alone has no
        ``criteria``.

    Raises:
        ValueError: they are wrong.
        FreneticError: there are no such criteria.
    """
    if isinstance(text, str):
        name, options = read_part(text)
    else:
        name, options = str(text.get("name", "own")), {k: text[k] for k in text if k != "name"}
    found: dict[str, Any] = {}
    for key in ("speed_limit", "oob_tolerance"):
        if key in options:
            found[key] = convert(options.pop(key), float)
    if not isinstance(text, str):
        return {**found, "criteria": Profile.made(str(name), options)}
    if name is None and not options:
        return found
    return {**found, "criteria": Profile.of(name or COMPETITION, options)}


def read_domain(odd: str | Mapping[str, Any]) -> Domain:
    """The domain of a file, or of entries.

    Raises:
        ValueError: they are wrong.
        FreneticError: there is no such file, or it is wrong.
    """
    from frenetic.domain import Domain  # numba takes its time

    if not isinstance(odd, str):
        return Domain.made(str(odd.get("name", "own")), odd)
    return Domain.of(odd)
