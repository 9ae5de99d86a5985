"""Minimised roads in a campaign's folder, and the drives on them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from frenetic.campaign import CampaignStore, Test
from frenetic.campaign.record import file_stem
from frenetic.errors import FreneticError
from frenetic.rerun.campaigns import FOLDER
from frenetic.road.files import read_road

MINIMISED: Final = "minimised"
"""Name of the folder for minimised roads in a campaign's folder."""
_ROAD_FILE: Final = re.compile(r"test-(\d+)\.json")


def minimised_road(folder: Path, test_id: int) -> Path:
    """Return the path of the file of a test's road, minimised with the campaign's own parts."""
    return folder / MINIMISED / f"{file_stem(test_id)}.json"


def minimised_tests(folder: Path) -> list[int]:
    """Return the ids of the tests whose minimised road has a file, in ascending order."""
    names = (path.name for path in (folder / MINIMISED).glob("test-*.json"))
    return sorted(int(match[1]) for match in map(_ROAD_FILE.fullmatch, names) if match)


def minimised_drives(store: CampaignStore, test_ids: Iterable[int]) -> dict[int, Test]:
    """Return id of a test -> drive on its minimised road, for the tests that were minimised.

    A file that is missing, damaged or not Frenetic's is left out.
    """
    drives = {}
    for test_id in test_ids:
        path = minimised_road(store.folder, test_id)
        if not path.is_file():
            continue
        try:
            record = read_road(path).entries["minimised"]
            folder, number = record["campaign"], record["test"]
            if not str(folder).isalnum():  # a path could lead out of the campaign's folder
                continue
            with CampaignStore.open(store.folder / FOLDER / folder) as campaign:
                drives[test_id] = campaign.test(number)
        except (
            FreneticError,
            OSError,
            LookupError,
            TypeError,
            ValueError,
        ):  # damaged or not Frenetic's
            continue
    return drives
