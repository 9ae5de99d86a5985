"""Confirmation: failures of one simulator, driven in another.

A failure in two simulators is one of the driver; a failure in one may be a property of that
simulator. It is confirmed if the driver has the same failure in the other one, see
`frenetic.redrive.record.Match`; failing otherwise there is no confirmation. The drives and verdicts
are kept in the campaign's folder.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Final, Unpack

from frenetic.analysis.statistics import spearman
from frenetic.campaign.store import CampaignStore, JSONValue
from frenetic.drive import CarBody, Drive, Rules
from frenetic.drivers import Driver
from frenetic.errors import CampaignError
from frenetic.outcome import Outcome
from frenetic.redrive.drives import RedriveOptions, campaign_tester, drive_again, merged, read_runs
from frenetic.redrive.record import (
    Agreement,
    Purpose,
    Redrive,
    Run,
    matches_document,
    matches_text,
    redrive_document,
    verdict_document,
)
from frenetic.simulators.simulator import Simulator
from frenetic.spec import part_text
from frenetic.versions import SHORT, comparison_key

LEAST_PAIRS: Final = 3
"""Fewest drives for comparing the ranks of MOOBD."""


@dataclass(frozen=True)
class Correlation:
    """Correlation of the MOOBDs of two simulators."""

    spearman: float
    """Rank correlation -1..1: 1 if both put the roads in the same order."""
    p: float
    """The p that it is chance."""
    pairs: int
    """Number of compared roads."""


@dataclass(frozen=True)
class Confirmation:
    """Failures of a campaign, driven in another simulator."""

    simulator: Mapping[str, JSONValue]
    """In the form of a campaign's description."""
    driver: Mapping[str, JSONValue]
    """In the form of a campaign's description."""
    rules: Rules
    car: CarBody
    """Car in the other simulator, like the rules."""
    tests: tuple[Redrive, ...]
    """Drives in the order of choice, representative failures first."""
    missing: int = 0
    """Number of tests left undriven by Ctrl-C."""
    folder: Path | None = None
    """Folder of the campaign that drove them, the last one."""

    @cached_property
    def key(self) -> str:
        """Eight digits for simulator, driver and rules, with their options."""
        parts = comparison_key(self.simulator, self.driver, asdict(self.rules))
        return hashlib.sha256(parts.encode()).hexdigest()[:SHORT]

    def count(self, agreement: Agreement) -> int:
        """Tests with this verdict of the other simulator."""
        return sum(test.agreement is agreement for test in self.tests)

    @property
    def alike(self) -> int:
        """The number of confirmed failures."""
        return self.count(Agreement.CONFIRMED)

    def __str__(self) -> str:
        texts = [f"{self.count(kind)} {kind}" for kind in Agreement if self.count(kind)]
        others = [test for test in self.tests if test.agreement is Agreement.FAILING_OTHERWISE]
        kind = f"{len(others)} {Agreement.FAILING_OTHERWISE}"
        return ", ".join(f"{t} ({matches_text(others)})" if t == kind else t for t in texts)

    @cached_property
    def correlation(self) -> Correlation | None:
        """Correlation of the MOOBDs; None if fewer than three pairs vary."""
        pairs = [(one.recorded.moobd, one.moobd) for one in self.tests]
        known = [(a, b) for a, b in pairs if a is not None and b is not None]
        if len(known) < LEAST_PAIRS:
            return None
        try:
            rho, p = spearman([a for a, _ in known], [b for _, b in known])
        except ValueError:  # one of them is the same everywhere
            return None
        return Correlation(rho, p, len(known))

    def drive(self, test: Redrive) -> Drive | None:
        """A test's drive in the other simulator, None if nothing was driven."""
        return test.test.drive


@dataclass(frozen=True)
class Names:
    """Names of the two simulators of a confirmation."""

    recorded: str
    """The campaign's."""
    other: str


def confirm(
    folder: Path | str,
    simulator: Simulator,
    driver: Driver,
    *,
    test_ids: Sequence[int],
    on_progress: Callable[[int, int], None] | None = None,
    **how: Unpack[RedriveOptions],
) -> Confirmation:
    """Drives failures of a campaign in another simulator and keeps the results.

    Args:
        folder: of the campaign.
        simulator: the other one, not yet entered.
        driver: the campaign's or another.
        test_ids: the failures, the most important first.
        on_progress: called after every drive with the number of drives, and of all.
        how: see `frenetic.redrive.drives.RedriveOptions`.

    Raises:
        CampaignError: the campaign is damaged, a test is no failure, or no worker can be started.
        ValueError: an option is out of range.
    """
    with CampaignStore.open(folder) as store:
        records = [store.test(test_id, with_trajectory=False) for test_id in test_ids]
        tester = campaign_tester(store, simulator, driver)
    for record in records:
        if record.outcome is not Outcome.FAIL:
            raise CampaignError(
                f"test {record.candidate.id} is {record.outcome}: only a failure can be confirmed"
            )
    run = drive_again(
        folder,
        Purpose.CONFIRMATION,
        tester,
        records,
        on_progress=on_progress and (lambda now: on_progress(now.drives, now.total)),
        **how,
    )
    return _of_run(run)


def _of_run(run: Run) -> Confirmation:
    assert run.rules is not None
    assert run.car is not None
    return Confirmation(
        simulator=run.simulator,
        driver=run.driver,
        rules=run.rules,
        car=run.car,
        tests=run.drives,
        missing=max(run.planned - len(run.drives), 0),
        folder=run.folder,
    )


def read_confirmations(folder: Path | str) -> tuple[Confirmation, ...]:
    """The stored confirmations of a campaign, one of each simulator, driver and rules.

    Of a test's drives with these, the last judged one counts.

    Raises:
        CampaignError: it cannot be read, is damaged, or was written by a newer version.
    """
    runs = merged(read_runs(folder, Purpose.CONFIRMATION))
    return tuple(_of_run(run) for run in runs if run.drives)


def names_of(store: CampaignStore, confirmation: Confirmation) -> Names:
    """The simulators, with their drivers if these differ."""
    recorded = store.config.get("simulator"), store.config.get("driver")
    here, driver_here = map(part_text, recorded)
    there = part_text(confirmation.simulator, recorded[0])
    driver_there = part_text(confirmation.driver, recorded[1])
    if driver_here != driver_there:
        here, there = f"{driver_here} in {here}", f"{driver_there} in {there}"
    return Names(f"{here} (campaign)" if here == there else here, there)


def confirmation_document(confirmation: Confirmation) -> dict[str, JSONValue]:
    """A confirmation as a JSON object, without the trajectories."""
    correlation = confirmation.correlation
    rules: dict[str, JSONValue] = asdict(confirmation.rules)
    car: dict[str, JSONValue] = asdict(confirmation.car)
    return {
        "simulator": dict(confirmation.simulator),
        "driver": dict(confirmation.driver),
        "rules": rules,
        "car": car,
        **{str(kind): confirmation.count(kind) for kind in Agreement},
        "alike": confirmation.alike,
        "matches": matches_document(confirmation.tests),
        "correlation": None if correlation is None else asdict(correlation),
        "missing": confirmation.missing,
        "tests": [
            {
                "test": one.test_id,
                "agreement": str(one.agreement),
                "alike": one.is_alike,
                "reason": one.reason,
                "recorded": verdict_document(one.recorded),
                "other": redrive_document(one),
            }
            for one in confirmation.tests
        ],
    }
