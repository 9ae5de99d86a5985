"""Regression: a campaign's roads, driven with another driver, version or simulator."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Unpack

from frenetic._support.files import write_file
from frenetic.campaign.store import CampaignStore, JSONValue
from frenetic.drivers import Driver
from frenetic.errors import CampaignError
from frenetic.outcome import Outcome
from frenetic.redrive.drives import (
    RedriveOptions,
    RedriveProgress,
    campaign_tester,
    drive_again,
)
from frenetic.redrive.record import (
    Change,
    Purpose,
    Redrive,
    Run,
    matches_document,
    matches_text,
)
from frenetic.simulators.simulator import Simulator

SUITE: Final = "frenetic regression"
"""Name of the suite in a JUnit file."""
# Characters that XML 1.0 cannot hold, even escaped.
_NO_XML: Final = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


@dataclass(frozen=True)
class Replay:
    """A campaign's tests, driven again."""

    campaign: str
    """Name of its folder."""
    driver: Mapping[str, JSONValue]
    """In the form of a campaign's description."""
    simulator: Mapping[str, JSONValue]
    """In the form of a campaign's description."""
    tests: tuple[Redrive, ...]
    """Drives in the order of the tests' ids."""
    missing: int
    """Number of tests left undriven by Ctrl-C."""

    def count(self, change: Change) -> int:
        """Tests with this change."""
        return sum(test.change is change for test in self.tests)

    @property
    def passed(self) -> bool:
        """Whether all were driven again and none failed."""
        bad = (Change.STILL_FAILING, Change.NEWLY_FAILING, Change.NOT_JUDGED)
        return self.missing == 0 and not any(test.change in bad for test in self.tests)

    def __str__(self) -> str:
        counts = [(change, self.count(change)) for change in Change]
        text = ", ".join(f"{number} {change}" for change, number in counts if number)
        matches = matches_text(self.tests)
        return f"{text}; of those still failing {matches}" if matches else text

    @property
    def same(self) -> int:
        """Tests whose outcome and MOOBD are exactly as before."""
        return sum(test.is_same for test in self.tests)


def replay(
    folder: Path | str,
    simulator: Simulator,
    driver: Driver,
    *,
    everything: bool = False,
    on_progress: Callable[[RedriveProgress], None] | None = None,
    **how: Unpack[RedriveOptions],
) -> Replay:
    """Drives the failing roads of a campaign again, each where it lay on the map.

    Args:
        folder: of the campaign.
        simulator: any, not yet entered.
        driver: any.
        everything: all driven roads, not only failing ones.
        on_progress: called after every drive.
        how: see `frenetic.redrive.drives.RedriveOptions`.

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
    run = drive_again(
        folder,
        Purpose.REGRESSION,
        tester,
        records,
        on_progress=on_progress,
        **how,
    )
    return _of_run(folder, run)


def _of_run(folder: Path, run: Run) -> Replay:
    return Replay(
        campaign=folder.resolve().name,
        driver=run.driver,
        simulator=run.simulator,
        tests=tuple(sorted(run.drives, key=lambda drive: drive.test_id)),
        missing=max(run.planned - len(run.drives), 0),
    )


def replay_document(replay: Replay) -> dict[str, JSONValue]:
    """A replay as a JSON object."""
    return {
        "campaign": replay.campaign,
        "driver": dict(replay.driver),
        "simulator": dict(replay.simulator),
        "passed": replay.passed,
        "same": replay.same,
        "missing": replay.missing,
        "changes": {str(change): replay.count(change) for change in Change},
        "matches": matches_document(replay.tests),
        "tests": [
            {
                "test_id": test.test_id,
                "before": str(test.before),
                "moobd_before": test.moobd_before,
                "after": str(test.after),
                "moobd_after": test.moobd_after,
                "reason": test.reason,
                "duration": test.duration,
                "length": test.length,
                "seconds": test.test.attempt.seconds,
                "change": str(test.change),
                "match": test.match,
                "difference": test.difference,
                "is_same": test.is_same,
            }
            for test in replay.tests
        ],
    }


# JUnit


def write_junit(replay: Replay, path: Path | str) -> None:
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
        "time": _seconds(sum(test.test.attempt.seconds for test in tests)),
    }
    name = _text(replay.campaign)
    top = ET.Element("testsuites", {"name": SUITE, **counts})
    suite = ET.SubElement(top, "testsuite", {"name": name, **counts})
    parts = {"driver": replay.driver, "simulator": replay.simulator}
    _add_properties(suite, {part: str(described["class"]) for part, described in parts.items()})
    for test in tests:
        about = {
            "classname": name,
            "name": f"test {test.test_id}",
            "time": _seconds(test.test.attempt.seconds),
        }
        _add_outcome(ET.SubElement(suite, "testcase", about), test)
    ET.indent(top)
    document: bytes = ET.tostring(top, encoding="utf-8", xml_declaration=True)
    return document + b"\n"


def _add_outcome(case: ET.Element, test: Redrive) -> None:
    properties = {
        "change": str(test.change),
        **({} if test.match is None else {"match": str(test.match)}),
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
    match = "" if test.match is None else f" ({test.match})"
    text = _text(f"{test.change}{match}: {test.reason}")
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


def _seconds(value: float | None) -> str:
    return f"{value or 0.0:.3f}"
