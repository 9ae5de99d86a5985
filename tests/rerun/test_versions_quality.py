"""How well two versions drive where both pass: versions told apart, and versions that are alike."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from repeats import Counting

from frenetic.analysis.quality import drive_quality
from frenetic.analysis.quality_comparison import QualityComparison
from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.drivers import Driver, Planner, Stanley
from frenetic.errors import CampaignError, FreneticError
from frenetic.oracle.drive import Drive, Rules
from frenetic.oracle.outcome import Outcome
from frenetic.rerun import rerun
from frenetic.rerun.back_to_back import BackToBack, back_to_back
from frenetic.rerun.disturbances import QualityPlan, disturbed_conditions
from frenetic.rerun.old_version import fresh_roads
from frenetic.rerun.quality import paired_quality, paired_tests
from frenetic.road import Road
from frenetic.road.classes import class_of
from frenetic.search import RandomSearch
from frenetic.simulators import EmbeddedSimulator
from frenetic.testing.dummies import DummySimulator

FRESH = 16


class CopiedPlanner(Planner):
    """The planner in a class of its own, which drives uncompiled."""


class Broken(EmbeddedSimulator):
    """A simulator that breaks in each drive."""

    def drive(self, road: Road, driver: Driver) -> Drive:
        """Raise an error."""
        raise RuntimeError("broken")


@pytest.fixture(scope="module")
def rural(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a campaign on country roads."""
    return start(tmp_path_factory.mktemp("rural") / "c", Stanley(), "rural-80")


@pytest.fixture(scope="module")
def competition(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a campaign on roads by the competition's rules."""
    return start(tmp_path_factory.mktemp("competition") / "c", Planner())


def start(folder: Path, driver: Driver, roads: str | None = None) -> Path:
    """Run a campaign of one drive and return its folder."""
    road_class = None if roads is None else class_of(roads)
    simulator = EmbeddedSimulator(rules=Rules(speed_limit=80.0 if roads else 50.0))
    Campaign(
        strategy=RandomSearch(seed=1, road_class=road_class),
        simulator=simulator,
        driver=driver,
        budget=Budget(simulations=1),
        folder=folder,
    ).run()
    return folder


def simulator_of(folder: Path) -> EmbeddedSimulator:
    """Return the simulator of a campaign of `start`."""
    with CampaignStore.open(folder) as store:
        return EmbeddedSimulator(rules=store.setting.rules)


def compared(folder: Path, old: Driver, new: Driver, **options: Any) -> BackToBack:
    """Compare two versions on roads of a campaign."""
    simulator = options.pop("simulator", None) or simulator_of(folder)
    return back_to_back(folder, simulator, old, new, **{"fresh": FRESH, **options})


@pytest.fixture(scope="module")
def swaying(rural: Path) -> BackToBack:
    """Comparison of Stanley's law with one that returns to the middle slowly."""
    return compared(rural, Stanley(), Stanley(offset_gain=0.3, yaw_damping=0.0), fresh=24)


def test_a_slack_controller_is_told_apart_although_nothing_fails(swaying: BackToBack) -> None:
    assert swaying.fresh.failing == (0, 0)
    assert swaying.verdict == "no difference shown"
    assert swaying.overall == "new is worse"
    first, second = swaying.sentences
    assert first.startswith("with noise 0.1 m, new crosses the edge of its lane on ")
    assert "farther from the middle" in first
    assert second.startswith("failures: no difference shown: of 24 fresh roads")
    assert swaying.quality is not None
    edges = {
        difference.conditions: difference
        for difference in swaying.quality.differences
        if difference.measure.name == "edge_distance"
    }
    assert edges[""].new > 0.8
    assert edges["noise 0.1 m"].old > 0.3
    assert edges["noise 0.1 m"].new < edges["noise 0.1 m"].old - 0.3


ALIKE: list[tuple[str, Driver, Driver]] = [
    ("rural", Stanley(), Stanley(softening=2.01)),
    ("rural", Stanley(), Stanley(braking=2.9)),
    ("competition", Planner(), Planner(speed_gain=1.501)),
]


@pytest.mark.parametrize(("roads", "old", "new"), ALIKE, ids=["softening", "braking", "gain"])
def test_alike_versions_are_not_told_apart(
    roads: str, old: Driver, new: Driver, request: pytest.FixtureRequest
) -> None:
    result = compared(request.getfixturevalue(roads), old, new)
    assert result.quality is not None
    assert all(len(drives.pairs) > 10 for drives in result.quality.drives)
    assert result.overall == "no difference shown"
    assert result.sentences[1].startswith("quality: no difference shown: alike within ")


def test_a_copy_of_a_driver_drives_alike(competition: Path) -> None:
    noise = QualityPlan([{"noise": 0.1}])
    result = compared(competition, Planner(), CopiedPlanner(), fresh=7, quality=noise)
    assert result.quality is not None
    assert result.overall == "no difference shown"
    for difference in result.quality.differences:
        assert (difference.difference.value, difference.p) == (0.0, 1.0)


@pytest.mark.parametrize(("roads", "driver"), [("rural", Stanley()), ("competition", Planner())])
def test_other_noise_on_each_road_is_no_other_driver(
    roads: str, driver: Driver, request: pytest.FixtureRequest
) -> None:
    folder = request.getfixturevalue(roads)
    tester = rerun.tester_on_terms(folder, simulator_of(folder), driver)
    fresh = fresh_roads(folder, tester, fresh=FRESH)
    ids = fresh.tests
    first, second = (
        rerun.drive_tests(
            fresh.folder,
            tester,
            ids,
            {number: [{"noise": 0.1, "noise_seed": salt + number}] for number in ids},
            options={},
        )
        for salt in (1000, 2000)
    )
    drives = paired_quality(paired_tests(first, second), "noise 0.1 m")
    assert len(drives.pairs) > 10
    quality = QualityComparison.of([drives])
    offset = next(d for d in quality.differences if d.measure.name == "rms_offset")
    assert offset.difference.value != 0.0
    assert quality.verdict == "no difference shown"
    assert not quality.shown


def test_drives_of_a_comparison_are_made_once(competition: Path) -> None:
    simulator = Counting(rules=simulator_of(competition).rules)
    versions = Planner(), Planner(aggression=0.9)
    options: dict[str, Any] = {"simulator": simulator, "fresh": 4}
    first = compared(competition, *versions, **options)
    assert simulator.driven == 2 * 3 * 4
    assert compared(competition, *versions, **options).as_json() == first.as_json()
    assert simulator.driven == 2 * 3 * 4
    other_plan = QualityPlan([{"noise": 0.1}, {"load": 9.0}])
    other = compared(competition, *versions, **options, quality=other_plan)
    assert simulator.driven == 2 * 4 * 4, "only the new disturbance is driven"
    assert other.quality is not None
    assert [drives.conditions for drives in other.quality.drives] == [
        "",
        "noise 0.1 m",
        "load 9 kg",
    ]


def test_both_versions_are_disturbed_alike(rural: Path, swaying: BackToBack) -> None:
    folder = swaying.fresh.folder
    ids = [pair.old.id for pair in swaying.fresh.pairs]
    noise = disturbed_conditions(folder, ids, {"noise": 0.1})
    assert noise == disturbed_conditions(folder, ids, {"noise": 0.1})
    assert len({amounts["noise_seed"] for (amounts,) in noise.values()}) == len(ids)
    gusts = disturbed_conditions(folder, ids, {"gust": -5.0})
    lengths = {pair.old.id: pair.old.candidate.length for pair in swaying.fresh.pairs}
    for number, (amounts,) in gusts.items():
        assert amounts["gust"] == -5.0
        assert 0.15 * lengths[number] < amounts["gust_at"] < 0.85 * lengths[number]


def test_json_has_the_differences_and_curves(swaying: BackToBack) -> None:
    document: Any = json.loads(json.dumps(swaying.as_json(), allow_nan=False))
    quality = document["quality"]
    assert quality["sentence"] == document["sentences"][0]
    assert [drives["conditions"] for drives in quality["drives"]] == [
        "",
        "noise 0.1 m",
        "gust 10 m/s",
    ]
    rows = {(row["measure"], row["conditions"]): row for row in quality["differences"]}
    offset = rows["rms_offset", "noise 0.1 m"]
    assert (offset["unit"], offset["better"], offset["is_shown"]) == ("m", "less", True)
    assert offset["low"] <= offset["difference"] <= offset["high"]
    curves = {(row["measure"], row["over"], row["conditions"]): row for row in quality["curves"]}
    speeds = curves["rms_offset", "speed", "noise 0.1 m"]["points"]
    assert speeds[-1]["difference"] > 3.0 * abs(speeds[0]["difference"]), "it sways when fast"


def test_disturbances_are_checked_before_a_drive(rural: Path) -> None:
    before = set(rural.glob("rerun/*"))
    for disturbance, problem in (
        ({"nose": 0.1}, "unknown condition 'nose'"),
        ({"noise": -1.0}, "noise is -1: 0 to 10 m is needed"),
        ({"gust": 10.0, "gust_at": 50.0}, "gust_at is drawn for each road: leave it out"),
    ):
        with pytest.raises((FreneticError, ValueError), match=problem):
            compared(rural, Stanley(), Stanley(offset_gain=0.9), quality=QualityPlan([disturbance]))
    with pytest.raises(FreneticError, match="DummySimulator cannot vary gust"):
        compared(
            rural,
            Stanley(),
            Stanley(offset_gain=0.9),
            simulator=DummySimulator(),
            quality=QualityPlan([{"gust": 5.0}]),
        )
    assert set(rural.glob("rerun/*")) == before


def test_a_simulator_without_gusts_is_compared_without_them(rural: Path, tmp_path: Path) -> None:
    dummy = DummySimulator()
    result = compared(
        start(tmp_path / "c", Stanley()),
        Stanley(),
        Stanley(offset_gain=0.9),
        simulator=dummy,
        fresh=2,
    )
    assert result.quality is not None
    assert [drives.conditions for drives in result.quality.drives] == ["", "noise 0.1 m"]


def test_quality_is_compared_on_the_campaigns_roads(tmp_path: Path) -> None:
    folder = tmp_path / "c"
    simulator = Counting(rules=Rules(speed_limit=50.0))
    Campaign(
        strategy=RandomSearch(seed=2),
        simulator=simulator,
        driver=Planner(),
        budget=Budget(simulations=8),
        folder=folder,
    ).run()
    simulator.driven = 0
    plan = QualityPlan([{"noise": 0.2}], on_own_roads=True)
    options: dict[str, Any] = {"simulator": simulator, "fresh": 3, "quality": plan}
    result = compared(folder, Planner(), Planner(lookahead_time=0.6), **options)
    assert len(result.fresh.pairs) == 3
    assert result.quality is not None
    assert [len(drives.fails) for drives in result.quality.drives] == [8, 8]
    failing = len(result.known.pairs)
    assert simulator.driven == 3 + 3 + failing + 8 + 2 * 8
    assert any("own roads" in note for note in result.notes)
    usual = result.quality.drives[0]
    with CampaignStore.open(folder) as store:
        passing = list(store.tests(Outcome.PASS, with_trajectory=True))
    edges = {
        drive_quality(test.road, test.drive).values["edge_distance"]
        for test in passing
        if test.drive is not None
    }
    assert {old.values["edge_distance"] for old, _ in usual.pairs} <= edges
    again = compared(folder, Planner(), Planner(lookahead_time=0.6), **options)
    assert again.as_json() == result.as_json()
    assert simulator.driven == 3 + 3 + failing + 8 + 2 * 8


def test_a_campaign_without_a_judged_road_has_no_own_roads(tmp_path: Path) -> None:
    folder = tmp_path / "c"
    simulator = EmbeddedSimulator()
    campaign = Campaign(
        strategy=RandomSearch(seed=2),
        simulator=Broken(),
        driver=Planner(),
        budget=Budget(simulations=1),
        folder=folder,
    )
    with suppress(CampaignError):  # no drive could be judged
        campaign.run()
    plan = QualityPlan([{"noise": 0.2}], on_own_roads=True)
    options: dict[str, Any] = {"simulator": simulator, "fresh": 2, "quality": plan}
    result = compared(folder, Planner(), Planner(lookahead_time=0.6), **options)
    assert result.quality is not None
    assert result.quality.sentence == "no difference shown: there is no road that both pass"
