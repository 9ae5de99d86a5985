"""Comparisons of campaigns that ran, and of made-up measures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sample_campaigns import measures, search, store_of

from frenetic.analysis import comparison as comparison_module
from frenetic.analysis.campaign_measures import CampaignMeasures, measure_campaign
from frenetic.analysis.comparison import (
    Comparison,
    compare,
    compare_measured,
    repeats_needed,
)
from frenetic.analysis.comparison_text import pair_rows, verdict
from frenetic.analysis.groups import find_campaigns, group_campaigns
from frenetic.analysis.measures import MEASURES
from frenetic.analysis.statistics import holm
from frenetic.campaign import Budget, Campaign
from frenetic.drivers import Delayed, Planner
from frenetic.errors import CampaignError, FreneticError
from frenetic.oracle.outcome import Outcome
from frenetic.search import Frenetic2021, RandomSearch
from frenetic.spec.terms import Terms
from frenetic.testing import DummyDriver, DummySimulator

SIMULATIONS = 160
REPEATS = repeats_needed(2)


@pytest.fixture(scope="module")
def repeats(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with campaigns of each of two strategies."""
    parent = tmp_path_factory.mktemp("repeats")
    for seed in range(REPEATS):
        search(parent / f"frenetic-{seed}", Frenetic2021(seed=seed, max_redraws=10), SIMULATIONS)
        search(parent / f"random-{seed}", RandomSearch(seed=seed), SIMULATIONS)
    return parent


@pytest.fixture(scope="module")
def comparison(repeats: Path) -> Comparison:
    return compare({name: sorted(repeats.glob(f"{name}-*")) for name in ("frenetic", "random")})


# Two strategies that ran


def test_frenetic_finds_more_failures_than_random_search(comparison: Comparison) -> None:
    (pair,) = comparison.by("failures").pairs
    assert (pair.first, pair.second, pair.repeats) == ("frenetic", "random", (REPEATS, REPEATS))
    assert pair.a12 >= 0.8
    assert pair.magnitude == "large"
    assert pair.p < pair.p_corrected < 0.05
    assert pair.verdict == "the first is better"
    assert comparison.by("failures").pair_text(pair) == "frenetic has more than random"


def test_all_measures_but_those_of_a_study_are_compared(comparison: Comparison) -> None:
    names = [name for name in MEASURES if name not in ("passes_with_more_grip", "keeps_cause")]
    assert [by.measure.name for by in comparison.measures] == names
    assert comparison.headline.measure.name == next(iter(MEASURES))
    for by in comparison.measures:
        for name, values in by.values.items():
            assert by.quartiles(name).median == np.median(values)
    assert comparison.notes == ()
    main = [by.measure.name for by in comparison.main_measures]
    assert main == [name for name in names if MEASURES[name].is_main]
    with pytest.raises(KeyError, match="no measure is called 'speed'"):
        comparison.by("speed")


# Statistics of made-up groups


def group(*failures: int) -> tuple[CampaignMeasures, ...]:
    return tuple(measures(number, first=5) for number in failures)


def test_more_failures_are_better_and_a_later_first_failure_is_worse() -> None:
    quick = tuple(measures(10 + i, first=2 + i) for i in range(6))
    slow = tuple(measures(1 + i, first=20 + i) for i in range(6))
    comparison = compare_measured({"quick": quick, "slow": slow})
    for name in ("failures", "simulations_to_failure"):
        (pair,) = comparison.by(name).pairs
        assert pair.a12 == 1.0
        assert pair.p == pytest.approx(2 / 924)
        assert pair.verdict == "the first is better"
    reversed_groups = compare_measured({"slow": slow, "quick": quick})
    (pair,) = reversed_groups.by("simulations_to_failure").pairs
    assert pair.a12 == 0.0
    assert pair.verdict == "the second is better"
    by = reversed_groups.by("simulations_to_failure")
    ((_, text, a12, *_),) = pair_rows([by])
    assert (text, a12) == ("quick has less than slow", "1.00"), "A12 of the first group"
    assert by.pair_text(pair) == "quick has less than slow"
    assert by.positions == {"slow": 2, "quick": 1}


@pytest.mark.parametrize("repeats", [1, 4])
def test_fewer_than_five_repeats_give_no_verdict(repeats: int) -> None:
    by = compare_measured({"a": group(*range(50, 50 + repeats)), "b": group(*range(10))}).by(
        "failures"
    )
    assert by.pairs[0].a12 == 1.0
    assert by.pairs[0].better is None
    assert by.pair_text(by.pairs[0]) == "a and b: too few repeats to tell"


def test_p_values_are_corrected_for_all_pairs_and_measures() -> None:
    groups = {
        "a": group(9, 8, 7, 9, 8, 7, 9, 8),
        "b": group(5, 4, 6, 5, 4, 5, 4, 6),
        "c": group(5, 4, 6, 5, 3, 5, 4, 6),
    }
    comparison = compare_measured(groups)
    by = comparison.by("failures")
    assert [(pair.first, pair.second) for pair in by.pairs] == [
        ("a", "b"),
        ("a", "c"),
        ("b", "c"),
    ]
    tested = {by.measure.name for by in comparison.measures if by.is_tested}
    assert tested == {
        *("distinct_failures", "failures", "mean_distinct_failures", "mean_failures"),
    }
    assert comparison.tested_measures == 4
    pairs = [pair for by in comparison.measures if by.is_tested for pair in by.pairs]
    assert [pair.p_corrected for pair in pairs] == holm([pair.p for pair in pairs])
    assert min(pair.p_corrected for pair in pairs) == 12 * min(pair.p for pair in pairs)
    assert by.pairs[0].better == by.pairs[1].better == "a"
    assert by.pairs[2].better is None
    assert by.worse_than("a") == ("b", "c")
    assert by.worse_than("b") == by.worse_than("c") == ()


def test_a_measure_that_is_equal_in_all_campaigns_is_not_tested() -> None:
    groups = {"a": group(9, 8, 7, 9, 8), "b": group(5, 4, 6, 5, 4)}
    by = compare_measured(groups).by("simulations_to_failure")
    assert not by.is_tested
    assert (by.pairs[0].p, by.pairs[0].p_corrected, by.pairs[0].a12) == (1.0, 1.0, 0.5)
    same = compare_measured({"a": group(3, 3, 3, 3, 3), "b": group(3, 3, 3, 3, 3)})
    assert (same.tested_measures, same.notes) == (0, ())
    assert same.headline.pairs[0].verdict == "no difference shown"


def test_too_few_campaigns_for_all_measures_are_noted_and_give_no_verdict() -> None:
    few = {"a": group(50, 51, 52, 53, 54), "b": group(*range(5)), "c": group(*range(20, 25))}
    comparison = compare_measured(few)
    assert comparison.by("failures").pairs[0].a12 == 1.0
    assert comparison.by("failures").pairs[0].verdict == "too few repeats to tell"
    needed = comparison.repeats_needed
    assert needed > 5
    (note,) = comparison.notes
    assert f"make {needed} repeats each" in note
    assert verdict(comparison) == f"Too few repeats to tell: {needed} campaigns a group are needed."


def test_no_failure_is_worse_than_any_number() -> None:
    some = tuple(measures(1, first=100, sparseness=10.0 * i, min_moobd=0.31) for i in range(6))
    never = tuple(measures(0) for _ in range(6))
    comparison = compare_measured({"never": never, "some": some})
    for name in ("simulations_to_failure", "competition_sparseness"):
        assert (comparison.by(name).pairs[0].a12, comparison.by(name).pairs[0].better) == (
            0.0,
            "some",
        )
        assert comparison.by(name).text("never") == "none"
    assert comparison.by("competition_sparseness").text("some") == "25.0 (12.5 to 37.5)"
    assert all(
        by.measure.name != "min_moobd" for by in comparison.measures
    )  # some campaigns lack it


def test_groups_are_ordered_by_median_then_by_mean_rank() -> None:
    by = compare_measured({"c": group(1, 2), "a": group(9, 7), "b": group(8, 7)}).by("failures")
    # The ranks of 9 8 7 7 2 1 are 1 2 3.5 3.5 5 6.
    assert by.positions == {"c": 3, "a": 1, "b": 2}
    assert by.order == ("a", "b", "c")
    # The medians are 6, 5 and 5, the mean ranks 6, 4.67 and 5.67.
    groups = {"a": group(6, 6, 1), "b": group(5, 9, 5), "c": group(5, 8, 2)}
    by = compare_measured(groups).by("failures")
    assert by.order == ("a", "b", "c")
    assert by.positions == {"a": 1, "b": 2, "c": 3}
    alike = compare_measured({"a": group(3, 4), "b": group(4, 3), "c": group(1, 1)}).by("failures")
    assert list(alike.positions.values()) == [1, 1, 3]


@pytest.mark.parametrize("groups", range(2, 9))
def test_repeats_needed_is_the_least_number_that_can_show_a_difference(
    groups: int,
) -> None:
    def compared(repeats: int) -> Comparison:
        apart = {f"{i}": group(*range(20 * i, 20 * i + repeats)) for i in range(groups)}
        return compare_measured(apart)

    def is_shown(repeats: int) -> bool:
        return any(pair.better for pair in compared(repeats).headline.pairs)

    needed = compared(1).repeats_needed
    assert needed == repeats_needed(groups, compared(1).tested_measures)
    assert is_shown(needed)
    assert not is_shown(needed - 1)
    assert needed <= repeats_needed(groups)


def test_two_groups_need_seven_repeats_and_nineteen_ten() -> None:
    assert repeats_needed(2) == 7
    assert [repeats_needed(19), repeats_needed(20)] == [10, 11]


# Groups of campaigns


def test_campaigns_that_differ_only_in_the_seed_are_a_group(
    repeats: Path,
) -> None:
    groups = group_campaigns(find_campaigns(repeats))
    assert list(groups) == ["frenetic-2021", "random"]
    assert [folder.name for folder in groups["frenetic-2021"]] == [
        f"frenetic-{i}" for i in range(REPEATS)
    ]
    assert len(groups["random"]) == REPEATS


def tiny_campaign(folder: Path, name: str, seed: int = 1, **options: object) -> Path:
    """Run a campaign of a few drives with some other parts."""
    parts: dict[str, object] = {
        "strategy": RandomSearch(seed=seed),
        "simulator": DummySimulator(),
        "driver": Planner(),
        "budget": Budget(simulations=2),
        **options,
    }
    Campaign(folder=folder / name, **parts).run()  # type: ignore[arg-type]
    return folder / name


def test_names_of_groups_say_only_their_differences(tmp_path: Path) -> None:
    folders = [
        tiny_campaign(tmp_path, "a"),
        tiny_campaign(tmp_path, "b", driver=Planner(aggression=0.5, braking=3.0)),
        tiny_campaign(tmp_path, "c", driver=Delayed(Planner(), seconds=0.1)),
        tiny_campaign(tmp_path, "d", driver=Delayed(Planner(), seconds=0.2)),
        tiny_campaign(tmp_path, "e", driver=DummyDriver()),
    ]
    assert list(group_campaigns(folders)) == [
        "planner,aggression=1,braking=2.2",
        "planner,aggression=0.5,braking=3",
        "Delayed,seconds=0.1 over planner",
        "Delayed,seconds=0.2 over planner",
        "DummyDriver",
    ]
    budgets = [folders[0], tiny_campaign(tmp_path, "f", budget=Budget(simulations=3))]
    assert list(group_campaigns(budgets)) == ["simulations=2", "simulations=3"]
    assert list(group_campaigns(folders[:1])) == ["all"]


def test_find_campaigns_takes_a_campaign_or_a_folder_of_campaigns(
    repeats: Path, tmp_path: Path
) -> None:
    campaign = repeats / "random-1"
    assert find_campaigns(campaign) == [campaign]
    assert len(find_campaigns(repeats)) == 2 * REPEATS
    with pytest.raises(CampaignError, match="holds no campaign"):
        find_campaigns(tmp_path)
    with pytest.raises(CampaignError, match="is no folder"):
        find_campaigns(tmp_path / "nowhere")


# Limits of a comparison


def test_a_single_group_an_empty_group_and_repeated_campaigns_are_refused(repeats: Path) -> None:
    with pytest.raises(FreneticError, match="1 group of campaigns: at least two"):
        compare({"a": [repeats / "random-1", repeats / "random-2"]})
    with pytest.raises(FreneticError, match="group b has no campaigns"):
        compare({"a": [repeats / "random-1"], "b": []})
    for groups in (
        {"a": ["random-1", "random-1"], "b": ["random-2"]},
        {"a": ["random-1"], "b": ["random-1"]},
    ):
        with pytest.raises(FreneticError, match=r"random-1 is there twice"):
            compare(
                {name: [repeats / folder for folder in group] for name, group in groups.items()}
            )


def test_campaigns_that_are_no_repeats_are_noted(tmp_path: Path) -> None:
    first, repeat = tiny_campaign(tmp_path, "a"), tiny_campaign(tmp_path, "b")
    other = tiny_campaign(tmp_path, "c", driver=DummyDriver(), seed=2)
    _, note = compare({"x": [first, repeat], "y": [other]}).notes
    assert note == "campaigns of x have the same seed: they are no repeats"
    (note,) = compare({"x": [first, other], "y": [repeat]}).notes
    assert note == "the campaigns of x are no repeats: they differ in driver"


def test_groups_that_differ_in_several_parts_are_noted(tmp_path: Path) -> None:
    first = tiny_campaign(tmp_path, "a")
    other = tiny_campaign(
        tmp_path,
        "b",
        driver=DummyDriver(),
        strategy=Frenetic2021(seed=1, max_redraws=10),
    )
    about_drivers, note = compare({"x": [first], "y": [other]}).notes
    assert "compare one campaign with the other driver" in about_drivers
    assert note == "the groups differ in more than one thing: strategy, driver"


def test_searches_with_another_look_ahead_are_noted(tmp_path: Path) -> None:
    first = tiny_campaign(tmp_path, "a", max_in_flight=1)
    ahead = tiny_campaign(tmp_path, "b", max_in_flight=16)
    (note,) = compare({"x": [first], "y": [ahead]}).notes
    assert note.startswith("the searches propose 1 and 16 roads before they know the result of")
    again = tiny_campaign(tmp_path, "c", max_in_flight=1, seed=2)
    assert compare({"x": [first], "y": [again]}).notes == ()


def test_campaigns_of_equal_kilometres_may_differ_in_simulations(tmp_path: Path) -> None:
    def search(name: str, size: float) -> Path:
        strategy = RandomSearch(seed=1, map_size=size)
        terms = Terms(map_size=size)
        budget = Budget(kilometres=1.0)
        return tiny_campaign(tmp_path, name, strategy=strategy, terms=terms, budget=budget)

    short, long = search("short", 60.0), search("long", 300.0)
    assert measure_campaign(short).simulations > 2 * measure_campaign(long).simulations
    assert not any("simulations" in note for note in compare({"x": [short], "y": [long]}).notes)


def test_campaigns_in_other_conditions_are_no_repeats(tmp_path: Path) -> None:
    noisy = tiny_campaign(tmp_path, "noisy", terms=Terms(conditions={"noise": 0.2}))
    usual = tiny_campaign(tmp_path, "usual", seed=2)
    groups = group_campaigns([noisy, usual])
    assert groups == {"with noise 0.2 m": [noisy], "in the usual conditions": [usual]}
    assert compare(groups).shared["driver"] == "planner"
    noisy_repeat = tiny_campaign(tmp_path, "repeat", seed=2, terms=Terms(conditions={"noise": 0.2}))
    assert compare({"x": [noisy], "y": [noisy_repeat]}).shared["conditions"] == "noise 0.2 m"


def test_campaigns_of_different_lengths_and_unfinished_campaigns_are_noted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = tiny_campaign(tmp_path, "a")
    longer = tiny_campaign(tmp_path, "b", budget=Budget(simulations=4))
    notes = compare({"x": [first], "y": [longer]}).notes
    assert notes == (
        "the campaigns have from 2 to 4 simulations, and more find more: compare campaigns of equal"
        " length, or look at the curves",
    )
    monkeypatch.setattr(comparison_module, "MOST_LINKED", -1)
    notes = compare({"x": [first], "y": [longer]}).notes
    assert "are compared in behaviour, bend and driven road" in notes[-1]
    cut = store_of(tmp_path / "c", (Outcome.PASS,) * 2)
    notes = compare({"x": [first], "y": [cut]}).notes
    assert "campaigns of y did not finish: c" in notes
