"""Domains: files, distributions, and campaigns inside a domain."""

from __future__ import annotations

from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from frenetic import Campaign, CampaignStore, Evaluation, Outcome
from frenetic.conditions.condition import SEED, as_text
from frenetic.conditions.domain import Distribution, Domain
from frenetic.errors import FreneticError
from frenetic.search import Frenetic, RandomSearch
from frenetic.search.conditions import moved_along
from frenetic.search.road_families import FAMILIES
from frenetic.spec import SPEC_FILE, Spec

TEXT = """
about = "Town roads in all weather"
roads = "urban-50,length=400"

[conditions]
friction = { low = 0.3, high = 1.0, mean = 0.85, deviation = 0.2 }
gust = { low = -18, high = 18, mean = 0, deviation = 8 }
wet = { low = 0.4, high = 0.9, chance = 0.3 }
noise = { low = 0.0, high = 0.2 }
load = 150
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """The file of a domain."""
    path = tmp_path / "town.toml"
    path.write_text(TEXT, encoding="utf-8")
    return path


def test_a_file_describes_a_domain(path: Path) -> None:
    domain = Domain.of(path)
    assert domain.name == "town"
    assert domain.road_class is not None
    assert (domain.road_class.name, domain.road_class.length) == ("urban-50", 400.0)
    assert domain.axes == ("friction", "wet", "gust", "load", "noise", "wet_at", "gust_at", SEED)
    assert "gust -18 to 18 m/s" in domain.as_text()
    assert "wet 0.4 to 0.9 in 30 %" in domain.as_text()
    assert Domain.from_entries("x", domain.entries()) == domain


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[conditions]\ngrip = 1", "unknown condition 'grip'"),
        ("[conditions]\nfriction = 9", "friction is from 9 to 9: 0.01 to 1.5 is needed"),
        ("[conditions]\nfriction = {low = 1}", "friction: .*high"),
        ("[conditions]\nfriction = {low = 1, high = 0.5}", "low is 1: at most high"),
        ("[conditions]\nfriction = {low = 0.5, high = 1, mean = 1}", "mean and deviation"),
        ("[conditions]\ngust = {low = 9, high = 12, mean = 0, deviation = 1}", "leave nothing"),
        ("[conditions]\nfriction = {low = 0.5, high = 1, chance = 0}", "chance is 0"),
        ("[conditions]\nfriction = 'wet'", "friction: "),
        ("[conditions]\ngust_at = 9", "gust_at follows from gust"),
        ("road = 'x'", "there is no entry road: about, roads and conditions are"),
        ("conditions = 3", "conditions are names"),
        ("roads = 'rural-81'", "there is no road class 'rural-81'"),
        ("roads = 3", "no road class"),
        ("x = ", "town.toml is no TOML file: Invalid value"),
        ("TAXONOMY:\n  friction: float", "town.toml is no TOML file"),
    ],
)
def test_a_wrong_file_is_a_one_line_error(path: Path, text: str, message: str) -> None:
    path.write_text(text, encoding="utf-8")
    with pytest.raises(FreneticError, match=message) as caught:
        Domain.of(path)
    assert "\n" not in str(caught.value)


@given(st.floats(0.0, 1.0))
def test_share_and_amount_are_inverse_functions(share: float) -> None:
    for distribution in (
        Distribution(low=-2.0, high=6.0),
        Distribution(low=-18.0, high=18.0, mean=3.0, deviation=8.0),
    ):
        amount = distribution.amount(share)
        assert amount is not None
        assert distribution.low <= amount <= distribution.high
        assert distribution.share(amount) == pytest.approx(share, abs=1e-6)


def test_amounts_are_distributed_as_declared(path: Path) -> None:
    domain, rng = Domain.of(path), np.random.default_rng(1)
    drawn = [domain.at(rng.random(domain.dimension), 400.0) for _ in range(4000)]
    friction = np.array([conditions["friction"] for conditions in drawn])
    assert friction.min() >= 0.3
    assert friction.max() <= 1.0
    # A normal distribution cut at both ends, by its formula.
    normal = NormalDist(0.85, 0.2)
    low, high = normal.cdf(0.3), normal.cdf(1.0)
    for at in (0.6, 0.8, 0.95):
        assert np.mean(friction < at) == pytest.approx(
            (normal.cdf(at) - low) / (high - low), abs=0.03
        )
    wet = [conditions for conditions in drawn if "wet" in conditions]
    assert len(wet) / 4000 == pytest.approx(0.3, abs=0.03)
    assert all(("wet_at" in conditions) == ("wet" in conditions) for conditions in drawn)
    assert np.mean([conditions["gust_at"] for conditions in drawn]) == pytest.approx(200.0, abs=8.0)
    assert {conditions["load"] for conditions in drawn} == {150.0}
    assert len({conditions[SEED] for conditions in drawn}) == 4000


def test_conditions_are_restored_from_their_shares(path: Path) -> None:
    domain, rng = Domain.of(path), np.random.default_rng(2)
    for _ in range(50):
        conditions = domain.at(rng.random(domain.dimension), 400.0)
        restored = domain.at(domain.shares_of(conditions, 400.0), 400.0)
        assert restored.keys() == conditions.keys()
        for name, amount in conditions.items():
            assert restored[name] == pytest.approx(amount, rel=2e-3, abs=0.2)


def test_places_of_conditions_move_with_the_length_of_the_road() -> None:
    conditions = {"friction": 0.5, "wet": 0.4, "wet_at": 30.0, "gust": 9.0, "gust_at": 100.0}
    assert moved_along(conditions, -40.0) == {"friction": 0.5, "gust": 9.0, "gust_at": 60.0}
    assert moved_along(conditions, 10.0)["wet_at"] == 40.0
    assert as_text(conditions) == "friction 0.5, wet 0.4 at 30 m, gust 9 m/s at 100 m"


@pytest.mark.parametrize("name", ["frenetic", pytest.param("random", marks=pytest.mark.heavy)])
def test_a_resumed_campaign_in_a_domain_equals_an_uninterrupted_one(
    name: str, path: Path, tmp_path: Path
) -> None:
    domain = Domain.of(path)
    spec = Spec(strategy=name, odd=domain.entries(), seed=3, max_in_flight=4, simulations=60)
    whole = Campaign.of(spec, folder=tmp_path / "whole", workers=1)
    whole.run()
    parts = Campaign.of(spec, folder=tmp_path / "parts", workers=1)
    parts.run(20)
    resumed = Campaign.of(spec, folder=tmp_path / "parts", workers=1)
    resumed.resume()
    with CampaignStore.open(tmp_path / "whole") as a, CampaignStore.open(tmp_path / "parts") as b:
        tests, resumed_tests = list(a.tests()), list(b.tests())
        assert [test.candidate.conditions for test in tests] == [
            test.candidate.conditions for test in resumed_tests
        ]
        assert [test.outcome for test in tests] == [test.outcome for test in resumed_tests]
        assert all(test.candidate.conditions for test in tests if test.outcome.is_driven)
        assert a.setting.domain == domain
    written = Spec.read(tmp_path / "whole" / SPEC_FILE)
    assert written.domain == domain
    assert written.road_class == domain.road_class


def test_without_a_domain_candidates_have_no_conditions() -> None:
    for kind in (Frenetic, RandomSearch):
        strategy: Any = kind(seed=1)
        for _ in range(5):
            assert strategy.ask().conditions == {}


def test_before_the_first_failure_half_of_the_roads_have_rare_conditions() -> None:
    rare = {"low": 0.1, "high": 0.3, "chance": 0.1}
    domain = Domain.from_entries(
        "x", {"conditions": {"delay": rare, "load": {"low": 0, "high": 300}}}
    )
    shares = {}
    for kind in (Frenetic, RandomSearch):
        strategy: Any = kind(seed=1, domain=domain)
        drawn = [strategy.ask().conditions for _ in range(400)]
        delays = [conditions["delay"] for conditions in drawn if "delay" in conditions]
        shares[kind] = len(delays) / len(drawn)
        # Delays are spread evenly over their range, as loads are.
        assert np.quantile(delays, (0.1, 0.5, 0.9)) == pytest.approx((0.12, 0.2, 0.28), abs=0.03)
        loads = [conditions["load"] for conditions in drawn]
        assert np.quantile(loads, (0.1, 0.5, 0.9)) == pytest.approx((30, 150, 270), abs=25)
    assert shares[Frenetic] == pytest.approx(0.5, abs=0.08)
    assert shares[RandomSearch] == pytest.approx(0.1, abs=0.05)


def test_after_a_failure_conditions_are_drawn_from_the_domain() -> None:
    rare = {"low": 0.1, "high": 0.3, "chance": 0.1}
    domain = Domain.from_entries("x", {"conditions": {"delay": rare}})
    strategy = Frenetic(seed=1, domain=domain, random_roads=300)
    first = strategy.ask()
    strategy.tell(Evaluation(first, Outcome.FAIL, -1.0, 0.001))
    candidates = [strategy.ask() for _ in range(250)]
    drawn = [
        candidate.conditions for candidate in candidates if candidate.origin.operator in FAMILIES
    ]
    assert len(drawn) > 200
    assert sum("delay" in conditions for conditions in drawn) / len(drawn) == pytest.approx(
        0.1, abs=0.06
    )
