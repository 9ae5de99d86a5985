"""Measures of a campaign, checked against its database."""

from __future__ import annotations

import csv
import math
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec import to_builtins
from sample_campaigns import search, store_of

from frenetic.analysis import campaign_measures
from frenetic.analysis.campaign_measures import CampaignMeasures, measure_campaign
from frenetic.analysis.clusters import cluster_failures
from frenetic.analysis.diameter import set_diameter
from frenetic.analysis.failure_stability import STABILITY, FailureStability
from frenetic.analysis.failures import failures_of
from frenetic.analysis.measures import MEASURES, RADII, SHARED_TEXT
from frenetic.analysis.segments import segments_of
from frenetic.analysis.spaces import SPACES
from frenetic.analysis.sparseness import unlike_lines
from frenetic.analysis.unlike import UnlikeFailures
from frenetic.campaign import CampaignStore
from frenetic.export import export_campaign
from frenetic.oracle.outcome import Outcome
from frenetic.search import Frenetic2021, RandomSearch
from frenetic.segments.features import FEATURES, features_of

SIMULATIONS = 110


@pytest.fixture(scope="module")
def searched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return search(
        tmp_path_factory.mktemp("measured") / "c", Frenetic2021(seed=2, max_redraws=10), SIMULATIONS
    )


@pytest.fixture(scope="module")
def measured(searched: Path) -> CampaignMeasures:
    return measure_campaign(searched)


def test_measures_agree_with_the_database(searched: Path, measured: CampaignMeasures) -> None:
    database = sqlite3.connect(searched / "campaign.sqlite")

    def ask(question: str) -> float:
        (value,) = database.execute(question).fetchone()
        return float(value)

    driven = "outcome IN ('PASS', 'FAIL', 'ERROR')"
    first = ask("SELECT min(result_number) FROM test WHERE outcome = 'FAIL'")
    different = "SELECT count(DISTINCT hex(curvatures)) FROM test WHERE"  # each road counts once
    valid, refused = ask(f"{different} {driven}"), ask(f"{different} outcome = 'INVALID'")
    assert measured.failures == ask(f"{different} outcome = 'FAIL'") > 0
    assert measured.simulations == ask(f"SELECT count(*) FROM test WHERE {driven}") == SIMULATIONS
    assert measured.valid_share == valid / (valid + refused)
    assert measured.invalid_roads == refused
    repeats = ask("SELECT count(*) FROM test WHERE outcome = 'FAIL'") - measured.failures
    assert measured.failing_repeats == repeats
    up_to_first = f"{driven} AND result_number <= {first}"
    assert measured.seconds_to_failure == pytest.approx(
        ask(f"SELECT sum(duration) FROM test WHERE {up_to_first}")
    )
    facts = dict(database.execute("SELECT name, value FROM fact"))
    assert measured.strategy_seconds == float(facts["strategy_seconds"]) > 0.0
    assert measured.min_moobd == ask("SELECT min(moobd) FROM test")
    assert measured.simulations_to_failure == ask(
        f"SELECT count(*) FROM test WHERE {driven} AND result_number <= {first}"
    )
    database.close()
    assert (measured.seed, measured.is_finished) == (2, True)


def test_refused_and_dropped_roads_do_not_count_as_simulations(tmp_path: Path) -> None:
    kinds = (Outcome.INVALID, Outcome.PASS, Outcome.DROPPED, Outcome.ERROR, Outcome.INVALID)
    measured = measure_campaign(store_of(tmp_path / "c", (*kinds, Outcome.FAIL)))
    assert measured.failures_after.tolist() == [0, 0, 0, 1]
    assert measured.mean_failures == 1 / 3
    assert measured.invalid_roads == 2
    assert measured.strategy_seconds is None
    assert measured.simulations_to_failure == 3
    assert measured.valid_share == 3 / 5
    assert not measured.is_finished


@pytest.mark.parametrize("tests", [0, 3])
def test_without_failures_the_first_failure_is_infinitely_late(tests: int, tmp_path: Path) -> None:
    measured = measure_campaign(store_of(tmp_path / "c", (Outcome.PASS,) * tests))
    values = {name: measure.of(measured) for name, measure in MEASURES.items()}
    assert values.pop("simulations_to_failure") == math.inf
    assert values.pop("competition_sparseness") == -math.inf
    assert values.pop("test_set_diameter") == -math.inf
    assert values.pop("kilometres_to_failure") == values.pop("seconds_to_failure") == math.inf
    for name in ("min_moobd", "strategy_seconds", "passes_with_more_grip", "keeps_cause"):
        assert values.pop(name) is None
    assert values.pop("valid_share") == 1.0
    assert set(values.values()) == {0.0}
    assert MEASURES["simulations_to_failure"].text(math.inf) == "none"


def test_without_failures_their_stability_is_worse_than_any(tmp_path: Path) -> None:
    folder = store_of(tmp_path / "c", (Outcome.PASS,))
    with CampaignStore.open(folder, readonly=False) as store:
        store.keep(**{STABILITY: to_builtins(FailureStability.of(()))})
    measured = measure_campaign(folder)
    passes, keeps = MEASURES["passes_with_more_grip"], MEASURES["keeps_cause"]
    assert passes.sign * (passes.of(measured) or 0.0) == -math.inf
    assert keeps.sign * (keeps.of(measured) or 0.0) == -math.inf


def test_the_curve_of_distinct_failures_rises_with_each_new_cluster(
    searched: Path, measured: CampaignMeasures
) -> None:
    clusters_of: dict[int, int] = {}
    with CampaignStore.open(searched) as store:
        for place, cluster in enumerate(cluster_failures(failures_of(store))):
            clusters_of |= dict.fromkeys(cluster.ids, place)
        driven = [record for record in store.tests() if record.outcome.is_driven]
    clusters_so_far: set[int] = set()
    for number, record in enumerate(driven, start=1):
        if record.id in clusters_of:
            clusters_so_far.add(clusters_of[record.id])
        assert measured.distinct_after[number] == len(clusters_so_far)
    assert measured.distinct_failures == len(clusters_so_far)
    assert len(measured.distinct_after) == SIMULATIONS + 1


def test_the_mean_of_a_curve_weighs_early_failures_more(measured: CampaignMeasures) -> None:
    rises = np.flatnonzero(np.diff(measured.failures_after)) + 1  # simulations of failures
    area = sum(SIMULATIONS - simulation + 1 for simulation in rises.tolist())
    assert measured.mean_failures == pytest.approx(area / SIMULATIONS)
    assert 0.0 < measured.mean_distinct_failures < measured.mean_failures


def test_the_length_to_the_first_failure_is_driven(
    searched: Path, measured: CampaignMeasures
) -> None:
    metres = 0.0
    with CampaignStore.open(searched) as store:
        for test in store.tests(with_trajectory=True):
            if test.drive is not None:
                path = test.drive.trajectory
                last = int(np.searchsorted(path.time, (test.result.duration or 0.0) + 1e-3)) - 1
                along = test.road.track(np.column_stack([path.x, path.y]))[last, 0]
                assert test.result.distance == pytest.approx(along, abs=0.01)
                metres += along
            if test.outcome is Outcome.FAIL:
                break
    assert 1000.0 * measured.kilometres_to_failure == pytest.approx(metres, abs=1.0)


def test_failures_are_unlike_in_each_space(searched: Path, measured: CampaignMeasures) -> None:
    with CampaignStore.open(searched) as store:
        failures = list(
            store.tests(Outcome.FAIL, with_trajectory=True, with_segments=True, with_repeats=False)
        )
    for name, space in SPACES.items():
        vectors = np.array([space.vector(test) for test in failures])
        expected = UnlikeFailures.of(vectors)
        for radius in RADII:
            value = MEASURES[f"{name}_{radius:g}".replace(".", "_")].of(measured)
            assert value == expected.unlike_at(radius) > 0
    assert measured.test_set_diameter == set_diameter(
        test.candidate.curvatures for test in failures
    )


def test_of_many_failures_some_are_linked_evenly(
    searched: Path, measured: CampaignMeasures, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(campaign_measures, "MOST_LINKED", 4)
    few = measure_campaign(searched)
    assert {unlike.different for unlike in few.unlike.values()} == {4}
    assert (few.failures, few.unlike_roads) == (measured.failures, measured.unlike_roads)


def test_distinct_failures_alone_are_shared_with_the_search() -> None:
    shared = {name for name, measure in MEASURES.items() if measure.is_shared_with_search}
    assert shared == {"distinct_failures", "mean_distinct_failures"}
    assert "distinct failures" in SHARED_TEXT


def test_cells_and_unlike_roads_count_failures(searched: Path, measured: CampaignMeasures) -> None:
    axes = ("direction_coverage", "max_curvature", "std_steering", "mean_offset")
    with CampaignStore.open(searched) as store:
        failures = [segment for _, segment in segments_of(store, Outcome.FAIL)]
    cells = {tuple(FEATURES[n].bin(features_of(test)[n]) for n in axes) for test in failures}
    assert measured.cells == len(cells) > 1
    assert measured.unlike_roads == unlike_lines([test.road.sample(5.0) for test in failures]) > 1


def test_the_competitions_sparseness_equals_that_of_an_exported_folder(tmp_path: Path) -> None:
    # Random roads do not repeat; a repeated road would count twice in the folder.
    searched = search(tmp_path / "c", RandomSearch(seed=2), SIMULATIONS)
    measured = measure_campaign(searched)
    assert measured.failures > 2
    export_campaign(searched, "competition", tmp_path / "competition")
    text = (tmp_path / "competition" / "oob_stats.csv").read_text(encoding="utf-8")
    (row,) = csv.DictReader(text.splitlines())
    assert measured.competition_sparseness == pytest.approx(float(row["avg_sparseness"]), abs=1e-6)


@pytest.mark.parametrize(
    ("facts", "is_finished"),
    [
        ({}, True),
        ({"interrupted": True}, False),
        ({"bench": {"end": "over"}, "budget": {"simulations": 9}}, True),
        ({"bench": {"end": "crashed"}, "budget": {"simulations": 9}}, False),
        ({"bench": {"end": "crashed"}, "budget": {"simulations": 2}}, True),
    ],
)
def test_a_bench_run_that_ended_early_has_not_finished(
    facts: dict[str, Any], is_finished: bool, tmp_path: Path
) -> None:
    folder = store_of(tmp_path / "c", (Outcome.PASS,) * 2, **{"interrupted": False, **facts})
    assert measure_campaign(folder).is_finished is is_finished
