"""The check of a campaign's database: the file, every row, and the number of results in its log."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from frenetic.campaign.configuration import fault_of
from frenetic.campaign.counts import Counts
from frenetic.campaign.database import DATABASE
from frenetic.campaign.log import results_in_log
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.warm_start import read_earlier
from frenetic.errors import CampaignError


@dataclass(frozen=True)
class CheckReport:
    """Contents of a campaign's database, and the findings about it."""

    folder: Path
    counts: Counts
    asked: int
    """Number of candidates."""
    trajectories: int
    size: int
    """Bytes on disk."""
    findings: tuple[str, ...]
    """Faults, each in a line."""


def check_campaign(folder: Path | str) -> CheckReport:
    """Check the campaign in a folder, without changing it.

    Raises:
        CampaignError: the folder holds no campaign, or one of another format, or one too damaged to
            be opened.
    """
    folder = Path(folder)
    with CampaignStore.open(folder) as store:
        findings = list(_findings(store))
        files = (folder / f"{DATABASE}{suffix}" for suffix in ("", "-wal"))
        size = sum(file.stat().st_size for file in files if file.is_file())
        counts, asked, trajectories = Counts(), 0, 0
        try:
            counts = store.counts()
            ((asked, trajectories),) = store.rows("SELECT count(*), count(trajectory) FROM test")
        except CampaignError as error:
            findings.append(str(error))
    return CheckReport(folder, counts, asked, trajectories, size, tuple(dict.fromkeys(findings)))


def _findings(store: CampaignStore) -> Iterator[str]:
    try:
        for (line,) in store.rows("PRAGMA integrity_check"):
            if line != "ok":
                yield f"SQLite says: {' '.join(line.split())}"
        if fault := fault_of(store.config):
            yield f"the configuration: {fault}"
        _ = store.facts
        for test in read_earlier(store):
            store.earlier_trajectory(test.id)
        for (number,) in store.rows("SELECT test FROM finding EXCEPT SELECT id FROM test"):
            yield f"there are findings of test {number}, which is missing"
        numbers = list(
            store.rows(
                "SELECT id, result_number FROM test"
                " ORDER BY result_number IS NULL, result_number, id"
            )
        )
    except CampaignError as error:
        yield str(error)
        return
    orders = [order for _, order in numbers if order is not None]
    count = len(orders)
    if orders != list(range(1, count + 1)):
        yield f"{count} results are stored, but not as numbers 1 to {count}: some are missing"
    if (logged := results_in_log(store.folder)) > count:
        yield (
            f"the log tells of {logged} results, the database holds {count}: the last ones are"
            f" lost; was {DATABASE} copied without {DATABASE}-wal?"
        )
    ids = sorted(number for number, _ in numbers)
    if ids != list(range(1, len(ids) + 1)):
        yield f"{len(ids)} candidates are there, but not those from 1 to {len(ids)}"
    for number, order in numbers:
        try:
            store.candidate(number) if order is None else store.test(number)
        except CampaignError as error:
            yield str(error)
