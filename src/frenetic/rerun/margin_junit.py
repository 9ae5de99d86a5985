"""Margins as a JUnit XML file, one test case per quantity."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from frenetic._support.files import write_file
from frenetic.errors import CampaignError
from frenetic.rerun.junit import add_properties, xml_text
from frenetic.rerun.margin_quantities import RequiredAmount
from frenetic.rerun.margin_results import ConditionMargin, Margins

SUITE: Final = "frenetic margin"
"""Name of the root element of a file."""


def write_margin_junit(
    margins: Margins, at_least: Sequence[RequiredAmount], path: Path | str
) -> None:
    """Write margins as a JUnit XML file: a margin that is smaller than required is a failure.

    A test case has the margin in words as properties: ``usual``, ``amount`` where the driver begins
    to fail on 5 % of the roads, ``interval``, ``never`` and, where it is required, ``at_least``.

    Args:
        margins: the margins.
        at_least: amounts that the driver has to bear.
        path: path of the file; an existing file is replaced.

    Raises:
        CampaignError: the file cannot be written.
        ValueError: a condition was not measured to the side of its amount.
    """
    content = margin_junit(margins, at_least)
    write_file(path, content, remedy="choose another file", error=CampaignError)


def margin_junit(margins: Margins, at_least: Sequence[RequiredAmount]) -> bytes:
    """Return margins as JUnit XML in UTF-8, see `write_margin_junit`."""
    shortfalls = margins.shortfalls(at_least)
    counts = {
        "tests": str(len(margins.margins)),
        "failures": str(len(shortfalls)),
        "errors": "0",
        "skipped": "0",
    }
    name = xml_text(margins.domain)
    top = ET.Element("testsuites", {"name": SUITE, **counts})
    suite = ET.SubElement(top, "testsuite", {"name": name, **counts})
    parts = {"driver": margins.driver, "simulator": margins.simulator}
    add_properties(suite, {part: str(described["class"]) for part, described in parts.items()})
    required = {
        margins.named(condition, amount).quantity.key: amount for condition, amount in at_least
    }
    for margin in margins.margins:
        key = margin.quantity.key
        case = ET.SubElement(suite, "testcase", {"classname": name, "name": key})
        add_properties(case, _properties(margin, required.get(key)))
        if key in shortfalls:
            text = xml_text(shortfalls[key])
            ET.SubElement(case, "failure", {"type": "margin", "message": text}).text = text
    ET.indent(top)
    document: bytes = ET.tostring(top, encoding="utf-8", xml_declaration=True)
    return document + b"\n"


def _properties(margin: ConditionMargin, required: float | None) -> dict[str, str]:
    """Return the properties of a margin's test case.

    Args:
        margin: the margin.
        required: amount that the driver has to bear; None if nothing is required.
    """
    quantity = margin.quantity
    values = {
        "usual": quantity.text(quantity.usual),
        "amount": margin.amount_text(),
        "interval": margin.interval_text(),
        "never": f"{margin.never.count} of {margin.never.total}",
        "most_demanding": margin.least_text(),
        "at_least": "" if required is None else quantity.text(required),
    }
    return {name: text for name, text in values.items() if text}
