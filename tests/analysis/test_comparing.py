"""Comparisons: measures against what the database says, statistics against hand-made cases."""

from __future__ import annotations

import math
import sqlite3
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from frenetic.analysis.clusters import cluster_failures, failures_of
from frenetic.analysis.comparing import (
    MEASURES,
    CampaignMeasures,
    Comparison,
    Verdict,
    compare,
    compare_measured,
    find_campaigns,
    group_campaigns,
    measure_campaign,
)
from frenetic.analysis.statistics import Magnitude
from frenetic.campaign import Budget, Campaign, CampaignStore, TestRecord
from frenetic.campaign.store import JSONValue
from frenetic.drivers import Delayed, Planner
from frenetic.errors import CampaignError, FreneticError
from frenetic.outcome import Outcome
from frenetic.search import Candidate, Frenetic, Origin, RandomSearch, Strategy
from frenetic.simulators import EmbeddedSimulator
from frenetic.testing import DummyDriver, DummySimulator

SIMULATIONS = 110


def search(folder: Path, strategy: Strategy, simulations: int = SIMULATIONS) -> Path:
    Campaign(
        strategy=strategy,
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(simulations=simulations),
        folder=folder,
    ).run()
    return folder


@pytest.fixture(scope="module")
def repeats(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with five campaigns of each of two strategies."""
    parent = tmp_path_factory.mktemp("repeats")
    for seed in range(5):
        search(parent / f"frenetic-{seed}", Frenetic(seed=seed))
        search(parent / f"random-{seed}", RandomSearch(seed=seed))
    return parent


@pytest.fixture(scope="module")
def comparison(repeats: Path) -> Comparison:
    return compare({name: sorted(repeats.glob(f"{name}-*")) for name in ("frenetic", "random")})


# Two strategies, really run


def test_frenetic_finds_more_than_chance(comparison: Comparison) -> None:
    (pair,) = comparison.by("failures").pairs
    assert (pair.first, pair.second, pair.repeats) == ("frenetic", "random", (5, 5))
    assert pair.a12 >= 0.8
    assert pair.magnitude is Magnitude.LARGE
    assert pair.p == pair.p_corrected < 0.05
    assert pair.verdict is Verdict.FIRST_IS_BETTER
    assert str(pair) == "frenetic is better than random"


def test_strategies_that_are_alike_at_first_show_no_difference(comparison: Comparison) -> None:
    # Both begin with the same random roads.
    (pair,) = comparison.by("simulations_to_failure").pairs
    assert pair.verdict is Verdict.NOT_SHOWN
    assert (pair.a12, pair.p) == (0.5, 1.0)


def test_all_measures_are_compared_and_those_that_say_the_same_told_once(
    comparison: Comparison,
) -> None:
    assert [one.measure.name for one in comparison.measures] == list(MEASURES)
    told = {one.measure.name for one in comparison.telling}
    assert told == set(MEASURES) - {"failures_per_100"}
    for one in comparison.measures:
        assert one.p_overall is None
        for name, values in one.values.items():
            assert one.quartiles(name).median == np.median(values)
    assert comparison.notes == ()
    with pytest.raises(KeyError, match="no measure is called 'speed'"):
        comparison.by("speed")


def test_measures_are_what_the_database_says(repeats: Path) -> None:
    folder = repeats / "frenetic-2"
    measured = measure_campaign(folder)
    database = sqlite3.connect(folder / "campaign.sqlite")

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
    database.close()
    with CampaignStore.open(folder) as store:
        assert measured.distinct_failures == len(cluster_failures(failures_of(store)))
    assert 1 <= measured.cells <= measured.failures
    assert measured.failures_per_100 == pytest.approx(100 * measured.failures / SIMULATIONS)
    assert (measured.seed, measured.is_finished) == (2, True)
    curve = measured.failures_after
    assert (len(curve), curve[0], curve[-1]) == (SIMULATIONS + 1, 0, measured.failures)
    assert set(np.diff(curve)) <= {0, 1}
    assert np.argmax(curve > 0) == measured.simulations_to_failure


def store_of(folder: Path, outcomes: Sequence[Outcome], elapsed: float | None = None) -> Path:
    """A campaign with these outcomes, one after the other, without trajectories."""
    config: dict[str, JSONValue] = {"seed": 1, "lane_width": 4.0, "rules": {}, "car": {}}
    with CampaignStore.create(folder, config) as store:
        for told, outcome in enumerate(outcomes, start=1):
            candidate = Candidate(told, np.zeros(5), 10.0, Origin("random"))
            store.asked(candidate)
            store.told(
                TestRecord(
                    candidate=candidate,
                    told=told,
                    outcome=outcome,
                    reason="",
                    budget_spent=0.0,
                    seconds=2.0,
                    elapsed=None if elapsed is None else told * elapsed,
                )
            )
    return folder


def test_refused_and_dropped_roads_are_no_simulations(tmp_path: Path) -> None:
    kinds = (Outcome.INVALID, Outcome.PASS, Outcome.DROPPED, Outcome.ERROR, Outcome.INVALID)
    measured = measure_campaign(store_of(tmp_path / "c", (*kinds, Outcome.FAIL), elapsed=0.5))
    assert (measured.simulations, measured.invalid, measured.failures) == (3, 2, 1)
    assert measured.invalid_share == pytest.approx(2 / 5)
    assert measured.failures_after.tolist() == [0, 0, 0, 1]
    assert measured.simulations_to_failure == 3
    assert measured.seconds_to_failure == 3.0
    assert not measured.is_finished


def test_a_log_of_an_old_version_knows_only_what_each_test_took(tmp_path: Path) -> None:
    measured = measure_campaign(store_of(tmp_path / "c", (Outcome.PASS, Outcome.FAIL)))
    assert measured.seconds_to_failure == 4.0


def test_a_campaign_without_failures_never_came_to_the_first(tmp_path: Path) -> None:
    measured = measure_campaign(store_of(tmp_path / "c", (Outcome.PASS,) * 3))
    assert measured.simulations_to_failure == measured.seconds_to_failure == math.inf
    assert (measured.failures, measured.distinct_failures, measured.cells) == (0, 0, 0)
    assert MEASURES["simulations_to_failure"].text(math.inf) == "none"


def test_an_empty_campaign_has_no_shares(tmp_path: Path) -> None:
    measured = measure_campaign(store_of(tmp_path / "c", ()))
    assert (measured.failures_per_100, measured.invalid_share) == (0.0, 0.0)


# Statistics of made-up groups


def campaign(failures: int, first: float = 5.0, simulations: int = 100) -> CampaignMeasures:
    curve = np.zeros(simulations + 1, dtype=np.int64)
    curve[simulations - failures :] = np.arange(failures + 1)
    return CampaignMeasures(
        folder=Path("made-up"),
        seed=None,
        simulations=simulations,
        invalid=0,
        failures=failures,
        distinct_failures=failures,
        cells=failures,
        simulations_to_failure=first,
        seconds_to_failure=first,
        failures_after=curve,
        is_finished=True,
    )


def group(*failures: int) -> tuple[CampaignMeasures, ...]:
    return tuple(campaign(number) for number in failures)


def test_more_failures_are_better_and_a_later_first_one_is_worse() -> None:
    quick = tuple(campaign(10 + i, first=2.0 + i) for i in range(5))
    slow = tuple(campaign(1 + i, first=20.0 + i) for i in range(5))
    found = compare_measured({"quick": quick, "slow": slow})
    for name in ("failures", "simulations_to_failure"):
        (pair,) = found.by(name).pairs
        assert pair.a12 == 1.0
        assert pair.p == pytest.approx(2 / 252)
        assert pair.verdict is Verdict.FIRST_IS_BETTER
    turned = compare_measured({"slow": slow, "quick": quick})
    (pair,) = turned.by("simulations_to_failure").pairs
    assert pair.a12 == 0.0
    assert pair.verdict is Verdict.SECOND_IS_BETTER
    assert str(pair) == "quick is better than slow"


def test_never_failing_is_worse_than_any_failure() -> None:
    never = tuple(campaign(0, first=math.inf) for _ in range(5))
    late = tuple(campaign(1, first=100.0) for _ in range(5))
    found = compare_measured({"never": never, "late": late}).by("simulations_to_failure")
    assert found.pairs[0].a12 == 0.0
    assert found.pairs[0].verdict is Verdict.SECOND_IS_BETTER
    assert found.quartiles("never").median == math.inf


@pytest.mark.parametrize("repeats", [1, 4])
def test_nothing_is_claimed_of_fewer_than_five_repeats(repeats: int) -> None:
    found = compare_measured({"a": group(*range(50, 50 + repeats)), "b": group(*range(10))}).by(
        "failures"
    )
    assert found.pairs[0].a12 == 1.0
    assert found.pairs[0].verdict is Verdict.TOO_FEW
    assert str(found.pairs[0]) == "a and b: too few repeats to tell"


def test_several_groups_are_corrected_for_being_several() -> None:
    groups = {"a": group(9, 8, 7, 9, 8), "b": group(5, 4, 6, 5, 4), "c": group(5, 4, 6, 5, 3)}
    found = compare_measured(groups).by("failures")
    assert [(pair.first, pair.second) for pair in found.pairs] == [
        ("a", "b"),
        ("a", "c"),
        ("b", "c"),
    ]
    smallest = min(pair.p for pair in found.pairs)
    assert found.pairs[0].p_corrected == pytest.approx(3 * smallest)
    assert found.pairs[0].verdict is found.pairs[1].verdict is Verdict.FIRST_IS_BETTER
    assert found.pairs[2].verdict is Verdict.NOT_SHOWN
    assert found.p_overall is not None
    assert found.p_overall < 0.01


# Which campaigns belong together


def test_campaigns_that_differ_in_the_seed_only_are_grouped_under_telling_names(
    repeats: Path,
) -> None:
    groups = group_campaigns(find_campaigns(repeats))
    assert list(groups) == ["Frenetic", "RandomSearch"]
    assert [folder.name for folder in groups["Frenetic"]] == [f"frenetic-{i}" for i in range(5)]
    assert len(groups["RandomSearch"]) == 5


def made(folder: Path, name: str, seed: int = 1, **options: object) -> Path:
    """A tiny campaign in which something differs."""
    parts: dict[str, object] = {
        "strategy": RandomSearch(seed=seed),
        "simulator": DummySimulator(),
        "driver": Planner(),
        "budget": Budget(simulations=2),
        **options,
    }
    Campaign(folder=folder / name, **parts).run()  # type: ignore[arg-type]
    return folder / name


def test_names_say_what_differs_and_no_more(tmp_path: Path) -> None:
    folders = [
        made(tmp_path, "a"),
        made(tmp_path, "b", driver=Planner(aggression=0.5, braking=3.0)),
        made(tmp_path, "c", driver=Delayed(Planner(), seconds=0.1)),
        made(tmp_path, "d", driver=Delayed(Planner(), seconds=0.2)),
        made(tmp_path, "e", driver=DummyDriver()),
    ]
    assert list(group_campaigns(folders)) == [
        "Planner(aggression=1.0, braking=2.2)",
        "Planner(aggression=0.5, braking=3.0)",
        "Delayed(seconds=0.1) over Planner",
        "Delayed(seconds=0.2) over Planner",
        "DummyDriver",
    ]
    budgets = [folders[0], made(tmp_path, "f", budget=Budget(simulations=3))]
    assert list(group_campaigns(budgets)) == ["simulations=2", "simulations=3"]
    assert list(group_campaigns(folders[:1])) == ["all"]


def test_what_cannot_be_told_in_short_is_numbered(tmp_path: Path) -> None:
    folders = [tmp_path / "a", tmp_path / "b", tmp_path / "c"]
    for folder, driver in zip(folders, ("one:Driver", "two:Driver", "one:Other"), strict=True):
        with CampaignStore.create(folder, {"driver": {"class": driver}}):
            pass
    assert list(group_campaigns(folders)) == ["Driver 1", "Driver 2", "Other"]


def test_places_hold_one_campaign_or_several(repeats: Path, tmp_path: Path) -> None:
    one = repeats / "random-1"
    assert find_campaigns(one) == [one]
    assert len(find_campaigns(repeats)) == 10
    with pytest.raises(CampaignError, match="holds no campaign"):
        find_campaigns(tmp_path)
    with pytest.raises(CampaignError, match="is no folder"):
        find_campaigns(tmp_path / "nowhere")


# What limits a comparison


def test_one_group_or_an_empty_one_is_refused(repeats: Path) -> None:
    with pytest.raises(FreneticError, match="1 group of campaigns: at least two"):
        compare({"a": [repeats / "random-1", repeats / "random-2"]})
    with pytest.raises(FreneticError, match="group b has no campaigns"):
        compare({"a": [repeats / "random-1"], "b": []})


def test_a_campaign_counts_once(repeats: Path) -> None:
    twice = repeats / "random-2" / ".." / "random-1"
    with pytest.raises(FreneticError, match="is there twice"):
        compare({"a": [repeats / "random-1"], "b": [twice]})


def test_repeats_that_are_none_are_noted(tmp_path: Path) -> None:
    first, same = made(tmp_path, "a"), made(tmp_path, "b")
    other = made(tmp_path, "c", driver=DummyDriver(), seed=2)
    (note,) = compare({"x": [first, same], "y": [other]}).notes
    assert note == "campaigns of x have the same seed: they are no repeats"
    (note,) = compare({"x": [first, other], "y": [same]}).notes
    assert note == "the campaigns of x are no repeats: they differ in driver"


def test_groups_that_differ_in_more_than_one_thing_are_noted(tmp_path: Path) -> None:
    first = made(tmp_path, "a")
    other = made(tmp_path, "b", driver=DummyDriver(), map_size=None, strategy=Frenetic(seed=1))
    (note,) = compare({"x": [first], "y": [other]}).notes
    assert note == "the groups differ in more than one thing: strategy, driver"


def test_campaigns_of_other_lengths_or_without_an_end_are_noted(tmp_path: Path) -> None:
    first = made(tmp_path, "a")
    longer = made(tmp_path, "b", budget=Budget(simulations=4))
    notes = compare({"x": [first], "y": [longer]}).notes
    assert notes == (
        "the campaigns have from 2 to 4 simulations: compare failures per 100 simulations",
    )
    cut = store_of(tmp_path / "c", (Outcome.PASS,) * 2)
    notes = compare({"x": [first], "y": [cut]}).notes
    assert "campaigns of y did not finish: c" in notes
