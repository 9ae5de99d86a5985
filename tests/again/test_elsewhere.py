"""Roads driven again by other parts: what is said of them, and what is kept."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from repeats import redriven

from frenetic.again.rerun import Rerun, elsewhere, read_reruns, rerun
from frenetic.again.verdicts import Change, Repeats
from frenetic.analysis.failures import Failure
from frenetic.analysis.segments import segment_of
from frenetic.campaign import CampaignStore
from frenetic.drivers import Driver, Planner
from frenetic.oracle import judge
from frenetic.outcome import Outcome
from frenetic.report.elsewhere import pictures_of, write_elsewhere
from frenetic.road import Pose, Road
from frenetic.simulators import Drive, EmbeddedSimulator, Rules, Vehicle
from frenetic.testing import DummyDriver, DummySimulator

OTHER_CAR = Vehicle(mass=1500.0, yaw_inertia=2500.0, front_axle=1.4, rear_axle=1.3, width=1.85)


pytest_plugins = ["searched_campaign"]


@pytest.fixture
def campaign(searched_campaign: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(searched_campaign, tmp_path / "c"))


def failures(folder: Path) -> list[int]:
    with CampaignStore.open(folder) as store:
        return [record.candidate.id for record in store.tests(Outcome.FAIL)]


def driven(folder: Path) -> list[int]:
    with CampaignStore.open(folder) as store:
        return [test.id for test in store.tests() if test.outcome.is_driven]


def in_other_car(folder: Path) -> Rerun:
    simulator = EmbeddedSimulator(vehicle=OTHER_CAR, friction=0.9)
    return rerun(folder, simulator, Planner(), tests=failures(folder))


def test_in_the_same_simulator_all_fail_again_at_the_same_place(campaign: Path) -> None:
    found = rerun(campaign, EmbeddedSimulator(), Planner())
    assert found.count(Change.FAILS_AGAIN) == found.same == len(found.tests) >= 4
    assert all(drive.is_alike for drive in found.drives)
    assert found.correlation is not None
    assert found.correlation.spearman == pytest.approx(1.0)
    assert found.correlation.pairs == len(found.tests)
    assert not found.passed, "a road on which the driver fails is no success, however old"
    with CampaignStore.open(campaign) as store:
        assert elsewhere([found], store.config) == []


def test_where_nothing_limits_all_pass_now(campaign: Path) -> None:
    calm = EmbeddedSimulator(rules=Rules(speed_limit=25.0))
    found = rerun(campaign, calm, Planner())
    assert found.count(Change.PASSES_NOW) == len(found.tests)
    assert found.passed
    assert found.rules.speed_limit == 25.0


def test_the_same_failure_is_at_the_same_place_with_the_same_mechanism(campaign: Path) -> None:
    simulator = EmbeddedSimulator(friction=0.97)
    found = rerun(campaign, simulator, Planner())
    with CampaignStore.open(campaign) as store:
        for one in found.drives:
            test, drive = store.test(one.test_id), one.test.drive
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
            assert one.is_alike is is_same
            assert one.match is not None
    document: Any = found.as_json()
    assert 0 < document["matches"]["same failure"] < len(found.tests)
    assert sum(document["matches"].values()) == document["changes"]["fails again"]
    (kept,) = read_reruns(campaign)
    assert str(kept) == str(found)
    test = found.tests[0].recorded
    passed = Repeats(test, (redriven({}, Outcome.PASS, 1.0, test=test),))
    far = redriven({}, Outcome.FAIL, -1.0, 500.0, "left", test=test)
    otherwise = Repeats(test, (far,))
    told = str(replace(found, tests=(otherwise, passed, otherwise)))
    assert told == "2 fail again (2 elsewhere), 1 passes now"
    assert otherwise.verdict == "fails again, elsewhere"


def test_drives_are_judged_by_the_box_of_the_other_car(campaign: Path) -> None:
    found = in_other_car(campaign)
    assert found.car.width == 1.85
    with CampaignStore.open(campaign) as store:
        for one in found.drives:
            drive = one.test.drive
            assert drive is not None
            result = judge(store.test(one.test_id).road, drive)
            assert result.outcome is one.outcome
            assert result.moobd == pytest.approx(one.moobd, abs=1e-3)


def test_a_driver_that_is_fixed_fixes_all(campaign: Path) -> None:
    found = rerun(campaign, EmbeddedSimulator(), Planner(aggression=0.5))
    assert sorted(test.id for test in found.tests) == failures(campaign)
    assert found.count(Change.PASSES_NOW) == len(found.tests)
    assert found.passed
    assert found.same == 0
    for drive in found.drives:
        assert drive.recorded.moobd is not None
        assert drive.moobd is not None
        assert drive.recorded.moobd < 0.0 < drive.moobd


def test_a_worse_driver_fails_newly(campaign: Path) -> None:
    found = rerun(campaign, EmbeddedSimulator(), Planner(aggression=2.0), tests=driven(campaign))
    assert found.count(Change.FAILS_NOW) > 10
    newly = [test for test in found.tests if test.change is Change.FAILS_NOW]
    assert {test.recorded.outcome for test in newly} == {Outcome.PASS}


def test_roads_are_driven_where_they_lay(campaign: Path) -> None:
    poses: list[Pose] = []

    class Watching(DummySimulator):
        def drive(self, road: Road, driver: Driver) -> Drive:
            poses.append(road.pose)
            return super().drive(road, driver)

    rerun(campaign, Watching(), DummyDriver(), tests=driven(campaign))
    with CampaignStore.open(campaign) as store:
        recorded = {test.attempt.pose for test in store.tests() if test.outcome.is_driven}
    assert set(poses) == recorded


class Unreliable(DummySimulator):
    def drive(self, road: Road, driver: Driver) -> Drive:
        return replace(super().drive(road, driver), error="no connection")


def test_what_broke_is_not_judged(campaign: Path) -> None:
    found = rerun(campaign, Unreliable(), DummyDriver(), tests=driven(campaign))
    assert found.count(Change.NOT_JUDGED) == len(found.tests) == 60, "however many break in a row"
    assert found.correlation is None
    assert {drive.reason for drive in found.drives} == {"no connection"}
    assert not found.passed


# What is kept


def test_kept_is_what_was_found(campaign: Path) -> None:
    found = in_other_car(campaign)
    (kept,) = read_reruns(campaign)
    assert kept.as_json() == found.as_json()
    for one, other in zip(kept.drives, found.drives, strict=True):
        here, there = one.test.trajectory, other.test.trajectory
        assert here is not None
        assert there is not None
        assert (here.to_rows() == there.to_rows()).all()


def there(campaign: Path) -> list[Rerun]:
    with CampaignStore.open(campaign) as store:
        return elsewhere(read_reruns(campaign), store.config)


def test_another_simulator_is_added_and_other_tests_are_put_together(campaign: Path) -> None:
    ids = failures(campaign)
    first = in_other_car(campaign)
    for chosen in (ids[2:], ids[:1]):
        rerun(campaign, EmbeddedSimulator(friction=0.9), Planner(), tests=chosen)
    one, other = there(campaign)
    assert (one.key, one.as_json()) == (first.key, first.as_json())
    assert [test.id for test in other.tests] == [*ids[2:], ids[0]]
    assert other.missing == 0


def test_of_several_drives_of_a_test_the_last_judged_ones_count(campaign: Path) -> None:
    first, second, *_ = failures(campaign)
    for tests, works in (([first, second], True), ([first], False), ([second, first], False)):
        Moody.works = works
        rerun(campaign, Moody(), DummyDriver(), tests=tests)
    (kept,) = there(campaign)
    assert [one.id for one in kept.tests] == [first, second]
    assert [one.change for one in kept.tests] == [Change.PASSES_NOW] * 2


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
        gallery = write_elsewhere(store, found)
    folder = campaign / pictures_of(found)
    assert gallery == folder / "gallery.png"
    names = {path.name for path in folder.iterdir()}
    assert names == {"gallery.png", *(f"test-{i:05d}.png" for i in failures(campaign))}
    assert all(path.read_bytes()[:4] == b"\x89PNG" for path in folder.iterdir())


def test_no_picture_of_what_was_not_driven(campaign: Path) -> None:
    class Refusing(DummySimulator):
        def drive(self, road: Road, driver: Driver) -> Drive:
            raise OSError("no connection")

    found = rerun(campaign, Refusing(), DummyDriver(), tests=failures(campaign)[:1])
    with CampaignStore.open(campaign) as store:
        assert write_elsewhere(store, found) is None
    assert found.drives[0].test.trajectory is None
