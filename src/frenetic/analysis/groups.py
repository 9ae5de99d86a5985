"""Groups of campaigns that repeat each other, and names for them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, Final

from msgspec import convert

from frenetic._support.files import require_list
from frenetic.campaign.database import DATABASE
from frenetic.campaign.objective import MOOBD
from frenetic.campaign.store import CampaignStore
from frenetic.conditions.condition import as_text as conditions_text
from frenetic.conditions.domain import Domain
from frenetic.criteria.criterion import CriteriaSet
from frenetic.errors import CampaignError
from frenetic.parts.registry import part_name
from frenetic.parts.versions import short_version
from frenetic.road import profile
from frenetic.road.classes import RoadClass
from frenetic.spec.part_record import part_text
from frenetic.spec.terms import Terms

PARTS: Final = (
    *("strategy", "driver", "simulator", "rules", "budget"),
    *(item.name for item in fields(Terms)),
    *("max_in_flight", "objective", "start_from", "behaviours"),
)
"""Parts of a configuration that are equal in repeats; the strategy's seed differs."""

_NAMED: Final[Mapping[str, Any]] = {
    "road_class": RoadClass,
    "domain": Domain,
    "criteria": CriteriaSet,
}
"""Part that a user names -> its class."""


def find_campaigns(place: Path | str) -> list[Path]:
    """Return the folders of the campaigns in the folder of a campaign, of several, or of a bench.

    Raises:
        CampaignError: the folder does not exist or holds no campaign.
    """
    place = Path(place)
    if (place / DATABASE).is_file():
        return [place]
    if not place.is_dir():
        raise CampaignError(
            f"{place} is no folder: the folder of a campaign, or of several, is needed"
        )
    try:
        for depth in ("*", "*/*"):
            if folders := sorted(file.parent for file in place.glob(f"{depth}/{DATABASE}")):
                return folders
    except OSError as error:
        raise CampaignError(f"cannot look into {place}: {error.strerror or error}") from None
    raise CampaignError(
        f"{place} holds no campaign: the folder of one, or a folder of several, is needed"
    )


def group_campaigns(folders: Iterable[Path | str]) -> dict[str, list[Path]]:
    """Group campaigns that differ only in the seed; return name of a group -> folders.

    A name consists of the groups' differences, most often the strategy.

    Raises:
        CampaignError: a campaign does not exist or is damaged.
        FreneticError: ``folders`` is a single folder rather than a list.
    """
    configurations: dict[str, dict[str, Any]] = {}
    members: dict[str, list[Path]] = {}
    for folder in require_list("folders", folders):
        parts = parts_of(folder)
        key = json.dumps(parts, sort_keys=True)
        configurations[key] = parts
        members.setdefault(key, []).append(Path(folder))
    names = _names(list(configurations.values()))
    return dict(zip(names, members.values(), strict=True))


def parts_of(folder: Path | str) -> dict[str, Any]:
    """Return the values of `PARTS`, which a campaign shares with its repeats.

    Raises:
        CampaignError: the campaign does not exist or is damaged.
    """
    with CampaignStore.open(folder) as store:
        config, facts, start_from = store.config, store.facts, _start_of(store)
    parts: dict[str, Any] = {name: config.get(name) for name in PARTS}
    parts["budget"] = facts.get("budget", parts["budget"])
    parts["objective"] = config.get("objective", MOOBD)
    parts["conditions"] = config.get("conditions") or None
    parts["start_from"] = start_from
    strategy = parts["strategy"]
    if isinstance(strategy, dict) and isinstance(strategy.get("options"), dict):
        options = {k: v for k, v in strategy["options"].items() if k != "seed"}
        parts["strategy"] = {**strategy, "options": options}
    return parts


def _start_of(store: CampaignStore) -> str | None:
    """Return a digest of the earlier tests that a campaign starts from; None without any."""
    columns = ", ".join(("outcome", "moobd", "step", "curvatures", *profile.NAMES, "trajectory"))
    select = f"SELECT {columns} FROM earlier_test ORDER BY id"  # noqa: S608
    rows = list(store.rows(select))
    return hashlib.sha256(repr(rows).encode()).hexdigest() if rows else None


def _names(configurations: list[dict[str, Any]]) -> list[str]:
    """Return a name for each configuration: its differences from the others, in short."""
    names = [""] * len(configurations)
    for part in PARTS:
        values = [configuration[part] for configuration in configurations]
        if len(set(names)) < len(names) and any(value != values[0] for value in values):
            names = [
                f"{name} {_word(part, value, values)}".strip()
                for name, value in zip(names, values, strict=True)
            ]
    # Differences without a short form are numbered.
    return [
        f"{name} {names[: i + 1].count(name)}".strip() if names.count(name) > 1 else name or "all"
        for i, name in enumerate(names)
    ]


def _word(part: str, value: Any, others: Sequence[Any]) -> str:
    """Return the value of a part in words, as opposed to other configurations."""
    if part == "start_from":
        return "warm-started" if value else "started afresh"
    if part in _NAMED:
        return _named_word(part, value, others)
    if part == "conditions":
        return f"with {conditions_text(value)}" if value else "in the usual conditions"
    if not isinstance(value, dict):
        return f"{part}={_text(value)}"
    if "class" not in value:
        return _settings(value, others)
    parts = [other for other in others if isinstance(other, dict) and "class" in other]
    named = [other for other in parts if part_name(other) == part_name(value)]
    alike = [other for other in named if other["class"] == value["class"]]
    options, inner = value.get("options"), value.get("driver")
    other_options = [other.get("options") for other in alike]
    settings = _settings(options, other_options, ",") if isinstance(options, dict) else ""
    word = part_name(value) if named == alike else str(value["class"])
    word += f",{settings}" if settings else ""
    version = _version(value)
    if any(_version(other) != version for other in alike):
        word += f" [{version}]"
    if isinstance(inner, dict):
        word += f" over {_word(part, inner, [other.get('driver') for other in alike])}"
    return word


def _named_word(part: str, value: Any, others: Sequence[Any]) -> str:
    """Return the name of a road class or domain, with its differences from others of that name."""
    if value is None:
        return "on the competition's roads" if part == "road_class" else "without a domain"
    alike = [other for other in others if other is not None and other["name"] == value["name"]]
    if part == "domain":
        differing = {
            name: amounts
            for name, amounts in value["conditions"].items()
            if any(other["conditions"].get(name) != amounts for other in alike)
        }
        name = str(value["name"])
        text = convert({"name": name, "conditions": differing}, Domain).as_text()
        return f"in {text if differing else name}"
    first, *rest = ({**entries, "sources": None} for entries in (value, *alike))
    settings = _settings(first, rest)
    return f"on {value['name']}{f'({settings})' if settings else ''}"


def _version(part: Mapping[str, Any]) -> str:
    return short_version(part) or "unknown version"


def _settings(value: Mapping[str, Any], others: Sequence[Any], between: str = ", ") -> str:
    """Return the settings that differ from the others' settings, in words."""
    texts = []
    for name, setting in value.items():
        other_settings = [other.get(name) if isinstance(other, dict) else None for other in others]
        if any(setting != other for other in other_settings):
            if isinstance(setting, dict):
                texts.append(_settings(setting, other_settings, between))
            else:
                texts.append(f"{name}={_text(setting)}")
    return between.join(texts)


def _text(value: object) -> str:
    """Return a setting as text, a number with at most six digits."""
    return f"{value:g}" if isinstance(value, float) else str(value)


def differing_parts(configurations: Sequence[Mapping[str, Any]]) -> str:
    """Return the names of the parts in which configurations differ, in a row."""
    first = configurations[0]
    return ", ".join(
        part.replace("_", " ")
        for part in PARTS
        if any(configuration[part] != first[part] for configuration in configurations)
    )


def shared_parts(configurations: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Return name -> value in words of the parts that are set and equal in all configurations."""
    first = configurations[0]
    return {
        part.replace("_", " "): _in_words(part, first[part])
        for part in PARTS
        if first[part] is not None
        and all(configuration[part] == first[part] for configuration in configurations)
    }


def _in_words(part: str, value: Any) -> str:
    if part in _NAMED:
        return str(convert(value, _NAMED[part]).as_text())
    if part == "conditions":
        return conditions_text(value)
    if not isinstance(value, Mapping):
        return _text(value)
    if "class" in value:
        return part_text(value)
    entries = {name: entry for name, entry in value.items() if entry is not None}
    return ", ".join(f"{name} {_in_words(name, entry)}" for name, entry in entries.items())
