"""The check of a campaign's database: the file, every row, and every verdict judged again."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from frenetic.campaign.asktell import WORKER
from frenetic.campaign.counts import Counts
from frenetic.campaign.database import DATABASE
from frenetic.campaign.log import told_in_log
from frenetic.campaign.record import Setting, Test
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.tester import fitted
from frenetic.criteria import Criterion, Profile, quantity
from frenetic.drive import Drive, Rules
from frenetic.errors import CampaignError, RoadError
from frenetic.oracle import Result, judge
from frenetic.outcome import Outcome
from frenetic.spec import fault_of
from frenetic.versions import changed_packages

# Verdicts
#
# A stored trajectory is rounded, see `frenetic.campaign.trajectory_codec`, so its numbers differ a
# little from those of the drive. Rarely, this moves a record across the limit of a rule, and the
# drive ends a record earlier or later, or not at all. So a differing verdict is given again with
# every limit a little tighter and a little looser; the stored one must be among these.

MOOBD_TOLERANCE: Final = 1e-4
"""Largest difference of MOOBD, in m.

x and y are stored to within 0.05 mm each, which moves a car by at most 0.071 mm.
"""
SHARE_TOLERANCE: Final = 2e-4
"""Largest difference of oob shares: a point of the car's box moves by less than 0.1 mm."""
CRITERIA_TOLERANCE: Final = 0.03
"""Share of a quantity's scale, as derivatives of rounded records differ by more than these."""
TIME_TOLERANCE: Final = 1e-4
"""Largest difference of times, in s; they are stored to within 0.05 ms."""
DISTANCE_TOLERANCE: Final = 1e-3
"""Largest difference along the road, in m: inside a bend a place moves further than the car."""

_TOLERANCES: Final = (MOOBD_TOLERANCE, SHARE_TOLERANCE, TIME_TOLERANCE, DISTANCE_TOLERANCE)


@dataclass(frozen=True)
class CheckReport:
    """Contents of a campaign's database, and the findings about it."""

    folder: Path
    created_at: str
    """Time of its creation, UTC, ISO 8601; empty if unknown."""
    counts: Counts
    asked: int
    """Number of candidates."""
    trajectories: int
    size: int
    """Bytes on disk."""
    versions: Mapping[str, str]
    """Versions of Python and the packages with which it was made."""
    findings: tuple[str, ...]
    """What is wrong, each in a line."""

    @property
    def is_sound(self) -> bool:
        """Whether there are no findings."""
        return not self.findings

    @property
    def outstanding(self) -> int:
        """Number of candidates asked and not told."""
        return self.asked - self.counts.told


def check_campaign(
    folder: Path | str,
    *,
    quick: bool = False,
    on_test: Callable[[int, int], None] | None = None,
) -> CheckReport:
    """Checks the campaign in a folder, without changing it.

    Args:
        folder: of the campaign.
        quick: do not judge the stored drives and refused roads again.
        on_test: called after each test with the number of checked tests, and of all.

    Raises:
        CampaignError: there is no campaign, it is of another format, or it is too damaged to be
            opened.
    """
    folder = Path(folder)
    with CampaignStore.open(folder) as store:
        findings = list(_findings(store, quick, on_test))
        files = (folder / f"{DATABASE}{suffix}" for suffix in ("", "-wal"))
        created_at, counts, asked, trajectories = "", Counts(), 0, 0
        try:
            created_at = str(store.fact("created_at") or "")
            counts = store.counts()
            ((asked, trajectories),) = store.rows("SELECT count(*), count(trajectory) FROM test")
        except CampaignError as error:
            findings.append(str(error))
        return CheckReport(
            folder,
            created_at,
            counts,
            asked,
            trajectories,
            sum(file.stat().st_size for file in files if file.is_file()),
            _versions(store),
            tuple(dict.fromkeys(findings)),
        )


def _versions(store: CampaignStore) -> Mapping[str, str]:
    versions = store.config.get("versions")
    return {k: str(v) for k, v in versions.items()} if isinstance(versions, Mapping) else {}


def _findings(
    store: CampaignStore, quick: bool, on_test: Callable[[int, int], None] | None
) -> Iterator[str]:
    try:
        for (line,) in store.rows("PRAGMA integrity_check"):
            if line != "ok":
                yield f"SQLite says: {' '.join(line.split())}"
        if fault := fault_of(store.config):
            yield f"the configuration: {fault}"
        _ = store.facts, store.fact("earlier")  # each with its checksum
        for (number,) in store.rows("SELECT test FROM finding EXCEPT SELECT id FROM test"):
            yield f"there are findings of test {number}, which is missing"
        numbers = list(store.rows("SELECT id, told FROM test ORDER BY told IS NULL, told, id"))
    except CampaignError as error:
        yield str(error)
        return
    told = [number for _, number in numbers if number is not None]
    if told != list(range(1, len(told) + 1)):
        yield f"{len(told)} results are told, but not as numbers 1 to {len(told)}: some are missing"
    if (logged := told_in_log(store.folder)) > len(told):
        yield (
            f"the log tells of {logged} results, the database holds {len(told)}: the last ones are"
            f" lost; was {DATABASE} copied without {DATABASE}-wal?"
        )
    ids = sorted(number for number, _ in numbers)
    if ids != list(range(1, len(ids) + 1)):
        yield f"{len(ids)} candidates are there, but not those from 1 to {len(ids)}"
    changed = changed_packages(store.config.get("versions"))
    note = f" (versions differ: {', '.join(changed)})" if changed else ""
    for done, (number, told_as) in enumerate(numbers, start=1):
        try:
            if told_as is None:
                store.candidate(number)
                continue
            test = store.test(number)
        except CampaignError as error:
            yield str(error)
            continue
        if on_test is not None:
            on_test(done, len(told))
        if test.trajectory is not None and (np.diff(test.trajectory.time) < 0.0).any():
            yield f"the trajectory of test {number} goes back in time"
        elif not quick and test.setting is not None and test.attempt.worker != WORKER:
            difference = judged_otherwise(test, test.setting)
            if difference:
                yield f"test {number}: {difference}{note}"


def judged_otherwise(test: Test, setting: Setting) -> str:
    """Difference of the verdict on a test from the stored one.

    Empty if there is none beyond rounding, or nothing to judge.
    """
    if test.outcome is Outcome.INVALID:
        is_valid = fitted(test.candidate, setting)[1].valid
        return "it is stored as INVALID, but its road is valid" if is_valid else ""
    if not test.outcome.is_driven or test.trajectory is None:
        return ""
    try:
        road = test.road
    except RoadError as error:
        return f"it was driven, but its road is none: {error}"
    first = ""
    for rules in _rules(setting.rules):
        verdict = judge(road, Drive(test.trajectory, setting.car, rules))
        difference = _difference(test.result, verdict)
        if not difference:
            return ""
        first = first or difference
    return first


def _rules(rules: Rules) -> Iterator[Rules]:
    """The rules, then with every limit a little tighter, then a little looser."""
    yield rules
    for sign in (-1.0, 1.0):
        yield replace(
            rules,
            oob_tolerance=min(rules.oob_tolerance + sign * SHARE_TOLERANCE, 1.0),
            goal_distance=rules.goal_distance - sign * MOOBD_TOLERANCE,
            # Both ends of the car's movement are rounded.
            stuck_distance=rules.stuck_distance - 2.0 * sign * MOOBD_TOLERANCE,
            stuck_time=rules.stuck_time + sign * TIME_TOLERANCE,
            timeout_base=rules.timeout_base + sign * TIME_TOLERANCE,
            criteria=_moved(rules.criteria, sign),
        )


def _moved(profile: Profile, sign: float) -> Profile:
    """The criteria with limits that are a little tighter, for a sign of -1, or looser."""

    def moved(one: Criterion) -> Criterion:
        what = quantity(one.quantity)
        slack = (-sign if what.is_least else sign) * CRITERIA_TOLERANCE * what.scale
        return replace(one, limit=one.limit + slack)

    return replace(profile, criteria=tuple(map(moved, profile.criteria)))


def _difference(stored: Result, verdict: Result) -> str:
    if verdict.outcome is not stored.outcome:
        again = f"judged again it is {verdict.outcome}: {verdict.reason}"
        return f"it is stored as {stored.outcome}, {again}"
    both = zip(_numbers(stored).items(), _numbers(verdict).values(), _TOLERANCES, strict=True)
    for (name, before), now, tolerance in both:
        is_near = before == now or (None not in (before, now) and abs(before - now) <= tolerance)
        if not is_near:
            old, new = ("nothing" if one is None else f"{one:.6g}" for one in (before, now))
            return f"{name} is stored as {old}, judged again it is {new}"
    old, new = (
        " and ".join(sorted(f"{one.criterion} {one.side or ''}".strip() for one in result.findings))
        for result in (stored, verdict)
    )
    return "" if old == new else f"it broke {old or 'nothing'}, judged again {new or 'nothing'}"


def _numbers(result: Result) -> dict[str, Any]:
    """What is compared: lengths in m, a share, and a time in s."""
    place = result.departure
    return {
        "moobd": result.moobd,
        "max_oob_share": result.max_oob_share,
        "duration": result.duration,
        "departure distance": None if place is None else place.distance,
    }
