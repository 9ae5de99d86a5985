"""Changes of a campaign's parts since it was made."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from frenetic._support.json_value import JSONValue
from frenetic.fingerprint import Differences, differences, other_version
from frenetic.spec import describe

PARTS: Final = ("strategy", "driver", "simulator")
_TERMS: Final = "fingerprints"


def version_notes(recorded: Mapping[str, JSONValue], **parts: object) -> list[str]:
    """Which parts are other versions of those in a configuration, each in words.

    Args:
        recorded: the configuration.
        parts: kind -> object: ``simulator``, ``driver``.
    """
    notes = [other_version(kind, recorded.get(kind), describe(one)) for kind, one in parts.items()]
    return [note for note in notes if note]


def changed_parts(
    recorded: Mapping[str, JSONValue], ours: Mapping[str, JSONValue]
) -> dict[str, Differences]:
    """Name of a part of a configuration -> how ours differs from the recorded one."""
    found = {kind: differences(kind, recorded.get(kind), ours.get(kind)) for kind in PARTS}
    theirs, mine = (
        one if isinstance(one, Mapping) else {} for one in (recorded.get(_TERMS), ours.get(_TERMS))
    )
    terms = [differences(name, theirs.get(name), mine[name]) for name in mine]
    found[_TERMS] = Differences(
        tuple(text for one in terms for text in one.changed),
        tuple(text for one in terms for text in one.unknown),
    )
    return found
