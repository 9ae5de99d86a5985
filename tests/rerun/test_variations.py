"""Reruns and comparisons of tests of a domain, in recorded or other conditions."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from frenetic.analysis.comparison import compare
from frenetic.analysis.groups import group_campaigns
from frenetic.campaign import Budget, Campaign, CampaignStore, Test
from frenetic.conditions.condition import SEED
from frenetic.conditions.domain import Domain
from frenetic.drivers import Planner
from frenetic.errors import FreneticError
from frenetic.oracle.outcome import Outcome
from frenetic.rerun.back_to_back import back_to_back
from frenetic.rerun.rerun import rerun
from frenetic.rerun.reruns import Rerun, own_repeats
from frenetic.rerun.stability import Stability
from frenetic.rerun.variations import Variation
from frenetic.search import RandomSearch
from frenetic.simulators import EmbeddedSimulator
from frenetic.testing import DummySimulator

ENTRIES: dict[str, Any] = {
    "roads": "urban-50,length=250",
    "conditions": {
        "friction": {"low": 0.15, "high": 1.0},
        "gust": {"low": -18.0, "high": 18.0, "chance": 0.7},
        "delay": {"low": 0.0, "high": 0.3, "chance": 0.5},
        "noise": {"low": 0.0, "high": 0.3, "chance": 0.5},
    },
}


def run_campaign(
    folder: Path, entries: dict[str, Any], *, seed: int = 1, name: str = "town"
) -> Path:
    domain = Domain.from_entries(name, entries)
    assert domain.road_class is not None
    Campaign(
        strategy=RandomSearch(seed=seed, road_class=domain.road_class, domain=domain),
        simulator=EmbeddedSimulator(rules=None),
        driver=Planner(),
        budget=Budget(simulations=25),
        folder=folder,
    ).run()
    return folder


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_campaign(tmp_path_factory.mktemp("town") / "c", ENTRIES)


@pytest.fixture
def campaign(town: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(town, tmp_path / "c"))


def driven_tests(folder: Path, outcome: Outcome | None = None) -> list[Test]:
    with CampaignStore.open(folder) as store:
        return [test for test in store.tests(outcome) if test.outcome.is_driven]


def rerun_tests(folder: Path, simulator: EmbeddedSimulator | None = None, **others: Any) -> Rerun:
    return rerun(folder, simulator or EmbeddedSimulator(), Planner(), **others)


@pytest.mark.parametrize("workers", [1, 2])
def test_a_test_is_driven_again_in_its_recorded_conditions(campaign: Path, workers: int) -> None:
    tests = driven_tests(campaign)
    result = rerun_tests(campaign, tests=[test.id for test in tests], workers=workers)
    assert {test.outcome for test in tests} == {Outcome.PASS, Outcome.FAIL}
    assert any(SEED in test.candidate.conditions for test in tests)
    assert result.same == len(tests) == 25
    assert [test.conditions for test in result.drives] == [
        test.candidate.conditions for test in tests
    ]
    assert [test.conditions for test in result.tests] == [
        test.candidate.conditions for test in tests
    ]


def test_a_usual_range_lies_around_each_tests_amount(
    campaign: Path,
) -> None:
    tests = driven_tests(campaign, Outcome.FAIL)[:3]
    ids = [test.id for test in tests]
    fixed = rerun_tests(campaign, tests=ids, times=4, vary=[Variation("friction", 0.5, 0.7)])
    amounts = [[drive.conditions["friction"] for drive in test.drives] for test in fixed.tests]
    assert amounts[0] == amounts[1] == amounts[2]
    usual = Variation.usual("friction", EmbeddedSimulator())
    around = rerun_tests(campaign, tests=ids, times=4, vary=[usual])
    for test, repeats in zip(tests, around.tests, strict=True):
        recorded = dict(test.candidate.conditions)
        friction = recorded.pop("friction")
        (variation,) = repeats.variations
        assert (variation.low, variation.high) == pytest.approx((0.8 * friction, 1.2 * friction))
        for drive in repeats.drives:
            amount = drive.conditions["friction"]
            assert 0.8 * friction <= amount <= 1.2 * friction
            assert drive.conditions == recorded | {"friction": amount}
        assert repeats.conditions == recorded
        assert repeats.is_own


def test_amounts_of_the_parts_override_recorded_amounts(campaign: Path) -> None:
    test = next(test for test in driven_tests(campaign) if "gust" in test.candidate.conditions)
    recorded = dict(test.candidate.conditions)
    result = rerun_tests(
        campaign,
        EmbeddedSimulator(friction=0.5),
        tests=[test.id],
        times=2,
        instead=["friction", "gust"],
    )
    expected = {k: v for k, v in recorded.items() if k not in {"friction", "gust", "gust_at"}}
    assert [drive.conditions for drive in result.drives] == [expected] * 2
    assert not result.tests[0].is_own
    calm = rerun_tests(campaign, tests=[test.id], times=2, instead=["gust"])
    assert calm.simulator == rerun_tests(campaign, tests=[test.id]).simulator
    assert not calm.tests[0].is_own, (
        "the parts are those of the campaign, the conditions are others"
    )
    assert calm.tests[0].stability is not Stability.REPEATABLE
    assert own_repeats([calm]) == []
    usual = Variation.usual("friction", EmbeddedSimulator(friction=0.5))
    around = rerun_tests(
        campaign,
        EmbeddedSimulator(friction=0.5),
        tests=[test.id],
        times=2,
        vary=[usual],
        instead=["friction"],
    )
    assert around.tests[0].variations == (usual,), "around the simulator's amount"


def test_a_simulator_without_the_conditions_is_refused_before_a_drive(campaign: Path) -> None:
    with pytest.raises(FreneticError, match="DummySimulator cannot vary friction"):
        rerun(campaign, DummySimulator(), Planner())
    assert not (campaign / "rerun").exists()


# Two versions of a driver


def test_versions_are_compared_in_the_domain(campaign: Path) -> None:
    result = back_to_back(
        campaign, EmbeddedSimulator(), Planner(), Planner(aggression=0.8), fresh=6
    )
    folder = result.fresh.folder
    with CampaignStore.open(folder) as store, CampaignStore.open(campaign) as original:
        assert store.setting.domain == original.setting.domain == result.domain
        assert store.setting.road_class == original.setting.road_class is not None
    for old, new in (*result.fresh.pairs, *result.known.pairs):
        assert "friction" in old.candidate.conditions
        assert old.candidate.conditions == new.candidate.conditions


# Groups of campaigns


def test_campaigns_of_different_domains_are_no_repeats(town: Path, tmp_path: Path) -> None:
    second = run_campaign(tmp_path / "second", ENTRIES, seed=2)
    icy = ENTRIES["conditions"] | {"friction": {"low": 0.15, "high": 0.4}}
    ice = run_campaign(tmp_path / "ice", ENTRIES | {"conditions": icy})
    named = run_campaign(tmp_path / "named", ENTRIES, name="village")
    longer = run_campaign(tmp_path / "longer", ENTRIES | {"roads": "urban-50,length=260"})
    assert [len(folders) for folders in group_campaigns([town, second]).values()] == [2]
    groups = group_campaigns([town, second, ice])
    assert groups == {
        "in town: friction 0.15 to 1": [town, second],
        "in town: friction 0.15 to 0.4": [ice],
    }
    assert list(group_campaigns([town, named])) == ["in town", "in village"]
    assert list(group_campaigns([town, longer])) == [
        "on urban-50(length=250)",
        "on urban-50(length=260)",
    ]
    comparison = compare({"a": [town, ice], "b": [second]})
    assert "the campaigns of a are no repeats: they differ in domain" in comparison.notes
    domain = compare({"a": [town], "b": [second]}).shared["domain"]
    assert domain.startswith("town: friction 0.15 to 1, gust")
