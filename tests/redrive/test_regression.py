"""Replays: what became of a campaign's roads, and the JUnit file that says so."""

from __future__ import annotations

import math
import signal
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from junitparser import Error, Failure, JUnitXml
from redrives import forget_redrives, redriven
from redrives import recorded as recorded_test

from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.drivers import Driver, Planner
from frenetic.errors import CampaignError
from frenetic.outcome import Outcome
from frenetic.redrive.drives import RedriveProgress
from frenetic.redrive.record import Change, Redrive
from frenetic.redrive.regression import (
    Replay,
    junit,
    replay,
    write_junit,
)
from frenetic.road import Pose, Road
from frenetic.search import Frenetic2021
from frenetic.simulators import Drive, EmbeddedSimulator
from frenetic.simulators.worlds import USUAL
from frenetic.testing import DummyDriver, DummySimulator

pytest_plugins = ["searched_campaign"]


@pytest.fixture
def campaign(searched_campaign: Path) -> Path:
    """The campaign, as nobody drove it again."""
    forget_redrives(searched_campaign)
    return searched_campaign


def recorded(folder: Path, outcome: Outcome) -> dict[int, float | None]:
    with CampaignStore.open(folder) as store:
        return {record.candidate.id: record.moobd for record in store.tests(outcome)}


# What became of the roads


def test_the_same_parts_give_the_same_results(campaign: Path) -> None:
    found = replay(campaign, EmbeddedSimulator(), Planner(), everything=True)
    assert len(found.tests) == found.same == 60
    assert [test.test_id for test in found.tests] == sorted(test.test_id for test in found.tests)
    failures = recorded(campaign, Outcome.FAIL)
    assert found.count(Change.STILL_FAILING) == len(failures) > 0
    assert found.count(Change.STILL_PASSING) == 60 - len(failures)
    assert not found.passed, "a road on which the driver fails is no success, however old"


def test_a_driver_that_is_fixed_fixes_all(campaign: Path) -> None:
    found = replay(campaign, EmbeddedSimulator(), Planner(aggression=0.5))
    assert {test.test_id for test in found.tests} == set(recorded(campaign, Outcome.FAIL))
    assert found.count(Change.FIXED) == len(found.tests)
    assert found.passed
    assert found.same == 0
    for test in found.tests:
        assert (test.before, test.after) == (Outcome.FAIL, Outcome.PASS)
        assert test.moobd_before is not None
        assert test.moobd_after is not None
        assert test.moobd_before < 0.0 < test.moobd_after


def test_a_worse_driver_fails_newly(campaign: Path) -> None:
    found = replay(campaign, EmbeddedSimulator(), Planner(aggression=2.0), everything=True)
    assert found.count(Change.NEWLY_FAILING) > 10
    newly = [test for test in found.tests if test.change is Change.NEWLY_FAILING]
    assert {test.test_id for test in newly} <= set(recorded(campaign, Outcome.PASS))


def test_roads_are_driven_where_they_lay(campaign: Path) -> None:
    driven: list[Pose] = []

    class Watching(DummySimulator):
        def drive(self, road: Road, driver: Driver) -> Drive:
            driven.append(road.pose)
            return super().drive(road, driver)

    replay(campaign, Watching(), DummyDriver(), everything=True)
    with CampaignStore.open(campaign) as store:
        poses = {test.attempt.pose for test in store.tests() if test.outcome.is_driven}
    assert set(driven) == poses


class Unreliable(DummySimulator):
    """Breaks in every drive."""

    def drive(self, road: Road, driver: Driver) -> Drive:
        return replace(super().drive(road, driver), error="no connection")


def test_what_cannot_be_judged_is_no_success(campaign: Path) -> None:
    found = replay(campaign, Unreliable(), DummyDriver(), everything=True)
    assert found.count(Change.NOT_JUDGED) == len(found.tests) == 60, "however many break in a row"
    assert {test.reason for test in found.tests} == {"no connection"}
    assert not found.passed


def test_ctrl_c_ends_it_and_says_what_is_missing(campaign: Path) -> None:
    def interrupt(progress: RedriveProgress) -> None:
        if progress.tests == 4:
            signal.raise_signal(signal.SIGINT)

    found = replay(
        campaign, DummySimulator(), DummyDriver(), everything=True, on_progress=interrupt
    )
    assert len(found.tests) == 4
    assert found.missing == 56
    assert all(test.after is Outcome.PASS for test in found.tests)
    assert not found.passed, "what was not driven is no success"


def test_a_campaign_without_failures_is_a_success(tmp_path: Path) -> None:
    Campaign(
        strategy=Frenetic2021(seed=1, max_redraws=10),
        simulator=DummySimulator(),
        driver=DummyDriver(),
        budget=Budget(simulations=3),
        folder=tmp_path,
    ).run()
    found = replay(tmp_path, DummySimulator(), DummyDriver())
    assert found.tests == ()
    assert found.passed


# JUnit


def became(number: int, before: Outcome, after: Outcome, reason: str = "Car reached") -> Redrive:
    moobds = {Outcome.FAIL: -2.0, Outcome.PASS: 1.25}
    test = recorded_test(before, id=number)
    return redriven(USUAL, after, moobds.get(after), test=test, reason=reason, duration=20.5)


FAIL, PASS = Outcome.FAIL, Outcome.PASS
TESTS = (
    became(7, FAIL, PASS),
    became(8, FAIL, FAIL, 'Car <left> & "gone"'),
    became(9, PASS, FAIL),
    became(10, FAIL, Outcome.ERROR, "broke\x00\ud800"),
    became(11, FAIL, Outcome.INVALID),
)
REPLAY = Replay("night", {"class": "m:Driver"}, {"class": "m:Sim"}, TESTS, 0)


def test_a_junit_parser_finds_every_road(tmp_path: Path) -> None:
    path = tmp_path / "replay.xml"
    write_junit(REPLAY, path)
    document = JUnitXml.fromfile(str(path))
    (suite,) = document
    assert (suite.tests, suite.failures, suite.errors, suite.skipped) == (5, 2, 2, 0)
    assert suite.name == "night"
    cases = {case.name: case for case in suite}
    assert set(cases) == {f"test {number}" for number in (7, 8, 9, 10, 11)}
    assert cases["test 7"].is_passed
    assert cases["test 7"].time == 0.25
    ((failure,), (error,)) = cases["test 8"].result, cases["test 10"].result
    assert isinstance(failure, Failure)
    assert failure.message == 'still failing (same place): Car <left> & "gone"'
    assert isinstance(error, Error)
    assert error.message == "not judged: broke\\x00\\ud800"
    assert [type(one) for one in cases["test 11"].result] == [Error]
    assert cases["test 9"].result[0].message.startswith("newly failing")


def test_properties_say_what_was_before() -> None:
    document = ET.fromstring(junit(REPLAY))
    case = document.find("testsuite/testcase[@name='test 7']")
    assert case is not None
    properties = {p.get("name"): p.get("value") for p in case.iter("property")}
    assert properties == {
        "change": "fixed",
        "outcome": "PASS",
        "outcome_before": "FAIL",
        "moobd": "1.2500",
        "moobd_before": "-1.0000",
        "length": "230.0000",
        "duration": "20.500",
    }
    suite = document.find("testsuite/properties")
    assert suite is not None
    assert {p.get("name"): p.get("value") for p in suite} == {
        "driver": "m:Driver",
        "simulator": "m:Sim",
    }


def test_the_numbers_are_those_of_the_test_cases() -> None:
    document = ET.fromstring(junit(REPLAY))
    for element in (document, *document.iter("testsuite")):
        assert element.get("tests") == str(len(list(element.iter("testcase"))))
        assert element.get("failures") == str(len(list(element.iter("failure"))))
        assert element.get("errors") == str(len(list(element.iter("error"))))
        times = [float(case.get("time", "nan")) for case in element.iter("testcase")]
        assert math.isclose(float(element.get("time", "nan")), sum(times), abs_tol=1e-3)


# Everything a driver's message or a folder's name may hold, half characters and controls included.
any_text = st.text(st.characters(exclude_categories=()), max_size=60)


@given(any_text, any_text)
def test_no_text_breaks_the_file(reason: str, name: str) -> None:
    test = became(7, FAIL, Outcome.ERROR, reason)
    content = junit(replace(REPLAY, campaign=name, tests=(test,)))
    document = ET.fromstring(content)
    (error,) = document.iter("error")
    printable = "".join(c for c in reason if c.isalnum() and c.isascii())
    said = error.get("message", "")
    assert printable in "".join(c for c in said if c.isalnum() and c.isascii()) or "\\" in said
    (suite,) = JUnitXml.fromstring(content)
    assert suite.errors == 1


def test_a_file_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="choose another file with --junit"):
        write_junit(REPLAY, tmp_path / "nowhere" / "a.xml")
    assert list(tmp_path.iterdir()) == []
