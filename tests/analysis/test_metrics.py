"""What a campaign came to: against its database, and against each measure's own code."""

from __future__ import annotations

import csv
import math
import sqlite3
from pathlib import Path

import numpy as np
import pytest
from made_campaigns import search, store_of

from frenetic.analysis import metrics
from frenetic.analysis.competition import competition_features
from frenetic.analysis.failures import cluster_failures, failures_of
from frenetic.analysis.features import FEATURES, features_of
from frenetic.analysis.metrics import (
    COMPETITION_AXES,
    HEADLINE,
    MAP_AXES,
    MEASURES,
    CampaignMeasures,
    Measure,
    curves,
    measure_campaign,
)
from frenetic.analysis.segments import segments_of
from frenetic.analysis.sparseness import diversity
from frenetic.campaign import CampaignStore
from frenetic.export import export_campaign
from frenetic.outcome import Outcome
from frenetic.search import Frenetic2021

SIMULATIONS = 110


@pytest.fixture(scope="module")
def searched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return search(
        tmp_path_factory.mktemp("measured") / "c", Frenetic2021(seed=2, max_redraws=10), SIMULATIONS
    )


@pytest.fixture(scope="module")
def measured(searched: Path) -> CampaignMeasures:
    return measure_campaign(searched)


def test_measures_are_what_the_database_says(searched: Path) -> None:
    measured = measure_campaign(searched)
    database = sqlite3.connect(searched / "campaign.sqlite")

    def ask(question: str) -> float:
        (value,) = database.execute(question).fetchone()
        return float(value)

    driven = "outcome IN ('PASS', 'FAIL', 'ERROR')"
    first = ask("SELECT min(told) FROM test WHERE outcome = 'FAIL'")
    assert measured.failures == ask("SELECT count(*) FROM test WHERE outcome = 'FAIL'") > 0
    assert measured.simulations == ask(f"SELECT count(*) FROM test WHERE {driven}") == SIMULATIONS
    assert measured.invalid == ask("SELECT count(*) FROM test WHERE outcome = 'INVALID'")
    assert measured.simulations_to_failure == ask(
        f"SELECT count(*) FROM test WHERE {driven} AND told <= {first}"
    )
    assert measured.seconds_to_failure == ask(f"SELECT elapsed FROM test WHERE told = {first}")
    assert measured.tests == ask("SELECT count(*) FROM test WHERE outcome <> 'DROPPED'")
    assert measured.generator_seconds == ask(
        "SELECT value FROM fact WHERE name = 'strategy_seconds'"
    )
    database.close()
    with CampaignStore.open(searched) as store:
        assert measured.distinct_failures == len(cluster_failures(failures_of(store)))
    assert 1 <= measured.cells <= measured.failures
    assert measured.failures_per_100 == pytest.approx(100 * measured.failures / SIMULATIONS)
    assert (measured.seed, measured.is_finished) == (2, True)
    curve = measured.failures_after
    assert (len(curve), curve[0], curve[-1]) == (SIMULATIONS + 1, 0, measured.failures)
    assert set(np.diff(curve)) <= {0, 1}
    assert np.argmax(curve > 0) == measured.simulations_to_failure


def test_refused_and_dropped_roads_are_no_simulations(tmp_path: Path) -> None:
    kinds = (Outcome.INVALID, Outcome.PASS, Outcome.DROPPED, Outcome.ERROR, Outcome.INVALID)
    measured = measure_campaign(store_of(tmp_path / "c", (*kinds, Outcome.FAIL), elapsed=0.5))
    assert (measured.simulations, measured.invalid, measured.failures) == (3, 2, 1)
    assert measured.invalid_share == pytest.approx(2 / 5)
    assert measured.failures_after.tolist() == [0, 0, 0, 1]
    assert measured.simulations_to_failure == 3
    assert measured.seconds_to_failure == 3.0
    assert not measured.is_finished


def test_a_campaign_without_failures_never_came_to_the_first(tmp_path: Path) -> None:
    measured = measure_campaign(store_of(tmp_path / "c", (Outcome.PASS,) * 3))
    assert measured.simulations_to_failure == measured.seconds_to_failure == math.inf
    assert (measured.failures, measured.distinct_failures, measured.cells) == (0, 0, 0)
    assert MEASURES["simulations_to_failure"].text(math.inf) == "none"


def test_an_empty_campaign_has_no_shares(tmp_path: Path) -> None:
    measured = measure_campaign(store_of(tmp_path / "c", ()))
    assert (measured.failures_per_100, measured.invalid_share) == (0.0, 0.0)
    assert measured.distinct_per_100 == 0.0


# Distinct failures and cells, as they were found


def test_curves_rise_with_what_is_new(searched: Path, measured: CampaignMeasures) -> None:
    clusters_of: dict[int, int] = {}
    with CampaignStore.open(searched) as store:
        for place, cluster in enumerate(cluster_failures(failures_of(store))):
            clusters_of |= dict.fromkeys(cluster.ids, place)
        cells = {
            record.candidate.id: tuple(FEATURES[n].bin_of(features_of(segment)) for n in MAP_AXES)
            for record, segment in segments_of(store, Outcome.FAIL)
        }
        driven = [record for record in store.tests() if record.outcome.is_driven]
    seen_clusters: set[int] = set()
    seen_cells: set[tuple[int, ...]] = set()
    for number, record in enumerate(driven, start=1):
        if record.outcome is Outcome.FAIL:
            seen_clusters.add(clusters_of[record.candidate.id])
            seen_cells.add(cells[record.candidate.id])
        assert measured.distinct_after[number] == len(seen_clusters)
        assert measured.cells_after[number] == len(seen_cells)
    assert measured.filled == seen_cells
    assert len(measured.distinct_after) == len(measured.cells_after) == SIMULATIONS + 1


def test_curves_reach_as_far_as_all_campaigns(measured: CampaignMeasures) -> None:
    short = CampaignMeasures(
        folder=Path("made-up"),
        seed=None,
        invalid=0,
        failures_after=np.array([0, 1, 1]),
        distinct_after=np.array([0, 1, 1]),
        cells_after=np.array([0, 1, 1]),
        seconds_to_failure=1.0,
        is_finished=True,
    )
    found = curves((measured, short), "failures_after")
    assert found.shape == (2, 3)
    assert found[0].tolist() == measured.failures_after[:3].tolist()
    assert found[1].tolist() == [0, 1, 1]


# Diversity and coverage


def test_the_competitions_sparseness_is_that_of_an_exported_folder(
    searched: Path, measured: CampaignMeasures, tmp_path: Path
) -> None:
    with CampaignStore.open(searched) as store:
        export_campaign(store, "competition", tmp_path / "theirs")
    text = (tmp_path / "theirs" / "oob_stats.csv").read_text(encoding="utf-8")
    (row,) = csv.DictReader(text.splitlines())
    assert measured.competition_sparseness == pytest.approx(float(row["avg_sparseness"]), abs=1e-6)


def test_diversity_is_that_of_the_segments(searched: Path, measured: CampaignMeasures) -> None:
    with CampaignStore.open(searched) as store:
        points = [segment.points() for _, segment in segments_of(store, Outcome.FAIL)]
    assert measured.pairwise_diversity == diversity(points).pairwise
    assert 0.0 < measured.pairwise_diversity < 1.0


def test_of_many_failures_some_are_compared(
    searched: Path, measured: CampaignMeasures, monkeypatch: pytest.MonkeyPatch
) -> None:
    with CampaignStore.open(searched) as store:
        points = [segment.points() for _, segment in segments_of(store, Outcome.FAIL)]
    monkeypatch.setattr(metrics, "MOST_PAIRED", 3)
    thinned = measure_campaign(searched)
    middle = round((len(points) - 1) / 2)
    expected = diversity([points[0], points[middle], points[-1]]).pairwise
    assert thinned.pairwise_diversity == expected != measured.pairwise_diversity
    assert thinned.competition_sparseness == measured.competition_sparseness


def test_the_competitions_cells_are_those_of_its_features(
    searched: Path, measured: CampaignMeasures
) -> None:
    found = set()
    with CampaignStore.open(searched) as store:
        for _, segment in segments_of(store, Outcome.FAIL):
            features = competition_features(segment)
            if features is not None:
                values = (features.dir_cov, features.std_sa, features.max_curv, features.mean_lp)
                tops = (0.5, 20.0, 0.07, 2.0)
                found.add(
                    tuple(
                        min(int(10 * value / top + 1e-9), 9)
                        for value, top in zip(values, tops, strict=True)
                    )
                )
    assert measured.competition_filled == found
    assert measured.competition_cells == len(found) > 5


def test_no_range_of_the_competitions_map_is_left_by_what_it_can_measure() -> None:
    by_name = {axis.name: axis for axis in COMPETITION_AXES}
    assert (by_name["dir_cov"].low, by_name["dir_cov"].high) == (0.0, 13 / 26)
    assert by_name["mean_lp"].high == 2.0, "on the lane's centre"


def test_fewer_than_two_failures_have_no_diversity(tmp_path: Path) -> None:
    measured = measure_campaign(store_of(tmp_path / "c", (Outcome.PASS,) * 3))
    for name in ("pairwise_diversity", "competition_sparseness"):
        value = MEASURES[name].of(measured)
        assert value == -math.inf
        assert MEASURES[name].text(value) == "none"


# What a bench knows


def test_facts_of_a_bench_are_read(tmp_path: Path) -> None:
    outcomes = (Outcome.PASS, Outcome.ERROR, Outcome.INVALID, Outcome.FAIL)
    facts = {"strategy_seconds": 1.5, "seconds_per_test": 36.0}
    measured = measure_campaign(store_of(tmp_path / "c", outcomes, **facts))
    assert measured.generator_seconds == 1.5
    assert measured.simulations_to_failure == 3
    assert measured.virtual_seconds_to_failure == 108.0
    assert (measured.errors, measured.simulations, measured.tests) == (1, 3, 4)
    assert measured.failures_per_100 == pytest.approx(100 / 3), "an error was spent, too"


@pytest.mark.parametrize("value", ["1.5", True, -1.0, None])
def test_facts_that_are_no_times_are_not_known(tmp_path: Path, value: object) -> None:
    folder = store_of(tmp_path / "c", (Outcome.PASS,), strategy_seconds=value)  # type: ignore[arg-type]
    measured = measure_campaign(folder)
    assert measured.generator_seconds is None
    assert MEASURES["generator_seconds"].of(measured) is None
    assert measured.virtual_seconds_to_failure is None


# The measures themselves


@pytest.mark.parametrize("measure", MEASURES.values(), ids=lambda measure: measure.name)
def test_each_measure_says_what_it_is(measure: Measure, measured: CampaignMeasures) -> None:
    assert measure.definition.endswith(".")
    assert measure.bounds
    assert measure.short
    value = measure.of(measured)
    assert (value is None) == (measure.name == "virtual_seconds_to_failure")
    if value is not None:
        low, _, high = measure.bounds.partition("..")
        assert value >= float(low)
        assert not high.isdigit() or value <= float(high)


def test_the_headline_stands_first() -> None:
    assert next(iter(MEASURES)) == HEADLINE
