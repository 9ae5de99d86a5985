"""The check of a campaign's database: the file, every row, and the number of results in its log."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from frenetic._support.arrays import evenly
from frenetic.campaign.configuration import fault_of
from frenetic.campaign.counts import Counts
from frenetic.campaign.database import DATABASE, select_trajectories
from frenetic.campaign.log import results_in_log
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.trajectory_codec import check_packed
from frenetic.campaign.warm_start import read_earlier
from frenetic.errors import CampaignError

_BATCH: Final = 500
"""Number of tests whose rows are read at once; our choice."""
MEASURED: Final = 500
"""Largest number of tests whose segments a check measures again, unless it is deep; our choice."""


@dataclass(frozen=True)
class CheckReport:
    """Contents of a campaign's database, and its faults."""

    folder: Path
    """The campaign's folder."""
    counts: Counts
    """Numbers of tests; all 0 if they cannot be read."""
    asked: int
    """Number of candidates."""
    trajectories: int
    """Number of stored trajectories."""
    size: int
    """Size of the database with its write-ahead log, in bytes."""
    findings: tuple[str, ...]
    """Faults, each in one line; empty if the campaign is sound."""


def check_campaign(folder: Path | str, *, is_deep: bool = False) -> CheckReport:
    """Check the campaign in a folder, without changing it.

    All rows are read, and all trajectories compared with their checksums. The trajectories of at
    most `MEASURED` tests, evenly over the campaign, are decoded, and the values of their segments
    are measured again.

    Args:
        folder: the campaign's folder.
        is_deep: whether all trajectories are decoded and measured, half a millisecond each.

    Raises:
        CampaignError: the folder holds no campaign, or one of another format, or one too damaged to
            be opened.
    """
    folder = Path(folder)
    with CampaignStore.open(folder) as store:
        findings = list(_findings(store, is_deep=is_deep))
        files = (folder / f"{DATABASE}{suffix}" for suffix in ("", "-wal"))
        size = sum(file.stat().st_size for file in files if file.is_file())
        counts, asked, trajectories = Counts(), 0, 0
        try:
            counts = store.counts()
            ((asked, trajectories),) = store.rows("SELECT count(*), count(trajectory) FROM test")
        except CampaignError as error:
            findings.append(str(error))
    return CheckReport(folder, counts, asked, trajectories, size, tuple(dict.fromkeys(findings)))


def _findings(store: CampaignStore, *, is_deep: bool) -> Iterator[str]:
    """Yield the faults of a campaign, each in one line."""
    try:
        for (line,) in store.rows("PRAGMA integrity_check"):
            if line != "ok":
                yield f"SQLite says: {' '.join(line.split())}"
        if fault := fault_of(store.config):
            yield f"the configuration: {fault}"
        _ = store.facts  # raises if a fact is damaged
        for test in read_earlier(store):
            store.earlier_trajectory(test.id)  # raises if the trajectory is damaged
        for table, name in (("finding", "findings"), ("segment", "values of the segment")):
            rows = store.rows(f"SELECT test FROM {table} EXCEPT SELECT id FROM test")  # noqa: S608
            for (test_id,) in rows:
                yield f"there are {name} of test {test_id}, which is missing"
        candidates = list(
            store.rows(
                "SELECT id, result_number FROM test"
                " ORDER BY result_number IS NULL, result_number, id"
            )
        )
    except CampaignError as error:  # the file is too damaged to look further
        yield str(error)
        return
    yield from _numbering_findings(store, candidates)
    tested = [test_id for test_id, result_number in candidates if result_number is not None]
    yield from _row_findings(store, tested)
    for test_id, result_number in candidates:
        if result_number is None:
            try:
                store.candidate(test_id)
            except CampaignError as error:
                yield str(error)
    yield from _segment_findings(store, tested if is_deep else _sample(tested))


def _row_findings(store: CampaignStore, tests: Sequence[int]) -> Iterator[str]:
    """Yield the faults of the rows of some tests.

    Trajectories are compared with their checksums, not decoded.
    """
    for start in range(0, len(tests), _BATCH):
        batch = tests[start : start + _BATCH]
        try:
            read_tests = store.tests_with_ids(batch)
        except CampaignError as error:
            if len(batch) == 1:
                yield str(error)
            else:
                for test_id in batch:
                    yield from _row_findings(store, [test_id])
            continue
        trajectories = dict(store.rows(select_trajectories(len(batch)), batch))
        for test in read_tests:
            packed = trajectories[test.id]
            if packed is None:
                if test.records is not None:
                    yield f"the trajectory of test {test.id} is gone"
                continue
            try:
                check_packed(packed, test.records)
            except CampaignError as error:
                yield f"the trajectory of test {test.id}: {error}"


def _sample(tests: Sequence[int]) -> list[int]:
    """Return at most `MEASURED` tests, evenly over the campaign."""
    return [tests[i] for i in evenly(len(tests), MEASURED)] if tests else []


def _segment_findings(store: CampaignStore, tests: Sequence[int]) -> Iterator[str]:
    """Yield which tests have other values of their segment than their trajectory gives."""
    for test_id in tests:
        try:
            (test,) = store.tests_with_ids([test_id], with_trajectory=True)
        except CampaignError:  # a fault of its rows, which is a finding already
            continue
        stored, measured = test.stored_values, test.measure()
        if measured is None and stored is None:
            continue
        if measured is None or stored is None:
            problem = "are missing" if stored is None else "do not belong to its drive"
        elif differing := stored.differences(measured):
            problem = f"differ from what its trajectory gives: {', '.join(differing)}"
        else:
            continue
        yield f"the values of the segment of test {test_id} {problem}"


def _numbering_findings(
    store: CampaignStore, candidates: Sequence[tuple[int, int | None]]
) -> Iterator[str]:
    """Yield what is wrong with the numbers of a campaign's results and candidates.

    Args:
        store: the campaign.
        candidates: id and result number of each candidate, in the order of results; the result
            number is None for a candidate without a result.
    """
    result_numbers = [number for _, number in candidates if number is not None]
    count = len(result_numbers)
    if result_numbers != list(range(1, count + 1)):
        yield f"{count} results are stored, but not as numbers 1 to {count}: some are missing"
    if (logged := results_in_log(store.folder)) > count:
        yield (
            f"the log tells of {logged} results, the database holds {count}: the last ones are"
            f" lost; was {DATABASE} copied without {DATABASE}-wal?"
        )
    ids = sorted(test_id for test_id, _ in candidates)
    if ids != list(range(1, len(ids) + 1)):
        yield f"{len(ids)} candidates are there, but not those from 1 to {len(ids)}"
