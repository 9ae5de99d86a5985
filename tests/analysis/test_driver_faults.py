"""A drive whose driver breaks fails: in the search, among distinct failures, in minimising."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from sample_campaigns import search

from frenetic.analysis import measure_campaign
from frenetic.analysis.caution import caution
from frenetic.analysis.clusters import distinct_failures
from frenetic.campaign import CampaignStore, RoadTester
from frenetic.drivers import Controls, Observation, Planner
from frenetic.errors import Fault
from frenetic.oracle.outcome import Outcome
from frenetic.rerun.minimise import minimise
from frenetic.rerun.minimising_strategy import FailureReason
from frenetic.road import Road
from frenetic.search import Evaluation, Frenetic
from frenetic.simulators import EmbeddedSimulator


class Brittle(Planner):
    """Raises before sharp bends to the left."""

    def act(self, observation: Observation) -> Controls:
        if observation.curvature_ahead[:5].max() > 0.055:
            raise ValueError("too sharp")
        return super().act(observation)


class SteersWrong(Planner):
    """Steers to the other side."""

    def act(self, observation: Observation) -> Controls:
        controls = super().act(observation)
        return replace(controls, steering=-controls.steering)


def open_search(folder: Path, driver: Planner) -> CampaignStore:
    return CampaignStore.open(search(folder, Frenetic(seed=3), 60, driver=driver))


def test_a_line_that_raises_is_one_distinct_failure_and_comes_first(tmp_path: Path) -> None:
    with open_search(tmp_path / "c", Brittle()) as store:
        clusters, counts = distinct_failures(store), store.counts()
        raising = [test.id for test in store.tests(Outcome.FAIL) if test.result.fault]
        assert caution(store) == ""
    assert measure_campaign(tmp_path / "c").distinct_after[-1] == len(clusters)
    first, *others = clusters
    assert (counts.errors, list(first.ids)) == (0, raising)
    assert first.fault is not None
    assert first.description == f"raises ValueError at {first.fault.file}:{first.fault.line}"
    assert others, "other failures leave the lane"
    assert all(cause.fault is None for cause in others)
    rare = replace(clusters, clusters=(*others, replace(first, ids=first.ids[:1])))
    cause, *causes = rare.causes
    assert cause.fault == first.fault
    assert max(cause.failures for cause in causes) > cause.failures == 1, (
        "the fault comes first although it is rare"
    )


def test_minimising_a_fault_keeps_the_line_that_raises() -> None:
    road = Road([0.0, 0.02, 0.0, -0.03, -0.02, 0.0, 0.03, 0.065, 0.04, 0.0, -0.03, 0.0, 0.0])
    minimised = minimise(road, RoadTester(EmbeddedSimulator(), Brittle()))
    assert minimised.reason is FailureReason.DRIVER_BROKE
    assert minimised.road.length <= 40.0 < road.length
    before, after = minimised.original.result.fault, minimised.smallest.result.fault
    assert before == after != None  # noqa: E711


@pytest.mark.parametrize("has_moobd", [True, False])
def test_only_the_first_fault_of_a_line_becomes_a_parent(has_moobd: bool) -> None:
    """Without MOOBD, too: a process that ended loses its drive."""
    fault = Fault("driver", "ValueError", "mine.py", 41)
    strategy = Frenetic(seed=1, random_roads=5)
    parents: list[int] = []
    for number in range(1, 200):
        candidate = strategy.ask()
        parents += candidate.origin.parents
        broke = number in (4, 5)
        moobd = 1.5 if has_moobd or not broke else None
        outcome = Outcome.FAIL if broke else Outcome.PASS
        evaluation = Evaluation(
            candidate, outcome, moobd, number / 200, fault=fault if broke else None
        )
        strategy.tell(evaluation)
    assert parents.count(4) > 5 * parents.count(5)


def test_a_caution_warns_if_nearly_every_random_road_fails(tmp_path: Path) -> None:
    with open_search(tmp_path / "c", SteersWrong()) as store:
        assert " random roads fail: it may be the car, the speed" in caution(store)
    with open_search(tmp_path / "good", Planner()) as store:
        assert caution(store) == ""


def test_a_caution_says_how_little_passing_roads_prove(tmp_path: Path) -> None:
    with open_search(tmp_path / "c", Planner(aggression=0.5)) as store:
        assert not store.by_outcome()[Outcome.FAIL]
        match = re.fullmatch(
            r"(\d+) random roads passed, so fewer than ([\d.]+) % of such roads fail, with 95 %"
            " confidence; rarer failures take more roads",
            caution(store),
        )
    assert match is not None
    driven, most = int(match[1]), float(match[2]) / 100.0
    # If this share failed, all these roads would pass once in twenty times.
    assert (1.0 - most) ** driven == pytest.approx(0.05, abs=0.01)  # two digits
