"""Regression: a campaign's roads, driven with another driver, version or simulator."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Final

from frenetic._support.files import write_file
from frenetic.campaign.record import Attempt, TestRecord, as_text
from frenetic.campaign.store import CampaignStore, JSONValue
from frenetic.drivers import Driver
from frenetic.errors import CampaignError
from frenetic.outcome import Outcome
from frenetic.redrive.loop import Task, campaign_tester, drive_again
from frenetic.simulators.simulator import Simulator
from frenetic.spec import describe

SUITE: Final = "frenetic replay"
"""Name of the whole in a JUnit file."""
# What XML 1.0 cannot hold, not even escaped.
_NO_XML: Final = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


class Change(StrEnum):
    """Change of a test."""

    FIXED = "fixed"
    """It failed and passes now."""
    STILL_FAILING = "still failing"
    NEWLY_FAILING = "newly failing"
    """It did not fail."""
    STILL_PASSING = "still passing"
    """It did not fail, nor does it now."""
    NOT_JUDGED = "not judged"
    """The road is INVALID now, or the simulator or driver broke."""


@dataclass(frozen=True)
class Replayed:
    """A test before and after it was driven again."""

    test_id: int
    before: Outcome
    moobd_before: float | None
    """Minimum oob distance, in m; None unless PASS or FAIL, as for `moobd_after`."""
    after: Outcome
    moobd_after: float | None
    reason: str
    """Reason of the present outcome."""
    duration: float
    """Simulated time that it took now, in s."""
    length: float
    """Length of road, in m."""
    seconds: float
    """Wall time that it took now, in s."""

    @property
    def change(self) -> Change:
        """What became of it."""
        if not self.after.is_driven:
            return Change.NOT_JUDGED
        failed = self.before is Outcome.FAIL
        if self.after is Outcome.FAIL:
            return Change.STILL_FAILING if failed else Change.NEWLY_FAILING
        return Change.FIXED if failed else Change.STILL_PASSING

    @property
    def is_same(self) -> bool:
        """Whether outcome and MOOBD are exactly as before."""
        return self.after is self.before and self.moobd_after == self.moobd_before


@dataclass(frozen=True)
class Replay:
    """A campaign's tests, driven again."""

    campaign: str
    """Name of its folder."""
    driver: Mapping[str, JSONValue]
    """As a campaign describes it."""
    simulator: Mapping[str, JSONValue]
    """As a campaign describes it."""
    tests: tuple[Replayed, ...]
    """In the order of their ids."""
    missing: int
    """Number of tests left undriven by Ctrl-C."""

    def count(self, change: Change) -> int:
        """Tests of which this became."""
        return sum(test.change is change for test in self.tests)

    @property
    def passed(self) -> bool:
        """Whether all were driven again and none failed."""
        bad = (Change.STILL_FAILING, Change.NEWLY_FAILING, Change.NOT_JUDGED)
        return self.missing == 0 and not any(test.change in bad for test in self.tests)

    @property
    def same(self) -> int:
        """Tests whose outcome and MOOBD are exactly as before."""
        return sum(test.is_same for test in self.tests)


@dataclass(frozen=True)
class ReplayProgress:
    """Progress of driving again."""

    tests: int
    total: int
    failed: int


def replay(
    folder: Path | str,
    simulator: Simulator,
    driver: Driver,
    *,
    everything: bool = False,
    workers: int = 1,
    drive_limit: float | None = None,
    on_progress: Callable[[ReplayProgress], None] | None = None,
    on_start: Callable[[], None] | None = None,
    on_interrupt: Callable[[], None] | None = None,
) -> Replay:
    """Drives the failing roads of a campaign again, each where it lay on the map.

    Args:
        folder: of the campaign, which is only read.
        simulator: any, not yet entered.
        driver: any.
        everything: all driven roads, not only failing ones.
        workers: number of roads driven at once, as for `Campaign`.
        drive_limit: s of wall time, likewise.
        on_progress: called after every drive.
        on_start: called when the simulator has started.
        on_interrupt: called at the first Ctrl-C, which ends it after the running drives.

    Raises:
        CampaignError: the campaign is damaged, or no worker can be started.
        ValueError: an option is out of range.
    """
    folder = Path(folder)
    with CampaignStore.open(folder) as store:
        kinds = (Outcome.FAIL, Outcome.PASS) if everything else (Outcome.FAIL,)
        records = [record for kind in kinds for record in store.tests(kind)]
        tester = campaign_tester(store, simulator, driver)
    records.sort(key=lambda record: record.candidate.id)
    tasks = [Task.of(i, record) for i, record in enumerate(records, start=1)]
    tests: list[Replayed] = []
    failed = 0

    def note(attempt: Attempt) -> None:
        nonlocal failed
        tests.append(_replayed(records[attempt.candidate_id - 1], attempt))
        failed += tests[-1].after is Outcome.FAIL
        if on_progress is not None:
            on_progress(ReplayProgress(len(tests), len(records), failed))

    drive_again(
        tasks,
        tester,
        workers=workers,
        drive_limit=drive_limit,
        on_attempt=note,
        on_start=on_start,
        on_interrupt=on_interrupt,
    )
    return Replay(
        campaign=folder.resolve().name,
        driver=describe(driver),
        simulator=describe(simulator),
        tests=tuple(sorted(tests, key=lambda test: test.test_id)),
        missing=len(records) - len(tests),
    )


def _replayed(record: TestRecord, attempt: Attempt) -> Replayed:
    candidate, result = record.candidate, attempt.result
    return Replayed(
        test_id=candidate.id,
        before=record.outcome,
        moobd_before=record.moobd,
        after=result.outcome,
        moobd_after=result.moobd,
        reason=as_text(result.reason),
        duration=result.duration,
        length=(len(candidate.curvatures) - 1) * candidate.step,
        seconds=attempt.seconds,
    )


# JUnit


def write_junit(replay: Replay, path: Path) -> None:
    """Writes a replay as a JUnit XML file, one test case per road.

    A road on which the driver fails is a failure, one that could not be judged an error. The
    outcome before and MOOBD are properties of the test case.

    Raises:
        CampaignError: the file cannot be written.
    """
    write_file(path, junit(replay), remedy="choose another file with --junit", error=CampaignError)


def junit(replay: Replay) -> bytes:
    """A replay as JUnit XML, UTF-8."""
    tests = replay.tests
    counts = {
        "tests": str(len(tests)),
        "failures": str(sum(test.after is Outcome.FAIL for test in tests)),
        "errors": str(replay.count(Change.NOT_JUDGED)),
        "skipped": "0",
        "time": _seconds(sum(test.seconds for test in tests)),
    }
    name = _text(replay.campaign)
    top = ET.Element("testsuites", {"name": SUITE, **counts})
    suite = ET.SubElement(top, "testsuite", {"name": name, **counts})
    parts = {"driver": replay.driver, "simulator": replay.simulator}
    _add_properties(suite, {part: str(described["class"]) for part, described in parts.items()})
    for test in tests:
        about = {"classname": name, "name": f"test {test.test_id}", "time": _seconds(test.seconds)}
        _add_outcome(ET.SubElement(suite, "testcase", about), test)
    ET.indent(top)
    document: bytes = ET.tostring(top, encoding="utf-8", xml_declaration=True)
    return document + b"\n"


def _add_outcome(case: ET.Element, test: Replayed) -> None:
    properties = {
        "change": str(test.change),
        "outcome": str(test.after),
        "outcome_before": str(test.before),
        "moobd": _metres(test.moobd_after),
        "moobd_before": _metres(test.moobd_before),
        "length": _metres(test.length),
        "duration": _seconds(test.duration),
    }
    _add_properties(case, properties)
    if test.after is Outcome.PASS:
        return
    text = _text(f"{test.change}: {test.reason}")
    tag = "failure" if test.after is Outcome.FAIL else "error"
    ET.SubElement(case, tag, {"type": str(test.after), "message": text}).text = text


def _add_properties(parent: ET.Element, values: Mapping[str, str]) -> None:
    properties = ET.SubElement(parent, "properties")
    for name, value in values.items():
        ET.SubElement(properties, "property", {"name": name, "value": _text(value)})


def _text(text: str) -> str:
    """A text for XML: characters that it cannot hold are escaped as in Python."""
    return _NO_XML.sub(lambda match: ascii(match[0])[1:-1], text)


def _metres(value: float | None) -> str:
    return "" if value is None else f"{value:.4f}"


def _seconds(value: float) -> str:
    return f"{value:.3f}"
