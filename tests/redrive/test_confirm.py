"""Failures in another simulator: what is said of them, and what is kept."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from redrives import redriven

from frenetic.analysis.failures import Failure
from frenetic.analysis.segments import segment_of
from frenetic.campaign import CampaignStore
from frenetic.drivers import Driver, Planner
from frenetic.errors import CampaignError
from frenetic.oracle import judge
from frenetic.outcome import Outcome
from frenetic.redrive.confirm import (
    Confirmation,
    confirm,
    confirmation_document,
    read_confirmations,
)
from frenetic.redrive.record import Agreement
from frenetic.report.confirmation import pictures_of, write_confirmation
from frenetic.road import Road
from frenetic.simulators import Drive, EmbeddedSimulator, Rules, Vehicle
from frenetic.simulators.worlds import USUAL
from frenetic.testing import DummyDriver, DummySimulator

OTHER_CAR = Vehicle(mass=1500.0, yaw_inertia=2500.0, front_axle=1.4, rear_axle=1.3, width=1.85)


pytest_plugins = ["searched_campaign"]


@pytest.fixture
def campaign(searched_campaign: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(searched_campaign, tmp_path / "c"))


def failures(folder: Path) -> list[int]:
    with CampaignStore.open(folder) as store:
        return [record.candidate.id for record in store.tests(Outcome.FAIL)]


def in_other_car(folder: Path) -> Confirmation:
    simulator = EmbeddedSimulator(vehicle=OTHER_CAR, friction=0.9)
    return confirm(folder, simulator, Planner(), test_ids=failures(folder))


def test_same_simulator_confirms_all_at_the_same_place(campaign: Path) -> None:
    found = confirm(campaign, EmbeddedSimulator(), Planner(), test_ids=failures(campaign))
    assert found.count(Agreement.CONFIRMED) == found.alike == len(found.tests) >= 4
    assert found.correlation is not None
    assert found.correlation.spearman == pytest.approx(1.0)
    assert found.correlation.pairs == len(found.tests)
    assert all(one.recorded.moobd == one.other.moobd for one in found.tests)


def test_world_without_limits_confirms_none(campaign: Path) -> None:
    calm = EmbeddedSimulator(rules=Rules(speed_limit=25.0))
    found = confirm(campaign, calm, Planner(), test_ids=failures(campaign))
    assert found.count(Agreement.NOT_CONFIRMED) == len(found.tests)
    assert found.alike == 0
    assert found.rules.speed_limit == 25.0


def test_confirmed_is_the_same_failure_at_the_same_place(campaign: Path) -> None:
    simulator = EmbeddedSimulator(friction=0.97)
    found = confirm(campaign, simulator, Planner(), test_ids=failures(campaign))
    with CampaignStore.open(campaign) as store:
        for one in found.tests:
            test, drive = store.test(one.test_id), found.drive(one)
            assert drive is not None
            assert test.drive is not None
            assert test.departure is not None
            result = judge(test.road, drive)
            assert result.departure is not None
            here, there = (
                Failure.of(segment_of(test.road, driven, departure), id=1, moobd=0.0)
                for driven, departure in ((test.drive, test.departure), (drive, result.departure))
            )
            is_same = (
                abs(result.departure.distance - test.departure.distance) <= 30.0
                and result.departure.side == test.departure.side
                and float(np.linalg.norm(here.vector() - there.vector())) <= 2.0
            )
            assert (one.agreement is Agreement.CONFIRMED) is is_same
            assert one.match is not None
    assert found.count(Agreement.CONFIRMED) > 0
    assert found.count(Agreement.FAILING_OTHERWISE) > 0
    document: Any = confirmation_document(found)
    assert document["confirmed"] == document["alike"] == document["matches"]["same failure"]
    assert sum(document["matches"].values()) == len(found.tests)
    (kept,) = read_confirmations(campaign)
    assert str(kept) == str(found)
    test = found.tests[0].recorded
    passed = redriven(USUAL, Outcome.PASS, 1.0, test=test)
    otherwise = redriven(USUAL, Outcome.FAIL, -1.0, 500.0, "left", test=test)
    told = str(replace(found, tests=(otherwise, passed, otherwise)))
    assert told == "2 failing otherwise (2 elsewhere), 1 not confirmed"


def test_drives_are_judged_by_the_box_of_the_other_car(campaign: Path) -> None:
    found = in_other_car(campaign)
    assert found.car.width == 1.85
    with CampaignStore.open(campaign) as store:
        for one in found.tests:
            drive = found.drive(one)
            assert drive is not None
            result = judge(store.test(one.test_id).road, drive)
            assert result.outcome is one.other.outcome
            assert result.moobd == pytest.approx(one.other.moobd, abs=1e-3)


class Unreliable(DummySimulator):
    def drive(self, road: Road, driver: Driver) -> Drive:
        return replace(super().drive(road, driver), error="no connection")


def test_what_broke_is_not_judged(campaign: Path) -> None:
    found = confirm(campaign, Unreliable(), DummyDriver(), test_ids=failures(campaign)[:2])
    assert [one.agreement for one in found.tests] == [Agreement.NOT_JUDGED] * 2
    assert found.correlation is None
    assert found.tests[0].reason == "no connection"


def test_only_failures_can_be_confirmed(campaign: Path) -> None:
    with CampaignStore.open(campaign) as store:
        passed = next(iter(store.tests(Outcome.PASS))).candidate.id
    with pytest.raises(CampaignError, match=f"test {passed} is PASS: only a failure"):
        confirm(campaign, EmbeddedSimulator(), Planner(), test_ids=[passed])


# What is kept


def test_kept_is_what_was_found(campaign: Path) -> None:
    assert read_confirmations(campaign) == ()
    found = in_other_car(campaign)
    (kept,) = read_confirmations(campaign)
    assert confirmation_document(kept) == confirmation_document(found)
    for one, other in zip(kept.tests, found.tests, strict=True):
        here, there = one.test.trajectory, other.test.trajectory
        assert here is not None
        assert there is not None
        assert (here.to_rows() == there.to_rows()).all()


def test_another_simulator_is_added_and_other_tests_are_put_together(campaign: Path) -> None:
    ids = failures(campaign)
    first = in_other_car(campaign)
    for chosen in (ids[2:], ids[:1]):
        confirm(campaign, EmbeddedSimulator(), Planner(), test_ids=chosen)
    one, other = read_confirmations(campaign)
    assert (one.key, confirmation_document(one)) == (first.key, confirmation_document(first))
    assert [test.test_id for test in other.tests] == [*ids[2:], ids[0]]
    assert other.count(Agreement.CONFIRMED) == len(ids) - 1


def test_of_several_drives_of_a_test_the_last_judged_one_counts(campaign: Path) -> None:
    first, second, *_ = failures(campaign)
    for test_ids, works in (([first, second], True), ([first], False), ([second, first], False)):
        Moody.works = works
        confirm(campaign, Moody(), DummyDriver(), test_ids=test_ids)
    (kept,) = read_confirmations(campaign)
    assert [one.test_id for one in kept.tests] == [first, second]
    assert [one.agreement for one in kept.tests] == [Agreement.NOT_CONFIRMED] * 2


class Moody(DummySimulator):
    """Breaks unless it works."""

    works = True

    def drive(self, road: Road, driver: Driver) -> Drive:
        drive = super().drive(road, driver)
        return drive if Moody.works else replace(drive, error="no connection")


# Pictures


def test_both_paths_in_one_picture_per_road_and_a_gallery(campaign: Path) -> None:
    found = in_other_car(campaign)
    with CampaignStore.open(campaign) as store:
        gallery = write_confirmation(store, found)
    folder = campaign / pictures_of(found)
    assert gallery == folder / "gallery.png"
    names = {path.name for path in folder.iterdir()}
    assert names == {"gallery.png", *(f"test-{i:05d}.png" for i in failures(campaign))}
    assert all(path.read_bytes()[:4] == b"\x89PNG" for path in folder.iterdir())


def test_no_picture_of_what_was_not_driven(campaign: Path) -> None:
    class Refusing(DummySimulator):
        def drive(self, road: Road, driver: Driver) -> Drive:
            raise OSError("no connection")

    found = confirm(campaign, Refusing(), DummyDriver(), test_ids=failures(campaign)[:1])
    with CampaignStore.open(campaign) as store:
        assert write_confirmation(store, found) is None
    assert found.tests[0].test.trajectory is None
