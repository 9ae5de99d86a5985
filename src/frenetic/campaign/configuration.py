"""A campaign's configuration: its parts, terms and budget, as its database keeps them."""

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
"""Entry with the spec of named parts; a campaign of objects from Python has none."""
OWNER: Final = "owner"
"""Entry with the `Owner` of a campaign that another command than a search drives."""


class Owner(Struct, frozen=True, kw_only=True):
    """The command that owns a campaign, such as a bench: it alone goes on with the campaign."""

    summary: str
    """What the campaign is, after its folder's name: "does not search"."""
    advice: str
    """How to go on with the campaign, for people."""
    resume: tuple[str, ...] = ()
    """Words after `frenetic` that go on, before the owner's folder; empty where none are known."""
    levels_up: Annotated[int, Meta(ge=0, le=8)] = 0
    """Number of folders from the campaign's up to the owner's."""
    time_budget: Positive | None = None
    """Time that the owner grants, in s of its own clock, where it is not the campaign's budget."""

    def entry(self) -> dict[str, JSONValue]:
        """Return the entry of the campaign's configuration."""
        owner: JSONValue = to_builtins(self)
        return {OWNER: owner}

    def command(self, folder: Path) -> str:
        """Return the command that goes on with the campaign in a folder, or else the advice."""
        if not self.resume:
            return self.advice
        for _ in range(self.levels_up):
            folder = folder.parent
        return shlex.join(["frenetic", *self.resume, str(folder)])


def owner_of(config: Mapping[str, Any]) -> Owner | None:
    """Return the owner of a campaign; None if it belongs to nobody, such as a search.

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
    """Path of its folder, as the user wrote it."""
    simulations: int = 0
    """Number of its drives."""
    failures: int = 0
    """Number of its failures."""
    taken: int = 0
    """Number of tests that were taken from it."""
    left_out: int = 0
    """Number of roads that do not fit the map or the strategy's step."""

    def __str__(self) -> str:
        left_out = f", {self.left_out} left out that do not fit" if self.left_out else ""
        return (
            f"{self.folder} ({counted(self.simulations, 'simulation')},"
            f" {counted(self.failures, 'failure')}): {counted(self.taken, 'road')} taken{left_out}"
        )


class _Described(Struct, forbid_unknown_fields=True, rename={"kind": "class"}):
    """A part in the form of `frenetic.spec.part_record.describe`."""

    kind: str
    options: dict[str, Any] = {}
    version: str = ""
    camera: dict[str, Any] | None = None
    driver: _Described | None = None


_ENTRIES: Final[list[Any]] = [
    ("seed", int | float | str | bool | None),
    ("strategy", _Described),
    ("simulator", _Described),
    ("driver", _Described),
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
_Configuration: Any = defstruct("Configuration", _ENTRIES, kw_only=True)


def _read(config: Mapping[str, Any]) -> tuple[Spec | None, DriveSetting]:
    """Return the spec and the setting of a configuration, whose rules and car have to be whole.

    Raises:
        ValueError: an entry is missing or wrong; the message names it.
    """
    try:
        spec, setting = convert(dict(config), _Configuration).spec, DriveSetting.of(config)
    except ValidationError as error:
        raise ValueError(str(error)) from None
    except FreneticError as error:  # which names no place
        raise ValueError(f"{error} - at `$.{SPEC}`") from None
    for name in ("rules", "car"):
        if other := config[name].keys() ^ asdict(getattr(setting, name)).keys():
            raise ValueError(f"Missing or unknown {', '.join(sorted(other))} - at `$.{name}`")
    return spec, setting


def fault_of(config: Mapping[str, Any]) -> str:
    """Return why a campaign's configuration cannot be read, in a line; empty if it can."""
    try:
        _read(config)
    except ValueError as error:
        return str(error)
    return ""


def recorded_spec(config: Mapping[str, Any], *, source: object) -> Spec:
    """Return the spec of a campaign; for one of objects from Python, roads and conditions alone.

    Args:
        config: its configuration.
        source: name of its file for messages.

    Raises:
        CampaignError: the configuration is damaged; the message names the place in it.
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
    """Return the earlier campaigns in a configuration.

    Raises:
        CampaignError: the entry is damaged.
    """
    try:
        return convert(config.get("start_from", []), tuple[EarlierCampaign, ...])
    except ValidationError as error:
        raise CampaignError(f"the campaign is damaged: what it starts from: {error}") from None


def decode_budget(value: Any) -> Budget:
    """Return the budget of a JSON object.

    Raises:
        ValueError: the object is no budget.
    """
    try:
        return convert(value, Budget)
    except ValidationError as error:
        raise ValueError(str(error)) from None


def driving_spec(config: Mapping[str, Any], *, source: object) -> Spec | None:
    """Return the spec of a campaign's drives; None if Python started it without names.

    Args:
        config: its configuration.
        source: name of its file for messages.

    Raises:
        CampaignError: the configuration is damaged.
    """
    if config.get(SPEC) is None:
        return None
    return recorded_spec(config, source=source).driving_spec()
