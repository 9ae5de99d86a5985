"""Changes of a campaign's parts that were accepted when it was resumed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from frenetic._support.json_value import JSONValue
from frenetic.fingerprint import Differences, differences, other_version
from frenetic.spec import describe, read_part

CHANGES: Final = "changes"
"""Name of the fact with the accepted changes."""
PARTS: Final = ("strategy", "driver", "simulator")
_TERMS: Final = "fingerprints"


@dataclass(frozen=True)
class PartChange:
    """A change of parts, from a test on."""

    first: int
    """Number of telling of the first test with the changed parts."""
    at: str
    """When it was accepted, UTC, ISO 8601."""
    what: tuple[str, ...]
    """What changed, each in a few words; empty if only fingerprints were added to a campaign of an
    older version."""
    parts: Mapping[str, Any]
    """Name of a part -> its description from then on."""

    @classmethod
    def read(cls, value: Any) -> PartChange:
        """A change from JSON.

        Raises:
            ValueError: it is none; the message follows "is ..:".
        """
        fault = ValueError("a list of changes with first, at, what and parts is needed")
        if not isinstance(value, Mapping):
            raise fault
        first, at, what, parts = (value.get(name) for name in ("first", "at", "what", "parts"))
        if type(first) is not int or first < 1 or not isinstance(at, str):
            raise fault
        if not isinstance(what, list) or not all(isinstance(text, str) for text in what):
            raise fault
        if not isinstance(parts, Mapping) or not set(parts) <= {*PARTS, _TERMS}:
            raise fault
        return cls(first, at, tuple(what), {k: read_part(k, v) for k, v in parts.items()})

    def to_json(self) -> dict[str, JSONValue]:
        """The change in the campaign's facts."""
        return {
            "first": self.first,
            "at": self.at,
            "what": list(self.what),
            "parts": dict(self.parts),
        }

    def __str__(self) -> str:
        return f"from result {self.first} on: {'; '.join(self.what)}"


def read_changes(value: object) -> tuple[PartChange, ...]:
    """The changes in a campaign's fact, in order; none if it is None.

    Raises:
        ValueError: it is damaged.
    """
    if value is None:
        return ()
    if not isinstance(value, Sequence) or isinstance(value, str):
        raise ValueError("a list of changes is needed")
    return tuple(map(PartChange.read, value))


def present_parts(
    config: Mapping[str, JSONValue], changes: Sequence[PartChange]
) -> dict[str, JSONValue]:
    """A campaign's configuration with the parts that it was resumed with last."""
    parts = dict(config)
    for change in changes:
        parts |= change.parts
    return parts


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
