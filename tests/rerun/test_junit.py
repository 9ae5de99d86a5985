"""The JUnit file of a rerun."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st
from junitparser import Error, Failure, JUnitXml
from repeats import recorded as recorded_test
from repeats import redriven

from frenetic.oracle.drive import Rules
from frenetic.oracle.outcome import Outcome
from frenetic.rerun.junit import junit, write_junit
from frenetic.rerun.reruns import Rerun
from frenetic.rerun.stability import Repeats


def rerun_once(
    number: int, before: Outcome, after: Outcome, reason: str = "Car reached"
) -> Repeats:
    moobds = {Outcome.FAIL: -2.0, Outcome.PASS: 1.25}
    test = recorded_test(before, id=number)
    drive = redriven({}, after, moobds.get(after), test=test, reason=reason, duration=20.5)
    return Repeats(test, (drive,))


FAIL, PASS = Outcome.FAIL, Outcome.PASS
TESTS = (
    rerun_once(7, FAIL, PASS),
    rerun_once(8, FAIL, FAIL, 'Car <left> & "gone"'),
    rerun_once(9, PASS, FAIL),
    rerun_once(10, FAIL, Outcome.ERROR, "broke\x00\ud800"),
    rerun_once(11, FAIL, Outcome.INVALID),
)
RERUN = Rerun("night", {"class": "m:Driver"}, {"class": "m:Sim"}, Rules(), len(TESTS), TESTS)


def test_a_junit_parser_finds_every_road(tmp_path: Path) -> None:
    path = tmp_path / "rerun.xml"
    write_junit(RERUN, path)
    document = JUnitXml.fromfile(str(path))
    (suite,) = document
    for counts in (suite, document):
        assert (counts.tests, counts.failures, counts.errors) == (5, 2, 2)
    assert (suite.name, suite.time, suite.skipped) == ("night", 1.25, 0)
    cases = {case.name: case for case in suite}
    assert set(cases) == {f"test {number}" for number in (7, 8, 9, 10, 11)}
    assert (cases["test 7"].is_passed, cases["test 7"].time) == (True, 0.25)
    messages = {
        name: [(type(result), result.message) for result in case.result]
        for name, case in cases.items()
    }
    assert messages["test 8"] == [(Failure, 'fails again (1 same place): Car <left> & "gone"')]
    assert messages["test 10"] == [(Error, "not judged: broke\\x00\\ud800")]
    assert [kind for kind, _ in messages["test 11"]] == [Error]
    assert messages["test 9"][0][1].startswith("fails now")
    times = [case.get("time") for case in ET.parse(path).iter("testcase")]
    assert times == ["0.250"] * 5  # in s, to the millisecond
    suite_properties, test_7_properties, *_ = (
        {p.get("name"): p.get("value") for p in element}
        for element in ET.parse(path).iter("properties")
    )
    assert suite_properties == {"driver": "m:Driver", "simulator": "m:Sim"}
    assert test_7_properties == {
        "change": "passes now",
        "failed": "0 of 1",
        "outcome": "PASS",
        "outcome_before": "FAIL",
        "criteria": "",
        "moobd": "1.2500",
        "moobd_before": "-1.0000",
        "length": "230.0000",
        "duration": "20.500",
    }


# Text of a driver's message or a folder's name, with surrogates and control characters.
any_text = st.text(st.characters(exclude_categories=()), max_size=60)


@given(any_text, any_text)
def test_any_text_gives_a_valid_file(reason: str, name: str) -> None:
    test = rerun_once(7, FAIL, Outcome.ERROR, reason)
    content = junit(replace(RERUN, campaign=name, tests=(test,)))
    document = ET.fromstring(content)
    (error,) = document.iter("error")
    printable = "".join(c for c in reason if c.isalnum() and c.isascii())
    message = error.get("message", "")
    assert (
        printable in "".join(c for c in message if c.isalnum() and c.isascii()) or "\\" in message
    )
    (suite,) = JUnitXml.fromstring(content)
    assert suite.errors == 1
