"""Lists of tests by outcome and feature."""

from __future__ import annotations

from pathlib import Path

import pytest
from sample_campaigns import search

from frenetic.analysis.listing import list_tests
from frenetic.analysis.segments import segments_of
from frenetic.campaign import CampaignStore
from frenetic.errors import UnknownNameError
from frenetic.oracle.outcome import Outcome
from frenetic.road import Road
from frenetic.search import RandomSearch
from frenetic.segments.features import features_of
from frenetic.testing.dummies import DummyDriver, DummySimulator


@pytest.fixture(scope="module")
def drifting(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign with tests that passed and failed."""

    def drift(road: Road) -> float:
        return float(80.0 * road.curvatures.mean())

    return search(
        tmp_path_factory.mktemp("drifting") / "c",
        RandomSearch(seed=1),
        simulations=40,
        simulator=DummySimulator(drift),
        driver=DummyDriver(),
    )


def test_tests_are_sorted_by_moobd_or_order(drifting: Path) -> None:
    with CampaignStore.open(drifting) as store:
        records = [test for test, _ in list_tests(store)]
        by_moobd = list(store.tests(order_by="moobd"))
        assert {test.outcome for test in records} >= {Outcome.PASS, Outcome.FAIL}
        assert [test.id for test in records] == [test.id for test in by_moobd]
        orders = [test.result_number for test, _ in list_tests(store, sort="tested")]
        assert orders == sorted(orders)


def test_tests_are_chosen_by_outcome_and_feature_and_sorted_by_a_feature(drifting: Path) -> None:
    with CampaignStore.open(drifting) as store:
        expected = {
            record.id: features_of(segment)["max_curvature"]
            for record, segment in segments_of(store, Outcome.PASS)
            if 0.03 <= features_of(segment)["max_curvature"] <= 0.06
        }
        assert 1 < len(expected) < store.counts().passed
        listed = list_tests(
            store,
            outcomes=["PASS"],
            within={"max_curvature": (0.03, 0.06)},
            sort="max_curvature",
        )
        assert {test.id for test, _ in listed} == set(expected)
        values = [expected[test.id] for test, _ in listed]
        assert values == sorted(values, reverse=True)


def test_unknown_names_and_reversed_ranges_are_refused(drifting: Path) -> None:
    with CampaignStore.open(drifting) as store:
        with pytest.raises(UnknownNameError, match=r"'bend'.*severity.*max_curvature"):
            list_tests(store, sort="bend")
        with pytest.raises(UnknownNameError, match="'order': choose from"):
            list_tests(store, within={"order": (1.0, 2.0)})
        with pytest.raises(ValueError, match="bends from 3 to 1"):
            list_tests(store, within={"bends": (3.0, 1.0)})
        with pytest.raises(ValueError, match="'GONE'"):
            list_tests(store, outcomes=["GONE"])


def test_a_single_outcome_equals_a_list_of_this_outcome(drifting: Path) -> None:
    with CampaignStore.open(drifting) as store:
        ids = [[test.id for test, _ in list_tests(store, outcomes=o)] for o in ("FAIL", ["FAIL"])]
    assert ids[0] == ids[1] != []
