"""A rerun as a JUnit XML file, one test case per road."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from frenetic._support.files import write_file
from frenetic.conditions.condition import as_text
from frenetic.errors import CampaignError
from frenetic.rerun.reruns import Rerun
from frenetic.rerun.stability import Change, Repeats, matches_text

SUITE: Final = "frenetic rerun"
"""Name of the root element of a file."""
# Characters that XML 1.0 cannot hold, even escaped.
_NO_XML: Final = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_FAILS: Final = (Change.FAILS_AGAIN, Change.FAILS_NOW)


def write_junit(rerun: Rerun, path: Path | str) -> None:
    """Write a rerun as a JUnit XML file.

    A road on which the driver fails is a failure; a road that could not be judged is an error. The
    recorded outcome and the MOOBDs are properties of the test case.

    Raises:
        CampaignError: the file cannot be written.
    """
    write_file(path, junit(rerun), remedy="choose another file", error=CampaignError)


def junit(rerun: Rerun) -> bytes:
    """Return a rerun as JUnit XML in UTF-8."""
    tests = rerun.tests
    counts = {
        "tests": str(len(tests)),
        "failures": str(sum(test.change in _FAILS for test in tests)),
        "errors": str(rerun.count(Change.NOT_JUDGED)),
        "skipped": "0",
        "time": _decimals(sum(drive.test.seconds for drive in rerun.drives), 3),
    }
    name = _text(rerun.campaign)
    top = ET.Element("testsuites", {"name": SUITE, **counts})
    suite = ET.SubElement(top, "testsuite", {"name": name, **counts})
    parts = {"driver": rerun.driver, "simulator": rerun.simulator}
    _add_properties(suite, {part: str(described["class"]) for part, described in parts.items()})
    for test in tests:
        seconds = sum(drive.test.seconds for drive in test.drives)
        about = {"classname": name, "name": f"test {test.id}", "time": _decimals(seconds, 3)}
        _add_outcome(ET.SubElement(suite, "testcase", about), test)
    ET.indent(top)
    document: bytes = ET.tostring(top, encoding="utf-8", xml_declaration=True)
    return document + b"\n"


def _add_outcome(case: ET.Element, test: Repeats) -> None:
    matches = matches_text(test.drives)
    judged = [drive for drive in test.drives if drive.outcome.is_driven]
    worst = min(judged or test.drives, key=lambda drive: drive.margin)
    candidate = test.recorded.candidate
    conditions = as_text(worst.conditions)
    properties = {
        "change": str(test.change),
        **({"conditions": conditions} if conditions else {}),
        **({"match": matches} if matches else {}),
        "failed": f"{test.failed} of {test.judged}",
        "outcome": str(worst.outcome),
        "outcome_before": str(test.recorded.outcome),
        "criteria": ", ".join(finding.criterion for finding in worst.test.result.findings),
        "moobd": _decimals(worst.moobd, 4),
        "moobd_before": _decimals(test.recorded.moobd, 4),
        "length": _decimals(candidate.length, 4),
        "duration": _decimals(worst.duration, 3),
    }
    _add_properties(case, properties)
    if test.change not in (*_FAILS, Change.NOT_JUDGED):
        return
    text = _text(f"{test.change}{f' ({matches})' if matches else ''}: {worst.reason}")
    tag = "failure" if test.change in _FAILS else "error"
    ET.SubElement(case, tag, {"type": str(worst.outcome), "message": text}).text = text


def _add_properties(parent: ET.Element, values: Mapping[str, str]) -> None:
    properties = ET.SubElement(parent, "properties")
    for name, value in values.items():
        ET.SubElement(properties, "property", {"name": name, "value": _text(value)})


def _text(text: str) -> str:
    """Return a text for XML, with the characters that XML cannot hold escaped as in Python."""
    return _NO_XML.sub(lambda match: ascii(match[0])[1:-1], text)


def _decimals(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"
