"""A rerun as a JUnit XML file, one test case per road."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final

from frenetic._support.files import write_file
from frenetic.conditions.condition import as_text
from frenetic.errors import CampaignError
from frenetic.rerun.reruns import Rerun
from frenetic.rerun.stability import Change, Repeat, Repeats, matches_text

SUITE: Final = "frenetic rerun"
"""Name of the root element of a file."""
_FORBIDDEN_CHARACTER: Final = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""A character that XML 1.0 cannot hold, not even escaped."""
_FAILING_CHANGES: Final = (Change.FAILS_AGAIN, Change.FAILS_NOW)
"""Changes of a test on whose road the driver fails now."""
_SECOND_DIGITS: Final = 3
_METRE_DIGITS: Final = 4


def write_junit(rerun: Rerun, path: Path | str) -> None:
    """Write a rerun as a JUnit XML file.

    A road on which the driver fails is a failure; a road that could not be judged is an error. The
    attribute ``time`` is wall time, in s. A test case has the recorded drive and the worst new
    drive as properties: outcomes, MOOBDs (``moobd``, ``moobd_before``: the minimum oob distance,
    negative outside the lane, in m), the road's ``length`` in m, and ``duration``, the simulated
    time of the worst new drive in s.

    Raises:
        CampaignError: the file cannot be written.
    """
    write_file(path, junit(rerun), remedy="choose another file", error=CampaignError)


def junit(rerun: Rerun) -> bytes:
    """Return a rerun as JUnit XML in UTF-8."""
    counts = {
        "tests": str(len(rerun.tests)),
        "failures": str(sum(repeats.change in _FAILING_CHANGES for repeats in rerun.tests)),
        "errors": str(rerun.count(Change.NOT_JUDGED)),
        "skipped": "0",
        "time": _decimals(_wall_time(rerun.drives), _SECOND_DIGITS),
    }
    name = xml_text(rerun.campaign)
    top = ET.Element("testsuites", {"name": SUITE, **counts})
    suite = ET.SubElement(top, "testsuite", {"name": name, **counts})
    parts = {"driver": rerun.driver, "simulator": rerun.simulator}
    add_properties(suite, {part: str(described["class"]) for part, described in parts.items()})
    for repeats in rerun.tests:
        attributes = {
            "classname": name,
            "name": f"test {repeats.id}",
            "time": _decimals(_wall_time(repeats.drives), _SECOND_DIGITS),
        }
        _add_outcome(ET.SubElement(suite, "testcase", attributes), repeats)
    ET.indent(top)
    document: bytes = ET.tostring(top, encoding="utf-8", xml_declaration=True)
    return document + b"\n"


def _wall_time(drives: Iterable[Repeat]) -> float:
    """Return the wall time of drives, in s."""
    return sum(drive.test.seconds for drive in drives)


def _add_outcome(case: ET.Element, repeats: Repeats) -> None:
    """Add properties to a test case, and its failure or error.

    The worst drive stands for all: the first that failed, or else the passing drive of lowest
    MOOBD, or else the first drive.
    """
    matches = matches_text(repeats.drives)
    judged = [drive for drive in repeats.drives if drive.outcome.is_driven]
    # All failures have the margin -inf; of equal margins, `min` takes the first.
    worst = min(judged or repeats.drives, key=lambda drive: drive.margin)
    candidate = repeats.recorded.candidate
    conditions = as_text(worst.conditions)
    properties = {
        "change": str(repeats.change),
        **({"conditions": conditions} if conditions else {}),
        **({"match": matches} if matches else {}),
        "failed": f"{repeats.failed} of {repeats.judged}",
        "outcome": str(worst.outcome),
        "outcome_before": str(repeats.recorded.outcome),
        "criteria": ", ".join(finding.criterion for finding in worst.test.result.findings),
        "moobd": _decimals(worst.moobd, _METRE_DIGITS),
        "moobd_before": _decimals(repeats.recorded.moobd, _METRE_DIGITS),
        "length": _decimals(candidate.length, _METRE_DIGITS),
        "duration": _decimals(worst.duration, _SECOND_DIGITS),
    }
    add_properties(case, properties)
    if repeats.change not in (*_FAILING_CHANGES, Change.NOT_JUDGED):
        return
    text = xml_text(f"{repeats.change}{f' ({matches})' if matches else ''}: {worst.reason}")
    tag = "failure" if repeats.change in _FAILING_CHANGES else "error"
    ET.SubElement(case, tag, {"type": str(worst.outcome), "message": text}).text = text


def add_properties(parent: ET.Element, values: Mapping[str, str]) -> None:
    """Add an element with properties, given as name -> value."""
    properties = ET.SubElement(parent, "properties")
    for name, value in values.items():
        ET.SubElement(properties, "property", {"name": name, "value": xml_text(value)})


def xml_text(text: str) -> str:
    """Return a text in which characters that XML cannot hold are escaped as in Python."""
    return _FORBIDDEN_CHARACTER.sub(lambda match: ascii(match[0])[1:-1], text)


def _decimals(value: float | None, digits: int) -> str:
    """Return a number with ``digits`` decimals; an empty text for None."""
    return "" if value is None else f"{value:.{digits}f}"
