"""The stored values of segments: measured on stored trajectories, whoever drives and resumes."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaigns import quick_search, refused
from contents import execute

from frenetic.analysis import failures_of
from frenetic.analysis.listing import list_tests
from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.campaign import check as check_module
from frenetic.campaign.check import check_campaign
from frenetic.campaign.database import DATABASE
from frenetic.drivers import Planner
from frenetic.oracle.drive import Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.simulators import EmbeddedSimulator

SEGMENTS = "SELECT * FROM segment ORDER BY test"


def make_campaign(folder: Path, simulations: int = 60, **options: Any) -> Campaign:
    return Campaign(
        strategy=quick_search(),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(simulations=simulations),
        folder=folder,
        max_in_flight=8,
        **options,
    )


@pytest.fixture(scope="module")
def driven_campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("segments") / "c"
    make_campaign(folder).run()
    return folder


@pytest.fixture
def folder(driven_campaign: Path, tmp_path: Path) -> Path:
    """A copy of the campaign, to be changed."""
    return Path(shutil.copytree(driven_campaign, tmp_path / "c"))


def segments(folder: Path) -> list[tuple[Any, ...]]:
    with closing(sqlite3.connect(folder / DATABASE)) as connection:
        return connection.execute(SEGMENTS).fetchall()


def test_each_judged_drive_has_the_values_that_its_stored_trajectory_gives(
    driven_campaign: Path,
) -> None:
    with CampaignStore.open(driven_campaign) as store:
        tests = list(store.tests(with_trajectory=True, with_segments=True))
    judged = [test for test in tests if test.outcome.is_driven]
    assert {test.outcome for test in judged} == {Outcome.PASS, Outcome.FAIL}
    assert len(judged) == 60 == len(segments(driven_campaign))
    for test in judged:
        stored, measured = test.stored_values, test.measure()
        assert stored is not None
        assert measured is not None
        assert (stored.place, stored.side, stored.criterion, stored.cause) == (
            measured.place,
            measured.side,
            measured.criterion,
            measured.cause,
        )
        assert stored.features == measured.features
        assert (stored.slowest, stored.fastest) == (measured.slowest, measured.fastest)
        assert stored.approach.tobytes() == measured.approach.tobytes()
        assert not stored.differences(measured)


@pytest.mark.parametrize("workers", [1, 2])
def test_resumed_campaigns_and_other_workers_store_the_same_values(
    driven_campaign: Path, tmp_path: Path, workers: int
) -> None:
    def stop(event: Any) -> None:
        if event.kind == "result" and event.summary.tests == 25:
            raise KeyboardInterrupt

    make_campaign(tmp_path, workers=workers).run(on_event=stop)
    assert 0 < len(segments(tmp_path)) < 60
    make_campaign(tmp_path, workers=workers).resume()
    assert segments(tmp_path) == segments(driven_campaign)


def test_lists_and_failures_come_from_stored_values(folder: Path) -> None:
    with CampaignStore.open(folder) as store:
        failures = failures_of(store)
        listed = list_tests(store, sort="mean_speed")
    execute(folder, "UPDATE test SET trajectory = x'00'")  # which nobody can decode
    execute(folder, f"UPDATE segment SET mean_speed = 99.0 WHERE test = {listed[-1][0].id}")
    with CampaignStore.open(folder) as store:
        assert [failure.cause for failure in failures_of(store)] == [
            failure.cause for failure in failures
        ]
        for failure, other in zip(failures_of(store), failures, strict=True):
            assert np.array_equal(failure.vector(), other.vector())
        fastest, values = list_tests(store, sort="mean_speed")[0]
    assert fastest.id == listed[-1][0].id
    assert values["mean_speed"] == 99.0


def test_values_that_are_not_stored_are_measured(folder: Path) -> None:
    with CampaignStore.open(folder) as store:
        failures = failures_of(store)
    execute(folder, "DELETE FROM segment")
    with CampaignStore.open(folder) as store:
        assert [failure.cause for failure in failures_of(store)] == [
            failure.cause for failure in failures
        ]
        tests = store.tests(Outcome.FAIL, with_segments=True)
        assert all(test.segment_values is not None for test in tests)


@pytest.mark.parametrize(
    ("statement", "finding"),
    [
        ("UPDATE segment SET max_curvature = 1.0", "differ .* gives: max_curvature"),
        ("UPDATE segment SET side = 'right', bend_side = NULL", "gives: side"),
        ("UPDATE segment SET approach = zeroblob(512)", "gives: approach"),
        ("UPDATE segment SET place = place + 0.001", "gives: place"),
        ("DELETE FROM segment", "the values of the segment of test .* are missing"),
        ("UPDATE segment SET bends = NULL", "a value of its segment is missing"),
        ("UPDATE segment SET approach = x'00'", "a value of its segment is missing"),
        ("UPDATE segment SET cause = 'RUSHES'", "its cause is 'RUSHES', which this version"),
        ("UPDATE segment SET test = 999", "values of the segment of test 999, which is missing"),
    ],
)
def test_check_finds_changed_and_missing_values(folder: Path, statement: str, finding: str) -> None:
    with CampaignStore.open(folder) as store:
        failed = next(
            test.id for test in store.tests(Outcome.FAIL, with_segments=True)
            if test.stored_values is not None and test.stored_values.side == "left"
        )  # fmt: skip
    assert check_campaign(folder).findings == ()
    execute(folder, f"{statement} WHERE test = {failed}")
    with refused(finding, AssertionError):
        raise AssertionError("; ".join(check_campaign(folder).findings))


def test_a_deep_check_measures_all_segments(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(check_module, "MEASURED", 2)  # the first and the last test
    with CampaignStore.open(folder) as store:
        second = list(store.tests(Outcome.FAIL))[1].id
    execute(folder, f"UPDATE segment SET bends = bends + 1 WHERE test = {second}")
    assert check_campaign(folder).findings == ()
    (finding,) = check_campaign(folder, is_deep=True).findings
    assert f"test {second} differ" in finding


def test_a_drive_in_which_time_stands_still_has_a_result_but_maybe_no_values(
    folder: Path, tmp_path: Path
) -> None:
    with CampaignStore.open(folder) as store:
        test = next(store.tests(Outcome.FAIL, with_trajectory=True))
        config = dict(store.config)
    assert test.trajectory is not None
    rows = test.trajectory.to_rows()
    rows[:, 0] = 0.0
    candidate = replace(test.candidate, id=1)
    path = Trajectory.from_rows(rows)
    odd = replace(test, candidate=candidate, trajectory=path, result_number=1)
    with CampaignStore.create(tmp_path / "odd", config) as store:
        store.add_candidate(odd.candidate)
        store.add_result(odd)
        assert store.test(odd.id).outcome is Outcome.FAIL
    assert check_campaign(tmp_path / "odd").findings == ()


def test_counts_follow_what_another_process_writes(folder: Path) -> None:
    with CampaignStore.open(folder) as store:
        before, repeats = store.counts(), store.repeats()
        execute(folder, "UPDATE test SET outcome = 'ERROR' WHERE result_number = 1")
        after = store.counts()
        assert (after.errors, after.simulations) == (before.errors + 1, before.simulations)
        assert store.by_outcome()[Outcome.ERROR] == 1
        assert store.repeats() == repeats
