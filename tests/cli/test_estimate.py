"""Estimates of how often a driver fails, against exact values and brute force."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from frenetic import Controls, DriveSetup, EmbeddedSimulator, Observation, Planner
from frenetic._support.arrays import FloatArray
from frenetic.analysis.statistics import rate_interval
from frenetic.campaign import RoadTester
from frenetic.campaign.record import Attempt
from frenetic.domain import Domain
from frenetic.errors import FreneticError
from frenetic.estimate import Estimate, estimate
from frenetic.oracle import Result
from frenetic.outcome import Outcome
from frenetic.road.classes import RoadClass
from frenetic.search.random_search import RandomRoads
from frenetic.search.records import Candidate

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

ENTRIES: dict[str, Any] = {
    "roads": "urban-50,length=200",
    "conditions": {"friction": {"low": 0.2, "high": 1.0}, "gust": {"low": 0.0, "high": 20.0}},
}
DOMAIN = Domain.made("town", ENTRIES)


@dataclass(frozen=True)
class Known(RoadTester):
    """Fails with a chance that is known: where friction and gust are both far from usual."""

    share: float = 0.1

    def test(self, candidate: Candidate) -> Attempt:
        conditions = candidate.conditions
        dry, calm = (conditions["friction"] - 0.2) / 0.8, 1.0 - conditions.get("gust", 0.0) / 20.0
        distance = max(dry, calm) - math.sqrt(self.share)
        outcome = Outcome.FAIL if distance < 0.0 else Outcome.PASS
        result = replace(_RESULT, outcome=outcome, moobd=distance)
        return Attempt(candidate.id, result, None, None)


def _passed() -> Result:
    from frenetic import Road
    from frenetic.oracle import judge

    road = Road([0.0] * 5)
    return judge(road, EmbeddedSimulator().drive(road, Planner()))


_RESULT = _passed()


def known(share: float) -> Known:
    assert DOMAIN.road_class is not None
    return Known(
        EmbeddedSimulator(),
        Planner(),
        map_size=DOMAIN.road_class.map_size,
        lane_width=DOMAIN.road_class.lane_width,
        road_class=DOMAIN.road_class,
        share=share,
    )


def per_1000_km(found: Estimate, share: float) -> float:
    return share / found.length * 1000.0


def test_common_failures_are_counted() -> None:
    found = estimate(DOMAIN, known(0.2), drives=400, seed=1)
    assert found.method == "plain"
    assert found.rate is not None
    assert found.drives == found.plain == 400
    assert found.low < per_1000_km(found, 0.2) < found.high
    assert "failures per 1,000 km" in found.in_words()


@pytest.mark.parametrize("share", [1e-3, 1e-5])
def test_rare_failures_are_drawn_more_often_and_weighed(share: float) -> None:
    drives, held = 3000, 0
    for seed in range(6):
        found = estimate(DOMAIN, known(share), drives=drives, seed=seed)
        assert found.method == "importance sampling"
        assert found.drives == drives
        held += found.low <= per_1000_km(found, share) <= found.high
        low, high = rate_interval(round(10 * drives * share), 1.0)
        if share > 1e-4:
            assert found.high / found.low < high / low, "ten times as many plain drives"
        else:
            assert found.high / found.low < 2.0, "plain drives had no failure"
    assert held >= 5


@dataclass(frozen=True)
class Winding(Known):
    """Fails where the road turns by more than an angle, in any conditions."""

    angle: float = 1.0

    def test(self, candidate: Candidate) -> Attempt:
        distance = self.angle - turn(candidate.curvatures)
        outcome = Outcome.FAIL if distance < 0.0 else Outcome.PASS
        return Attempt(candidate.id, replace(_RESULT, outcome=outcome, moobd=distance), None, None)


def turn(curvatures: FloatArray) -> float:
    return abs(float(curvatures.sum())) * 10.0


def test_where_the_road_decides_the_rest_are_plain_drives() -> None:
    rng = np.random.default_rng(5)
    roads = RandomRoads(road_class=DOMAIN.road_class)
    angle = float(np.quantile([turn(roads.made(rng)) for _ in range(50_000)], 1.0 - 3e-3))
    tester = replace(Winding(**vars(known(0.5))), angle=angle)
    held, plain = 0, []
    for seed in range(6):
        found = estimate(DOMAIN, tester, drives=6000, seed=seed)
        held += found.low <= per_1000_km(found, 3e-3) <= found.high
        assert found.drives == 6000
        plain.append(found.plain / found.drives)
    assert held >= 5
    assert max(plain) > 0.5


def test_it_says_what_it_cannot_know() -> None:
    found = estimate(DOMAIN, known(0.0), drives=300, seed=1)
    assert found.rate is None
    assert found.low == 0.0
    assert "give it more --drives" in found.note
    assert found.in_words().startswith("fewer than ")
    assert "two-sided" in found.in_words()
    assert (found.drives, found.failures, found.other_failures) == (300, 0, 0)
    assert found.high < 3.689 / found.kilometres * 1000.0, "drives in wider conditions count, too"


@pytest.mark.parametrize("share", [0.0, 2e-3])
def test_more_drives_tighten_the_limit_wherever_they_are_drawn(share: float) -> None:
    """Also where the other drives had the only failures, and so few that they carry nothing."""
    for seed in range(4):
        few, more = (estimate(DOMAIN, known(share), drives=n, seed=seed) for n in (200, 1000))
        assert more.high < 0.5 * few.high
        plain_alone = rate_interval(few.failures, few.kilometres / 1000.0)[1]
        assert few.high < plain_alone, "the other drives count, too"


def test_progress_counts_each_drive_up_to_the_total() -> None:
    for share in (0.0, 1e-3, 0.01, 0.2):
        counts: list[tuple[int, int]] = []
        estimate(DOMAIN, known(share), drives=333, on_drive=lambda *now: counts.append(now))  # noqa: B023
        assert [driven for driven, _ in counts] == list(range(1, 334))


def test_the_same_seed_gives_the_same_estimate() -> None:
    one, same, other = (estimate(DOMAIN, known(0.01), drives=500, seed=s) for s in (1, 1, 2))
    assert one == same
    assert one != other


def test_kilometres_are_those_that_the_car_drove() -> None:
    class Broken:
        def __init__(self, when: float) -> None:
            self.when = when

        def reset(self, setup: DriveSetup) -> None:
            pass

        def act(self, observation: Observation) -> Controls:
            if observation.time >= self.when:
                raise ValueError("lost")
            return Controls(0.0, throttle=0.5)

    terms = {"map_size": 400.0, "lane_width": 3.25, "road_class": DOMAIN.road_class}
    soon = RoadTester(EmbeddedSimulator(), Broken(0.5), **terms)  # type: ignore[arg-type]
    found = estimate(DOMAIN, soon, drives=100, seed=1)
    assert found.failures == found.plain
    assert 0.0 < found.length < 0.002, "km until half a second"
    never = RoadTester(EmbeddedSimulator(), Broken(0.0), **terms)  # type: ignore[arg-type]
    with pytest.raises(FreneticError, match="before the car moved"):
        estimate(DOMAIN, never, drives=100, seed=1)


def test_roads_are_those_that_are_driven() -> None:
    """Also where they are others than the domain's own."""
    longer = RoadClass.of("urban-50", {"length": 600.0})
    tester = RoadTester(EmbeddedSimulator(), Planner(), map_size=longer.map_size, road_class=longer)
    assert estimate(DOMAIN, tester, drives=100, seed=1).length > 0.3


def test_on_the_command_line(frenetic: Frenetic, tmp_path: Path) -> None:
    path = tmp_path / "icy.toml"
    path.write_text(
        'roads = "urban-50,length=200"\n[conditions]\nfriction = { low = 0.1, high = 0.6 }\n',
        encoding="utf-8",
    )
    words = ("estimate", "--odd", str(path), "--drives", "200")
    told = frenetic(*words)
    assert told.code == 0, told.err
    assert "failures per 1,000 km" in told.out
    assert frenetic(*words, "--json").json["domain"] == "icy"
    assert frenetic("run", "--odd", str(path), "--simulations", "20", "--out", "c").code == 0
    assert frenetic("estimate", "c", "--drives", "150").code == 0
    assert "how often" in frenetic("show", "c").out
    assert frenetic("report", "c").code == 0
    assert "failures per 1,000 km" in Path("c/report.html").read_text("utf-8")
    Path("c/estimate.json").write_text('{"domain": 3}')
    assert "estimate.json is damaged" in frenetic("show", "c").err
    assert frenetic("estimate").code == 2
    assert frenetic("run", "--simulations", "3", "--out", "d").code == 0
    assert "searched no domain" in frenetic("estimate", "d").err
    with pytest.raises(FreneticError):
        Domain.of(tmp_path / "none.toml")
