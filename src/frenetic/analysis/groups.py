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
from frenetic.parts.records import part_name, short_version
from frenetic.road import profile
from frenetic.road.classes import RoadClass
from frenetic.spec.part_text import part_text
from frenetic.spec.terms import Terms

PARTS: Final = (
    *("strategy", "driver", "simulator", "rules", "budget"),
    *(item.name for item in fields(Terms)),
    *("max_in_flight", "objective", "start_from", "behaviours"),
)
"""Parts of a campaign's configuration that its repeats share; only the strategy's seed differs."""

_NAMED_PARTS: Final[Mapping[str, Any]] = {
    "road_class": RoadClass,
    "domain": Domain,
    "criteria": CriteriaSet,
}
"""Part that has a name of its own -> its class."""


def find_campaigns(folder: Path | str) -> list[Path]:
    """Return the campaigns in a folder: itself, or those one or two levels below it.

    Args:
        folder: folder of a campaign, of several campaigns, or of a bench.

    Raises:
        CampaignError: the folder does not exist or holds no campaign.
    """
    folder = Path(folder)
    if (folder / DATABASE).is_file():
        return [folder]
    if not folder.is_dir():
        raise CampaignError(
            f"{folder} is no folder: the folder of a campaign, or of several, is needed"
        )
    try:
        for depth in ("*", "*/*"):
            if campaigns := sorted(file.parent for file in folder.glob(f"{depth}/{DATABASE}")):
                return campaigns
    except OSError as error:
        raise CampaignError(f"cannot look into {folder}: {error.strerror or error}") from None
    raise CampaignError(
        f"{folder} holds no campaign: the folder of one, or a folder of several, is needed"
    )


def group_campaigns(folders: Iterable[Path | str]) -> dict[str, list[Path]]:
    """Group campaigns that differ only in the seed; return name of a group -> folders.

    The name of a group says in what it differs from the others, most often the strategy.

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
        config, facts, start_from = store.config, store.facts, _start_digest(store)
    parts: dict[str, Any] = {name: config.get(name) for name in PARTS}
    # The facts hold the budget of a resumed campaign, which replaces the first one.
    parts["budget"] = facts.get("budget", parts["budget"])
    parts["objective"] = config.get("objective", MOOBD)
    parts["conditions"] = config.get("conditions") or None
    parts["start_from"] = start_from
    strategy = parts["strategy"]
    if isinstance(strategy, dict) and isinstance(strategy.get("options"), dict):
        options = {name: value for name, value in strategy["options"].items() if name != "seed"}
        parts["strategy"] = {**strategy, "options": options}
    return parts


def _start_digest(store: CampaignStore) -> str | None:
    """Return a digest of the earlier tests from which a campaign starts; None without such tests.

    Equal tests have equal digests.
    """
    columns = ", ".join(("outcome", "moobd", "step", "curvatures", *profile.NAMES, "trajectory"))
    select = f"SELECT {columns} FROM earlier_test ORDER BY id"  # noqa: S608
    rows = list(store.rows(select))
    return hashlib.sha256(repr(rows).encode()).hexdigest() if rows else None


def _names(configurations: list[dict[str, Any]]) -> list[str]:
    """Return a name for each configuration: its differences from the others, in short."""
    names = [""] * len(configurations)
    for part in PARTS:
        values = [configuration[part] for configuration in configurations]
        has_equal_names = len(set(names)) < len(names)
        if has_equal_names and any(value != values[0] for value in values):
            names = [
                f"{name} {_name_of_value(part, value, values)}".strip()
                for name, value in zip(names, values, strict=True)
            ]
    # Names that are still equal get numbers.
    return [
        f"{name} {names[: i + 1].count(name)}".strip() if names.count(name) > 1 else name or "all"
        for i, name in enumerate(names)
    ]


def _name_of_value(part: str, value: Any, others: Sequence[Any]) -> str:
    """Return a name for the value of a part that tells it apart from other configurations' values.

    Args:
        part: one of `PARTS`.
        value: value of the part.
        others: values of the part in all configurations.
    """
    if part == "start_from":
        return "warm-started" if value else "started afresh"
    if part in _NAMED_PARTS:
        return _name_of_named_part(part, value, others)
    if part == "conditions":
        return f"with {conditions_text(value)}" if value else "in the usual conditions"
    if not isinstance(value, dict):
        return f"{part}={_setting_text(value)}"
    if "class" not in value:
        return _differing_settings(value, others)
    return _name_of_object(part, value, others)


def _name_of_object(part: str, value: Mapping[str, Any], others: Sequence[Any]) -> str:
    """Return a name for a driver, a simulator or a strategy that tells it apart from others."""
    objects = [other for other in others if isinstance(other, dict) and "class" in other]
    same_name = [other for other in objects if part_name(other) == part_name(value)]
    same_class = [other for other in same_name if other["class"] == value["class"]]
    name = part_name(value) if same_name == same_class else str(value["class"])
    options = value.get("options")
    if isinstance(options, dict):
        other_options = [other.get("options") for other in same_class]
        if settings := _differing_settings(options, other_options, separator=","):
            name += f",{settings}"
    version = _version(value)
    if any(_version(other) != version for other in same_class):
        name += f" [{version}]"
    wrapped = value.get("driver")
    if isinstance(wrapped, dict):
        other_wrapped = [other.get("driver") for other in same_class]
        name += f" over {_name_of_value(part, wrapped, other_wrapped)}"
    return name


def _name_of_named_part(part: str, value: Any, others: Sequence[Any]) -> str:
    """Return the name of a road class, a domain or criteria, with differences from namesakes."""
    if value is None:
        return "on the competition's roads" if part == "road_class" else "without a domain"
    namesakes = [other for other in others if other is not None and other["name"] == value["name"]]
    if part == "domain":
        differing = {
            name: amounts
            for name, amounts in value["conditions"].items()
            if any(other["conditions"].get(name) != amounts for other in namesakes)
        }
        name = str(value["name"])
        text = convert({"name": name, "conditions": differing}, Domain).as_text()
        return f"in {text if differing else name}"
    # Sources of values make no difference.
    first, *rest = ({**entries, "sources": None} for entries in (value, *namesakes))
    settings = _differing_settings(first, rest)
    return f"on {value['name']}{f'({settings})' if settings else ''}"


def _version(part: Mapping[str, Any]) -> str:
    """Return the version of a part's code in short."""
    return short_version(part) or "unknown version"


def _differing_settings(
    value: Mapping[str, Any], others: Sequence[Any], separator: str = ", "
) -> str:
    """Return the settings that differ from the others' settings, such as ``aggression=1.2``."""
    texts = []
    for name, setting in value.items():
        other_settings = [other.get(name) if isinstance(other, dict) else None for other in others]
        if any(setting != other for other in other_settings):
            if isinstance(setting, dict):
                texts.append(_differing_settings(setting, other_settings, separator))
            else:
                texts.append(f"{name}={_setting_text(setting)}")
    return separator.join(texts)


def _setting_text(value: object) -> str:
    """Return a setting as text, a number with at most six digits."""
    return f"{value:g}" if isinstance(value, float) else str(value)


def differing_parts(configurations: Sequence[Mapping[str, Any]]) -> str:
    """Return the names of the parts in which configurations differ, separated by commas."""
    first = configurations[0]
    return ", ".join(
        part.replace("_", " ")
        for part in PARTS
        if any(configuration[part] != first[part] for configuration in configurations)
    )


def shared_parts(configurations: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Return the parts that are set and equal in all configurations: name -> value as text."""
    first = configurations[0]
    return {
        part.replace("_", " "): _part_value_text(part, first[part])
        for part in PARTS
        if first[part] is not None
        and all(configuration[part] == first[part] for configuration in configurations)
    }


def _part_value_text(part: str, value: Any) -> str:
    """Return the value of a part as text."""
    if part in _NAMED_PARTS:
        return str(convert(value, _NAMED_PARTS[part]).as_text())
    if part == "conditions":
        return conditions_text(value)
    if not isinstance(value, Mapping):
        return _setting_text(value)
    if "class" in value:
        return part_text(value)
    entries = {name: entry for name, entry in value.items() if entry is not None}
    return ", ".join(f"{name} {_part_value_text(name, entry)}" for name, entry in entries.items())
