"""Results of reruns: drives on a campaign's roads, read from their folders, named and merged."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from msgspec import ValidationError, convert

from frenetic._support.json_value import JSONValue
from frenetic.analysis.failures import Failure
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.conditions.condition import SEED, as_text, without
from frenetic.errors import CampaignError
from frenetic.oracle.drive import Rules
from frenetic.parts.records import comparison_key, differences
from frenetic.parts.versions import SHORT
from frenetic.rerun.campaigns import purpose_of, rerun_folders
from frenetic.rerun.replay import recorded_test
from frenetic.rerun.stability import Change, Repeat, Repeats, matches_json, matches_text
from frenetic.rerun.variations import Variation, recorded_conditions
from frenetic.spec.part_text import part_text
from frenetic.spec.terms import DriveSetting


@dataclass(frozen=True)
class Rerun:
    """Drives on the roads of a campaign's tests, all with the same parts."""

    campaign: str
    """Name of the folder of the campaign whose roads these are."""
    driver: Mapping[str, JSONValue]
    """Driver, as `frenetic.spec.part_record.describe` records it."""
    simulator: Mapping[str, JSONValue]
    """Simulator, as `frenetic.spec.part_record.describe` records it."""
    rules: Rules
    """Rules by which the drives ended."""
    planned: int
    """Number of planned drives; Ctrl-C leaves fewer."""
    tests: tuple[Repeats, ...]
    """Repeats of each test, in the order in which the tests were chosen."""
    variations: tuple[Variation, ...] = ()
    """Ranges from which the conditions were drawn."""
    conditions: Mapping[str, float] = field(default_factory=dict)
    """Conditions of every drive; a drive may have further ones, see `Repeat.conditions`."""
    folder: Path | None = None
    """Folder of the campaign that drove the roads; None if there was nothing to drive."""

    @property
    def drives(self) -> list[Repeat]:
        """All drives."""
        return [drive for test in self.tests for drive in test.drives]

    @property
    def missing(self) -> int:
        """Number of drives that Ctrl-C prevented."""
        return max(self.planned - len(self.drives), 0)

    @property
    def same(self) -> int:
        """Number of drives with exactly the recorded outcome and MOOBD."""
        return sum(drive.is_same for drive in self.drives)

    def count(self, change: Change) -> int:
        """Return the number of tests with a change."""
        return sum(test.change is change for test in self.tests)

    @property
    def passed(self) -> bool:
        """Whether no drive is missing and all drives passed."""
        passing = (Change.PASSES_NOW, Change.PASSES_AGAIN)
        return self.missing == 0 and all(test.change in passing for test in self.tests)

    @cached_property
    def key(self) -> str:
        """Hexadecimal digest of simulator, driver, rules and conditions, by which reruns merge."""
        rules, conditions = self.rules.as_json(), dict(self.conditions)
        parts = comparison_key(self.simulator, self.driver, rules, conditions)
        return hashlib.sha256(parts.encode()).hexdigest()[:SHORT]

    def __str__(self) -> str:
        texts = []
        for change in Change:
            tests = [test for test in self.tests if test.change is change]
            matches = matches_text(drive for test in tests for drive in test.drives)
            if tests:
                texts.append(f"{change.counted(len(tests))}{f' ({matches})' if matches else ''}")
        return ", ".join(texts)

    def as_json(self) -> dict[str, JSONValue]:
        """Return the rerun as a JSON object, without trajectories."""
        return {
            "campaign": self.campaign,
            "folder": None if self.folder is None else str(self.folder),
            "driver": dict(self.driver),
            "simulator": dict(self.simulator),
            "conditions": dict(self.conditions),
            "variations": [asdict(variation) for variation in self.variations],
            "passed": self.passed,
            "same": self.same,
            "missing": self.missing,
            "changes": {str(change): self.count(change) for change in Change},
            "matches": matches_json(self.drives),
            "tests": [test.as_json() for test in self.tests],
        }


@dataclass(frozen=True)
class _RerunPurpose:
    """Entry `frenetic.rerun.campaigns.PURPOSE` of a rerun's configuration."""

    digest: str
    """Digest of the rerun's roads and parts."""
    planned: int
    """Number of planned drives."""
    variations: tuple[Variation, ...] = ()
    """Ranges from which the conditions were drawn."""


def read_rerun(folder: Path | str, source: Path | str) -> Rerun:
    """Return the rerun in a folder, which may be incomplete.

    Args:
        folder: folder of the campaign that drove the roads.
        source: folder of the campaign that the roads come from.

    Raises:
        CampaignError: a campaign is damaged, or ``folder`` holds no rerun.
    """
    with CampaignStore.open(folder) as store, CampaignStore.open(source) as original:
        try:
            purpose = convert(purpose_of(store), _RerunPurpose)
        except ValidationError as error:
            raise CampaignError(f"{folder} is no rerun of a campaign: {error}") from None
        drives = _read_repeats(store, original)
        parts: Any = store.config
        setting = store.setting
        is_own = is_own_setup(parts, setting, original)
        return Rerun(
            Path(source).resolve().name,
            parts["driver"],
            parts["simulator"],
            setting.rules,
            purpose.planned,
            tuple(
                _repeats(repeats, purpose.variations, setting.rules, is_own)
                for repeats in drives.values()
            ),
            purpose.variations,
            setting.conditions,
            Path(folder),
        )


def is_own_setup(parts: Mapping[str, Any], setting: DriveSetting, original: CampaignStore) -> bool:
    """Return whether driver, simulator, rules and common conditions are a campaign's own.

    Args:
        parts: driver and simulator, as `frenetic.spec.part_record.describe` records them.
        setting: rules and conditions.
        original: the campaign.
    """
    original_setting = original.setting
    return (
        setting.rules == original_setting.rules
        and setting.conditions == original_setting.conditions
        and not any(
            differences(kind, parts[kind], original.config.get(kind))
            for kind in ("driver", "simulator")
        )
    )


def _read_repeats(store: CampaignStore, original: CampaignStore) -> dict[int, list[Repeat]]:
    """Return id of a recorded test -> its repeats, in the order in which the roads were driven.

    Args:
        store: campaign that drove the roads again.
        original: campaign that the roads come from.

    Raises:
        CampaignError: a test does not say which recorded test it repeats.
    """
    recorded: dict[int, tuple[Test, Failure | None]] = {}
    drives: dict[int, list[Repeat]] = {}
    for test in sorted(store.tests(with_trajectory=True), key=lambda test: test.id):
        number = recorded_test(store, test)
        if number not in recorded:
            old_test = original.test(number)
            recorded[number] = old_test, Failure.of_test(old_test)
        old_test, old_failure = recorded[number]
        new_failure = Failure.of_test(test) if old_failure is not None else None
        difference = None
        if old_failure is not None and new_failure is not None:
            difference = old_failure.difference(new_failure)
        drives.setdefault(number, []).append(Repeat(old_test, test, difference))
    return drives


def _repeats(
    drives: Sequence[Repeat],
    variations: Sequence[Variation],
    rules: Rules,
    has_own_parts: bool,
) -> Repeats:
    """Return the repeats of one test, with the ranges of its conditions.

    Args:
        drives: repeats of the test.
        variations: varied conditions of the rerun.
        rules: rules of the rerun.
        has_own_parts: whether parts, rules and common conditions are the source campaign's.
    """
    recorded = drives[0].recorded
    conditions = recorded.candidate.conditions
    varied = [variation.condition for variation in variations]
    is_own = has_own_parts and all(
        without(drive.conditions, *varied, SEED) == without(conditions, *varied, SEED)
        for drive in drives
    )
    ranges = tuple(
        variation.of(recorded_conditions(recorded.candidate, rules)) for variation in variations
    )
    return Repeats(recorded, tuple(drives), ranges, is_own)


def read_reruns(folder: Path | str) -> list[Rerun]:
    """Return the reruns of a campaign, interrupted ones first, the latest last.

    Raises:
        CampaignError: a rerun is damaged.
    """
    reruns = []
    for rerun_folder in rerun_folders(folder):
        with CampaignStore.open(rerun_folder) as store:
            is_rerun = "planned" in purpose_of(store)
        if is_rerun:
            reruns.append(read_rerun(rerun_folder, folder))
    return reruns


def rerun_name(rerun: Rerun, config: Mapping[str, Any]) -> str:
    """Return the name of a rerun: its simulator, and what else is not as in the campaign.

    Args:
        rerun: the rerun.
        config: configuration of the source campaign.
    """
    simulator = part_text(rerun.simulator, config.get("simulator"))
    driver = part_text(rerun.driver, config.get("driver"))
    if dict(rerun.conditions) != (config.get("conditions") or {}):
        conditions = as_text(rerun.conditions)
        simulator += f" with {conditions}" if conditions else " in the usual conditions"
    return simulator if driver == part_text(config.get("driver")) else f"{driver} in {simulator}"


def own_repeats(reruns: Iterable[Rerun]) -> list[Repeats]:
    """Return the most informative repeats of each test that were driven with the campaign's parts.

    Repeats in varied conditions are preferred, then those with more judged drives, then later ones.

    Args:
        reruns: reruns in the order of `read_reruns`.
    """
    repeats = [
        test
        for rerun in reruns
        for test in rerun.tests
        if test.is_own and test.judged and test.stability is not None
    ]
    # The sort is stable, so the last of equal ones wins.
    repeats.sort(key=lambda test: (bool(test.variations), test.judged))
    return sorted({test.id: test for test in repeats}.values(), key=lambda test: test.id)


def in_other_simulators(reruns: Iterable[Rerun], config: Mapping[str, Any]) -> list[Rerun]:
    """Return the reruns in other simulators than the campaign's, merged by parts and conditions.

    Of each test the drives of the last rerun that could judge some count.

    Args:
        reruns: reruns in the order of `read_reruns`.
        config: configuration of the source campaign.
    """
    merged: dict[str, Rerun] = {}
    for rerun in reruns:
        if not differences("simulator", rerun.simulator, config.get("simulator")):
            continue
        before = merged.get(rerun.key)
        tests = {} if before is None else {test.id: test for test in before.tests}
        tests |= {test.id: test for test in rerun.tests if test.judged or test.id not in tests}
        planned = max(rerun.planned, sum(len(test.drives) for test in tests.values()))
        merged[rerun.key] = replace(rerun, planned=planned, tests=tuple(tests.values()))
    return list(merged.values())
