"""Side files of older versions with drives made again, read once into the database."""

from __future__ import annotations

import base64
import binascii
import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

from msgspec import convert
from msgspec.json import decode as decode_json

from frenetic.campaign.record import TEST_COLUMNS
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.trajectory_codec import decode
from frenetic.errors import CampaignError, FreneticError
from frenetic.outcome import Outcome
from frenetic.redrive.conditions import Variation, read_conditions
from frenetic.redrive.record import Purpose, Redrive, Run
from frenetic.simulators.drive import CarBody, Rules
from frenetic.simulators.worlds import USUAL

READ: Final = ".read"
"""Suffix of a file that has been read."""


@dataclass(frozen=True)
class SideFile:
    """A file in a campaign's folder that holds a list of items."""

    name: str
    key: str
    """Name of the list in the file's JSON object."""
    maker: str
    """The command that made it, and makes it again."""
    read_item: Callable[[Any, CampaignStore], Run]

    def read(self, store: CampaignStore) -> tuple[list[Run], str]:
        """Its contents and digest.

        Raises:
            CampaignError: it cannot be read, is damaged, or was written by a newer version.
        """
        path = store.folder / self.name
        try:
            data = path.read_bytes()
            document = decode_json(data)
        except OSError as error:
            raise CampaignError(f"{path} cannot be read: {error.strerror or error}") from None
        except (ValueError, RecursionError):
            raise self._damaged(store, "it is not JSON") from None
        version = document.get("version") if isinstance(document, dict) else None
        if isinstance(version, int) and version > _VERSION:
            raise CampaignError(
                f"{path} was written by a newer version of frenetic (form {version}, this one reads"
                f" {_VERSION}): upgrade frenetic"
            )
        try:
            if version != _VERSION:
                raise ValueError(f"its version is {version!r}")
            runs = [self.read_item(item, store) for item in document[self.key]]
        except (AttributeError, LookupError, TypeError, ValueError, OverflowError) as error:
            raise self._damaged(store, f"{type(error).__name__}: {error}") from None
        except FreneticError as error:
            raise self._damaged(store, str(error)) from None
        return runs, hashlib.sha256(data).hexdigest()

    def _damaged(self, store: CampaignStore, what: str) -> CampaignError:
        return CampaignError(
            f"{store.folder / self.name} is damaged ({what[:200]}): remove it, and let"
            f" '{self.maker}' make it again"
        )


_VERSION: Final = 1  # of the form of these files


def _rerun(item: Any, store: CampaignStore) -> Run:
    test_id = convert(item["test"], int)
    _repeat(item["recorded"])
    drives = [_repeat(drive) for drive in item["drives"]]
    variations = [Variation.read(one) for one in item["variations"]]
    recorded = store.test(test_id, with_trajectory=False)
    return Run(
        Purpose.ROBUSTNESS,
        dict(item["driver"]),
        dict(item["simulator"]),
        planned=len(drives),
        seed=convert(item["seed"], int),
        variations=tuple(variations),
        drives=tuple(Redrive(recorded, **drive) for drive in drives),
    )


def _repeat(item: Any) -> dict[str, Any]:
    trouble = convert(item["trouble"], str | None)
    conditions = read_conditions(item["world"])
    return {**_verdict(item), "conditions": conditions, "reason": trouble or ""}


def _confirmation(item: Any, store: CampaignStore) -> Run:
    simulator, driver = _described(item["simulator"]), _described(item["driver"])
    drives = [_confirmed(one, store) for one in item["tests"]]
    return Run(
        Purpose.CONFIRMATION,
        driver,
        simulator,
        convert(item["rules"], Rules),
        convert(item["car"], CarBody),
        planned=len(drives) + convert(item["missing"], int),
        drives=tuple(drives),
    )


def _confirmed(item: Any, store: CampaignStore) -> Redrive:
    packed = item["trajectory"]
    try:
        trajectory = None if packed is None else decode(base64.b64decode(packed, validate=True))
    except binascii.Error as error:
        raise ValueError(f"a trajectory is no base64: {error}") from None
    _verdict(item["recorded"])
    return Redrive(
        conditions=USUAL,
        **_verdict(item["other"]),
        reason=str(item["reason"]),
        trajectory=trajectory,
        recorded=store.test(convert(item["test"], int), with_trajectory=False),
    )


def _described(part: Any) -> dict[str, Any]:
    if not isinstance(part, dict) or not isinstance(part.get("class"), str):
        raise TypeError("a part without a class")
    return part


def _verdict(item: Any) -> dict[str, Any]:
    names = ("outcome", "moobd", "departure_distance", "departure_side")
    values = {name: TEST_COLUMNS[name].read(item[name]) for name in names}
    return {**values, "outcome": Outcome(values["outcome"])}


SIDE_FILES: Final[Mapping[Purpose, SideFile]] = MappingProxyType(
    {
        Purpose.ROBUSTNESS: SideFile("reruns.json", "reruns", "frenetic rerun", _rerun),
        Purpose.CONFIRMATION: SideFile(
            "confirmations.json", "confirmations", "frenetic confirm", _confirmation
        ),
    }
)
"""Purpose of driving again -> the file with its drives."""
