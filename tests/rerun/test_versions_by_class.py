"""Two versions of a driver on roads of several classes: verdicts, sentences and refusals."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_up_quality import drives
from repeats import recorded

from frenetic.analysis.quality_comparison import BETTER, MIXED, WORSE, QualityComparison
from frenetic.analysis.quality_differences import PairedQuality
from frenetic.analysis.quality_text import NO_DIFFERENCE
from frenetic.analysis.statistics import paired_share_difference
from frenetic.campaign import Budget, Campaign
from frenetic.conditions.domain import Domain
from frenetic.drivers import Driver, Planner, Stanley
from frenetic.errors import CampaignError
from frenetic.oracle.outcome import Outcome
from frenetic.rerun.back_to_back import CANNOT_TELL, BackToBack, back_to_back
from frenetic.rerun.disturbances import QualityPlan
from frenetic.rerun.paired_roads import Pair, PairedRoads
from frenetic.rerun.versions_by_class import VersionsByClass, campaigns_by_class
from frenetic.road.classes import class_of
from frenetic.search import RandomSearch
from frenetic.simulators import EmbeddedSimulator

NO_ROADS = PairedRoads(Path("c"), ())


def fresh(**pairs: int) -> PairedRoads:
    """Return roads by the outcomes of both versions: ``fail_pass=3``, ``pass_pass=20``."""
    driven: list[Pair] = []
    for name, number in pairs.items():
        old, new = (
            recorded(Outcome[word.upper()], None, duration=10.0, reason="broken")
            for word in name.split("_")
        )
        driven += [Pair(old, new)] * number
    return PairedRoads(Path("roads"), tuple(driven))


def result(roads: PairedRoads, *quality: PairedQuality) -> BackToBack:
    """Return a comparison on roads of one class."""
    return BackToBack(
        {"class": "a:Old"},
        {"class": "a:New"},
        {"class": "s:S"},
        0,
        roads,
        NO_ROADS,
        quality=QualityComparison.of(quality or (drives(),)),
    )


FIXED = fresh(fail_pass=20, pass_pass=20)
BROKEN = fresh(pass_fail=20, pass_pass=20)
ALIKE = fresh(pass_pass=40)


@pytest.mark.parametrize(
    ("results", "verdict", "overall"),
    [
        ([result(FIXED), result(ALIKE)], BETTER, BETTER),
        ([result(ALIKE), result(BROKEN)], WORSE, WORSE),
        ([result(FIXED), result(BROKEN)], MIXED, MIXED),
        ([result(ALIKE), result(ALIKE)], NO_DIFFERENCE, NO_DIFFERENCE),
        ([result(fresh(pass_error=40)), result(ALIKE)], CANNOT_TELL, CANNOT_TELL),
        ([result(fresh(pass_error=40)), result(FIXED)], BETTER, BETTER),
        ([result(ALIKE, drives(rms_offset=-0.2)), result(ALIKE)], NO_DIFFERENCE, BETTER),
        (
            [result(ALIKE, drives(rms_offset=-0.2)), result(ALIKE, drives(rms_offset=0.2))],
            NO_DIFFERENCE,
            MIXED,
        ),
        ([result(FIXED, drives(rms_offset=0.2)), result(ALIKE)], BETTER, BETTER),
    ],
)
def test_failures_decide_then_quality(
    results: list[BackToBack], verdict: str, overall: str
) -> None:
    compared = VersionsByClass.of(dict(zip(("town", "country"), results, strict=True)))
    assert (compared.verdict, compared.overall) == (verdict, overall)


def test_the_first_sentence_names_the_classes() -> None:
    results = {"town": result(ALIKE), "country": result(FIXED), "alley": result(ALIKE)}
    compared = VersionsByClass.of(results)
    first, second = compared.sentences
    assert first.startswith(
        "new is better on country (fails on 0 of 40 fresh roads, old on 20: -50"
    )
    assert "; no difference shown on town and alley (fails on 0 of 40 fresh roads, old on" in first
    assert second.startswith("quality: no difference shown on town, country and alley: alike")
    swaying = result(ALIKE, drives("noise 0.1 m", rms_offset=0.2))
    first, second = VersionsByClass.of({"town": result(ALIKE), "country": swaying}).sentences
    assert first.startswith("on country, with noise 0.1 m, new keeps 0.20 m farther from the mid")
    assert first.endswith("; no difference shown on town")
    assert second.startswith("failures: no difference shown on town and country (fails on 0 of 40")


def test_intervals_of_failures_are_corrected_for_the_classes() -> None:
    """A difference that is shown on one class alone is not shown beside nine others."""
    roads = fresh(fail_pass=7, pass_pass=40)
    alone = result(roads)
    assert alone.verdict == BETTER
    assert "95 % interval" in alone.answer
    compared = VersionsByClass.of({str(i): result(roads) for i in range(10)})
    assert compared.verdict == NO_DIFFERENCE
    old = np.array([1.0] * 7 + [0.0] * 40)
    expected = paired_share_difference(old, np.zeros(47), confidence=0.995)
    assert all(each.difference == expected for each in compared.classes.values())
    assert "99.5 % interval" in compared.classes["0"].answer
    assert any("corrected for 10 road classes" in note for note in compared.notes)


def test_quality_is_corrected_for_all_classes() -> None:
    compared = VersionsByClass.of({str(i): result(ALIKE, drives(rms_offset=0.2)) for i in "ab"})
    (alone,) = (d.p_corrected for d in result(ALIKE, drives(rms_offset=0.2)).quality.shown)  # type: ignore[union-attr]
    for quality in compared.qualities.values():
        assert [d.p_corrected for d in quality.shown] == [pytest.approx(2.0 * alone)]


def test_notes_name_their_classes_unless_they_hold_for_all() -> None:
    broke = fresh(pass_pass=40, pass_error=1)
    compared = VersionsByClass.of({"town": result(broke), "country": result(ALIKE)})
    broken, *_, corrected = compared.notes
    assert broken.startswith("town: the simulator broke in 1 drive with new")
    assert corrected.startswith("corrected for 2 road classes: intervals of failures are of 97.5 %")
    both = VersionsByClass.of({"town": result(ALIKE), "country": result(ALIKE)})
    assert "four times as many fresh roads, 160, halve the interval" in both.notes


def test_the_json_has_all_classes() -> None:
    compared = VersionsByClass.of({"town": result(ALIKE), "country": result(FIXED)})
    document = json.loads(json.dumps(compared.as_json()))
    assert document["overall"] == "new is better"
    assert document["sentences"] == list(compared.sentences)
    assert [*document["classes"]] == ["town", "country"]
    assert document["classes"]["country"]["verdict"] == "new is better"
    assert document["confidence"] == 0.975


def test_incomplete_and_other_comparisons_are_refused() -> None:
    missing = replace(result(ALIKE), quality=None, missing=3)
    with pytest.raises(ValueError, match="drives are missing on country"):
        VersionsByClass.of({"town": result(ALIKE), "country": missing})
    with pytest.raises(ValueError, match="there is no comparison"):
        VersionsByClass.of({})
    other = replace(result(ALIKE), new={"class": "a:Other"})
    with pytest.raises(ValueError, match="of different versions"):
        VersionsByClass.of({"town": result(ALIKE), "country": other})


# Campaigns


def searched(folder: Path, roads: str | None = None, **parts: Any) -> Path:
    """Run a campaign of one drive and return its folder."""
    road_class = None if roads is None else class_of(roads)
    options: dict[str, Any] = {
        "strategy": RandomSearch(seed=1, road_class=road_class),
        "simulator": EmbeddedSimulator(),
        "driver": Planner(),
    }
    Campaign(**(options | parts), budget=Budget(simulations=1), folder=folder).run()
    return folder


def test_campaigns_are_named_by_their_roads(tmp_path: Path) -> None:
    entries = {"roads": "urban-50", "conditions": {"friction": {"low": 0.5, "high": 1.0}}}
    town = searched(tmp_path / "t", "urban-50")
    country = searched(tmp_path / "c", "rural-80,length=600")
    competition = searched(tmp_path / "competition")
    assert campaigns_by_class([country, town, competition]) == {
        "rural-80": country,
        "urban-50": town,
        "competition": competition,
    }
    longer = searched(tmp_path / "longer", "rural-80,length=900")
    assert campaigns_by_class([country, longer]) == {
        f"rural-80 ({country})": country,
        f"rural-80 ({longer})": longer,
    }
    domain = Domain.from_entries("icy", entries)
    icy = searched(
        tmp_path / "icy",
        strategy=RandomSearch(seed=1, road_class=domain.road_class, domain=domain),
    )
    assert campaigns_by_class([icy]) == {"icy": icy}


def test_campaigns_with_equal_terms_or_other_parts_are_refused(tmp_path: Path) -> None:
    first, second = (searched(tmp_path / name, "urban-50") for name in "ab")
    with pytest.raises(CampaignError, match=r"a and .*b have the same roads and conditions"):
        campaigns_by_class([first, second])
    assert len(campaigns_by_class([first, second], on_own_roads=True)) == 2
    other = searched(tmp_path / "d", "rural-80", driver=Stanley())
    with pytest.raises(CampaignError, match=r"d has other parts than .*a: driver is stanley"):
        campaigns_by_class([first, other])
    simulator = searched(tmp_path / "s", "rural-80", simulator=EmbeddedSimulator(friction=0.5))
    with pytest.raises(CampaignError, match=r"s has other parts than .*a: simulator "):
        campaigns_by_class([first, simulator])


def test_a_version_is_better_on_the_class_on_which_it_is_better(tmp_path: Path) -> None:
    """A driver that takes bends too fast fails in town, not on straight country roads."""
    old: Driver = Stanley(offset_gain=0.3, yaw_damping=0.0)
    new: Driver = Stanley()
    results = {}
    for roads in ("urban-50,length=300", "rural-80,length=600"):
        rules = EmbeddedSimulator().rules
        simulator = EmbeddedSimulator(rules=replace(rules, speed_limit=60.0))
        folder = searched(tmp_path / roads, roads, simulator=simulator, driver=old)
        plan = QualityPlan(disturbances=[{"noise": 0.1}])
        results[roads] = back_to_back(folder, simulator, old, new, fresh=14, quality=plan)
    compared = VersionsByClass.of(results)
    assert compared.verdict == NO_DIFFERENCE
    shown = {
        name: {difference.measure.name for difference in quality.shown}
        for name, quality in compared.qualities.items()
    }
    assert all("rms_offset" in names for names in shown.values())
    for name, quality in compared.qualities.items():
        alone = results[name].quality
        assert alone is not None
        assert [d.p for d in quality.differences] == [d.p for d in alone.differences]
