"""Confirmation: failures of one simulator, driven in another.

A failure in two simulators is one of the driver; a failure in one may be a property of that
simulator. The drives and verdicts are kept in the campaign's folder.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import Any, Final

from frenetic.analysis.statistics import spearman
from frenetic.campaign.campaign import prepare
from frenetic.campaign.record import Attempt, TestRecord
from frenetic.campaign.store import CampaignStore, JSONValue
from frenetic.campaign.trajectory_codec import decode, encode
from frenetic.drivers import Driver
from frenetic.errors import CampaignError
from frenetic.outcome import Outcome
from frenetic.redrive.kept import KeptFile, as_number, as_whole
from frenetic.redrive.loop import Task, campaign_tester, drive_again
from frenetic.redrive.robustness import Repeat, drive_document, read_drive
from frenetic.simulators.drive import CarBody, Drive, Rules, Trajectory
from frenetic.simulators.simulator import Simulator
from frenetic.simulators.worlds import USUAL
from frenetic.spec import describe

CONFIRMATIONS: Final = "confirmations.json"
"""Name of the file in a campaign's folder that holds its failures' drives in other simulators."""
VERSION: Final = 1
"""Of that file's form."""
LEAST_PAIRS: Final = 3
"""Fewest drives for comparing the ranks of MOOBD."""

_FILE: Final = KeptFile(CONFIRMATIONS, "confirmations", VERSION, "frenetic confirm")


class Agreement(StrEnum):
    """Verdict of another simulator on a failure."""

    CONFIRMED = "confirmed"
    """The driver fails there, too."""
    NOT_CONFIRMED = "not confirmed"
    """The driver passes there."""
    NOT_JUDGED = "not judged"
    """The road is INVALID there, or the simulator or driver broke."""


@dataclass(frozen=True)
class ConfirmedTest:
    """A failing test and its drive in the other simulator."""

    test_id: int
    recorded: Repeat
    """The drive in the campaign."""
    other: Repeat
    """The drive in the other simulator."""
    reason: str
    """Reason of its end."""
    trajectory: Trajectory | None
    """Of that drive, None if nothing was driven."""

    @property
    def agreement(self) -> Agreement:
        """Verdict of the other simulator."""
        if not self.other.outcome.is_driven:
            return Agreement.NOT_JUDGED
        failed = self.other.outcome is Outcome.FAIL
        return Agreement.CONFIRMED if failed else Agreement.NOT_CONFIRMED

    @property
    def is_alike(self) -> bool:
        """Whether the car leaves its lane on the same side and within 30 m along the road."""
        return self.other.fails_like(self.recorded)


@dataclass(frozen=True)
class Correlation:
    """Correlation of the MOOBDs of two simulators."""

    spearman: float
    """Rank correlation -1..1: 1 if both put the roads in the same order."""
    p: float
    """That it is chance."""
    pairs: int
    """Number of compared roads."""


@dataclass(frozen=True)
class Confirmation:
    """Failures of a campaign, driven in another simulator."""

    simulator: Mapping[str, JSONValue]
    """As a campaign describes it."""
    driver: Mapping[str, JSONValue]
    """As a campaign describes it."""
    rules: Rules
    car: CarBody
    """In the other simulator, as are the rules."""
    tests: tuple[ConfirmedTest, ...]
    """Tests in the order of their choice, representative ones first."""
    missing: int = 0
    """Number of tests left undriven by Ctrl-C."""

    @cached_property
    def key(self) -> str:
        """Eight digits that stand for simulator, driver and rules, with their options."""
        parts = [dict(self.simulator), dict(self.driver), asdict(self.rules)]
        text = json.dumps(parts, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:8]

    def count(self, agreement: Agreement) -> int:
        """Tests of which the other simulator says this."""
        return sum(test.agreement is agreement for test in self.tests)

    @property
    def alike(self) -> int:
        """Failures that are confirmed at the same place."""
        return sum(test.is_alike for test in self.tests)

    @cached_property
    def correlation(self) -> Correlation | None:
        """Correlation of the MOOBDs; None if fewer than three pairs vary."""
        pairs = [(one.recorded.moobd, one.other.moobd) for one in self.tests]
        known = [(a, b) for a, b in pairs if a is not None and b is not None]
        if len(known) < LEAST_PAIRS:
            return None
        try:
            rho, p = spearman([a for a, _ in known], [b for _, b in known])
        except ValueError:  # one of them is the same everywhere
            return None
        return Correlation(rho, p, len(known))

    def drive(self, test: ConfirmedTest) -> Drive | None:
        """A test's drive in the other simulator, None if nothing was driven."""
        return None if test.trajectory is None else Drive(test.trajectory, self.car, self.rules)


def confirm(
    folder: Path,
    simulator: Simulator,
    driver: Driver,
    *,
    test_ids: Sequence[int],
    workers: int = 1,
    drive_limit: float | None = None,
    on_progress: Callable[[int, int], None] | None = None,
    on_start: Callable[[], None] | None = None,
    on_interrupt: Callable[[], None] | None = None,
) -> Confirmation:
    """Drives failures of a campaign in another simulator and keeps the results.

    Args:
        folder: of the campaign.
        simulator: the other one, not yet entered.
        driver: the campaign's or another.
        test_ids: the failures, the most important first.
        workers: number of roads driven at once, as for `Campaign`.
        drive_limit: s of wall time, likewise.
        on_progress: called after every drive with the number of drives, and of all.
        on_start: called when the simulator has started.
        on_interrupt: called at the first Ctrl-C, which ends it after the running drives.

    Raises:
        CampaignError: the campaign is damaged, a test is no failure, or no worker can be started.
        ValueError: an option is out of range.
    """
    kept = read_confirmations(folder)  # complains before anything is driven
    if workers > 1:  # they measure its car, each for itself; here it would never be entered
        prepare(simulator)
    with CampaignStore.open(folder) as store:
        records = [store.test(test_id, with_trajectory=False) for test_id in test_ids]
        tester = campaign_tester(store, simulator, driver)
    for record in records:
        if record.outcome is not Outcome.FAIL:
            raise CampaignError(
                f"test {record.candidate.id} is {record.outcome}: only a failure can be confirmed"
            )
    tasks = [Task.of(i, record) for i, record in enumerate(records, start=1)]
    done: dict[int, ConfirmedTest] = {}

    def note(attempt: Attempt) -> None:
        number = attempt.candidate_id
        done[number] = _confirmed(records[number - 1], attempt)
        if on_progress is not None:
            on_progress(len(done), len(records))

    drive_again(
        tasks,
        tester,
        workers=workers,
        drive_limit=drive_limit,
        on_attempt=note,
        on_start=on_start,
        on_interrupt=on_interrupt,
    )
    confirmation = Confirmation(
        simulator=describe(simulator),
        driver=describe(driver),
        rules=simulator.rules,
        car=simulator.car,
        tests=tuple(done[number] for number in sorted(done)),
        missing=len(records) - len(done),
    )
    if confirmation.tests:
        others = [one for one in kept if one.key != confirmation.key]
        write_confirmations(folder, [*others, confirmation])
    return confirmation


def _confirmed(record: TestRecord, attempt: Attempt) -> ConfirmedTest:
    trajectory = None if attempt.packed is None else decode(attempt.packed)
    return ConfirmedTest(
        record.candidate.id,
        Repeat.recorded(record),
        Repeat.of(USUAL, attempt),
        attempt.result.reason,
        trajectory,
    )


# What is kept in a campaign's folder


def write_confirmations(folder: Path, confirmations: Iterable[Confirmation]) -> Path:
    """Writes all that is kept of a campaign's confirmations in place of what was there.

    Returns:
        The file.

    Raises:
        CampaignError: it cannot be written.
    """
    return _FILE.write(folder, [_document(one, with_drives=True) for one in confirmations])


def confirmation_document(confirmation: Confirmation) -> dict[str, JSONValue]:
    """A confirmation as a JSON object, without the trajectories."""
    return _document(confirmation, with_drives=False)


def _document(confirmation: Confirmation, *, with_drives: bool) -> dict[str, JSONValue]:
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
        "correlation": None if correlation is None else asdict(correlation),
        "missing": confirmation.missing,
        "tests": [_test_document(one, with_drives) for one in confirmation.tests],
    }


def _test_document(one: ConfirmedTest, with_drives: bool) -> dict[str, JSONValue]:
    document: dict[str, JSONValue] = {
        "test": one.test_id,
        "agreement": str(one.agreement),
        "alike": one.is_alike,
        "reason": one.reason,
        "recorded": drive_document(one.recorded),
        "other": drive_document(one.other),
    }
    if with_drives:
        packed = None if one.trajectory is None else encode(one.trajectory)
        document["trajectory"] = None if packed is None else base64.b64encode(packed).decode()
    return document


def read_confirmations(folder: Path) -> tuple[Confirmation, ...]:
    """What is kept in a campaign's folder, in the order in which it was made.

    Raises:
        CampaignError: it cannot be read, is damaged, or was written by a newer version.
    """
    return tuple(_FILE.read(folder, _read_confirmation))


def _read_confirmation(item: Any) -> Confirmation:
    return Confirmation(
        simulator=_described(item["simulator"]),
        driver=_described(item["driver"]),
        rules=Rules(**{name: as_number(value) for name, value in item["rules"].items()}),
        car=CarBody(**{name: as_number(value) for name, value in item["car"].items()}),
        tests=tuple(_read_test(one) for one in item["tests"]),
        missing=as_whole(item["missing"]),
    )


def _described(part: Any) -> dict[str, JSONValue]:
    if not isinstance(part, dict) or not isinstance(part.get("class"), str):
        raise TypeError("a part without a class")
    return part


def _read_test(item: Any) -> ConfirmedTest:
    packed = item["trajectory"]
    try:
        trajectory = None if packed is None else decode(base64.b64decode(packed, validate=True))
    except binascii.Error as error:
        raise ValueError(f"a trajectory is no base64: {error}") from None
    return ConfirmedTest(
        test_id=as_whole(item["test"]),
        recorded=read_drive(item["recorded"]),
        other=read_drive(item["other"]),
        reason=str(item["reason"]),
        trajectory=trajectory,
    )
