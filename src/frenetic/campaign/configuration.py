"""A campaign's configuration: its parts, terms and budget, as its database stores them."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, Final

from msgspec import Meta, Struct, ValidationError, convert, defstruct, to_builtins

from frenetic._support.bounds import Count, Positive
from frenetic._support.json_value import JSONValue
from frenetic._support.words import counted
from frenetic.errors import CampaignError, FreneticError
from frenetic.spec import Budget, Spec
from frenetic.spec.terms import DriveSetting

SPEC: Final = "spec"
"""Name of the entry with the spec; a campaign of objects from Python has no such entry."""
OWNER: Final = "owner"
"""Name of the entry with the `Owner` of a campaign that is no search."""


class Owner(Struct, frozen=True, kw_only=True):
    """The command that owns a campaign, such as a bench: only this command resumes the campaign."""

    summary: str
    """What the campaign is, to follow its folder's name: "does not search"."""
    advice: str
    """How to resume the campaign, for people."""
    resume: tuple[str, ...] = ()
    """Words of the command that resumes the campaign, between `frenetic` and the owner's folder;
    empty if no command can."""
    levels_up: Annotated[int, Meta(ge=0, le=8)] = 0
    """Number of folders from the campaign's folder up to the owner's folder."""
    time_budget: Positive | None = None
    """Time that the owner grants, in s of the owner's clock; None if the campaign's budget limits
    the time."""

    def entry(self) -> dict[str, JSONValue]:
        """Return the owner as an entry of the campaign's configuration."""
        owner: JSONValue = to_builtins(self)
        return {OWNER: owner}

    def command(self, folder: Path) -> str:
        """Return the command that resumes the campaign in a folder; without one, the advice."""
        if not self.resume:
            return self.advice
        for _ in range(self.levels_up):
            folder = folder.parent
        return shlex.join(["frenetic", *self.resume, str(folder)])


def owner_of(config: Mapping[str, Any]) -> Owner | None:
    """Return the owner of a campaign; None for a campaign without an owner, such as a search.

    Raises:
        CampaignError: the entry is no owner.
    """
    try:
        return convert(config.get(OWNER), Owner | None)
    except ValidationError as error:
        raise CampaignError(f"the campaign is damaged: its owner: {error}") from None


@dataclass(frozen=True)
class EarlierCampaign:
    """An earlier campaign that a search starts from."""

    folder: str
    """Path of the campaign's folder, as the user wrote it."""
    simulations: int = 0
    """Number of the campaign's drives."""
    failures: int = 0
    """Number of the campaign's failures."""
    taken: int = 0
    """Number of tests that were taken from the campaign."""
    left_out: int = 0
    """Number of roads that do not fit the map or the strategy's step."""

    def __str__(self) -> str:
        left_out = f", {self.left_out} left out that do not fit" if self.left_out else ""
        return (
            f"{self.folder} ({counted(self.simulations, 'simulation')},"
            f" {counted(self.failures, 'failure')}): {counted(self.taken, 'road')} taken{left_out}"
        )


class _PartRecord(Struct, forbid_unknown_fields=True, rename={"kind": "class"}):
    """The record of a part, which `frenetic.spec.part_record.describe` returns."""

    kind: str
    """Class of the part, by the key "class"."""
    options: dict[str, Any] = {}
    version: str = ""
    camera: dict[str, Any] | None = None
    driver: _PartRecord | None = None


_ENTRIES: Final[list[Any]] = [
    ("seed", int | float | str | bool | None),
    ("strategy", _PartRecord),
    ("simulator", _PartRecord),
    ("driver", _PartRecord),
    ("budget", Budget),
    ("workers", Count | str, 1),
    ("max_in_flight", Count | None, None),
    ("objective", str, "moobd"),
    ("start_from", tuple[EarlierCampaign, ...], ()),
    ("from_roads", str | None, None),
    ("versions", dict[str, str]),
    ("behaviours", dict[str, str], {}),
    (SPEC, Spec | None, None),
    (OWNER, Owner | None, None),
]
"""Entries of a configuration: name, type and, for entries that may be missing, the default."""
_Configuration: Any = defstruct("Configuration", _ENTRIES, kw_only=True)


def _read(config: Mapping[str, Any]) -> tuple[Spec | None, DriveSetting]:
    """Return the spec and the setting of a configuration, after a check of all its entries.

    Raises:
        ValueError: an entry is missing or wrong; the message names the entry.
    """
    try:
        spec, setting = convert(dict(config), _Configuration).spec, DriveSetting.of(config)
    except ValidationError as error:
        raise ValueError(str(error)) from None
    except FreneticError as error:  # of the spec; its message does not name the entry
        raise ValueError(f"{error} - at `$.{SPEC}`") from None
    for name in ("rules", "car"):  # their classes would fill in defaults for missing values
        if wrong_keys := config[name].keys() ^ asdict(getattr(setting, name)).keys():
            raise ValueError(f"Missing or unknown {', '.join(sorted(wrong_keys))} - at `$.{name}`")
    return spec, setting


def fault_of(config: Mapping[str, Any]) -> str:
    """Return why a campaign's configuration cannot be read, in one line; empty if it can."""
    try:
        _read(config)
    except ValueError as error:
        return str(error)
    return ""


def recorded_spec(config: Mapping[str, Any], *, source: object) -> Spec:
    """Return the spec of a campaign.

    For a campaign of objects from Python the spec holds roads and conditions alone.

    Args:
        config: configuration of the campaign.
        source: name of the campaign's file for messages.

    Raises:
        CampaignError: the configuration is damaged; the message names the entry.
    """
    try:
        spec, setting = _read(config)
    except ValueError as error:
        raise CampaignError(
            f"{source} is damaged: it does not say with what it was driven: {error}; restore it"
            " from a copy"
        ) from None
    return spec or Spec.of_terms(setting)


def earlier_of(config: Mapping[str, Any]) -> tuple[EarlierCampaign, ...]:
    """Return the earlier campaigns from which a campaign started, by its configuration.

    Raises:
        CampaignError: the entry is damaged.
    """
    try:
        return convert(config.get("start_from", []), tuple[EarlierCampaign, ...])
    except ValidationError as error:
        raise CampaignError(f"the campaign is damaged: what it starts from: {error}") from None


def decode_budget(value: Any) -> Budget:
    """Return the budget in a value of JSON.

    Raises:
        ValueError: the value is no budget.
    """
    try:
        return convert(value, Budget)
    except ValidationError as error:
        raise ValueError(str(error)) from None


def driving_spec(config: Mapping[str, Any], *, source: object) -> Spec | None:
    """Return the spec of a campaign's drives; None if Python started it without names.

    Args:
        config: configuration of the campaign.
        source: name of the campaign's file for messages.

    Raises:
        CampaignError: the configuration is damaged.
    """
    if config.get(SPEC) is None:
        return None
    return recorded_spec(config, source=source).driving_spec()
