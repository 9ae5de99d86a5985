"""Studies of stability: which failures fail again with hardly other grip, and keep their cause."""

from __future__ import annotations

import signal
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from events import on_result

from frenetic.analysis.failure_stability import STABILITY, FailureStability, Grip
from frenetic.analysis.statistics import Share
from frenetic.campaign import Budget, Campaign, CampaignStore, Summary
from frenetic.campaign.check import check_campaign
from frenetic.drivers import Driver, Planner
from frenetic.errors import CampaignError, Fault, FreneticError, Trouble
from frenetic.oracle.drive import Drive, Trajectory
from frenetic.oracle.outcome import Outcome
from frenetic.rerun.reruns import read_reruns
from frenetic.rerun.stability_study import StabilityStudy, study_stability
from frenetic.road import Road
from frenetic.search import Candidate, RandomSearch
from frenetic.simulators import EmbeddedSimulator
from frenetic.spec.terms import Terms
from frenetic.testing import DummyDriver, DummySimulator

pytest_plugins = ["searched_campaign"]
RAISES = Fault("driver", "KeyError", "theirs.py", 3)


class Slippery(DummySimulator):
    """Simulator in which the grip at which a failure vanishes or has another cause is known.

    In the recorded grip every road fails. A third of the roads also fail in each other grip, a
    third pass with more, and a third have a fault with less.
    """

    def __init__(self, friction: float = 1.0) -> None:
        super().__init__()
        self.friction = friction
        self.usual = friction
        self.frictions: list[float] = []

    @staticmethod
    def kind(road: Road) -> int:
        return int(1000.0 * road.length) % 3

    def drive(self, road: Road, driver: Driver) -> Drive:
        self.frictions.append(self.friction)
        passes = self.friction > self.usual and self.kind(road) == 1
        raises = self.friction < self.usual and self.kind(road) == 2
        self.drift = lambda _: 0.0 if passes else 6.0
        drive = super().drive(road, driver)
        if not raises:
            return drive
        return replace(
            drive, trajectory=Trajectory.empty(), trouble=Trouble("raises", fault=RAISES)
        )


class Varied(RandomSearch):
    """Random search whose roads have a friction of their own."""

    def ask(self) -> Candidate:
        candidate = super().ask()
        return replace(candidate, conditions={"friction": 0.5 + 0.01 * candidate.id})


def searched(
    folder: Path, simulator: DummySimulator, simulations: int = 24, **options: Any
) -> Path:
    given = {"strategy": RandomSearch(seed=1), **options}
    Campaign(
        simulator=simulator,
        driver=DummyDriver(),
        budget=Budget(simulations=simulations),
        folder=folder,
        **given,
    ).run()
    return folder


def kept(folder: Path) -> FailureStability | None:
    with CampaignStore.open(folder) as store:
        return FailureStability.read(store.facts)


@pytest.fixture
def slippery(tmp_path: Path) -> Path:
    return searched(tmp_path / "c", Slippery())


def kinds_of(folder: Path) -> Counter[int]:
    with CampaignStore.open(folder) as store:
        return Counter(Slippery.kind(test.road) for test in store.tests(Outcome.FAIL))


def test_the_shares_are_those_of_a_simulator_whose_answer_is_known(slippery: Path) -> None:
    kinds = kinds_of(slippery)
    failures = kinds.total()
    assert min(kinds.values()) >= 4
    study = study_stability(slippery, Slippery(), DummyDriver())
    total = study.stability.total
    assert total.failures == failures == 24
    assert total.again.fails == total.again.keeps_cause == Share(24, 24)
    assert total.less_grip.fails == Share(24, 24)
    assert total.less_grip.keeps_cause == Share(24 - kinds[2], 24)
    assert total.more_grip.fails == Share(24 - kinds[1], 24)
    assert total.more_grip.keeps_cause == Share(24 - kinds[1], 24 - kinds[1])
    assert total.passes_with_more_grip == Share(kinds[1], 24)
    assert total.keeps_cause == Share(24 - kinds[2], 24)
    with CampaignStore.open(slippery) as store:
        passing = [test.id for test in store.tests() if Slippery.kind(test.road) == 1]
    assert study.passing_with_more_grip == passing
    text = f"of 24 failures, {kinds[1]} pass with 2 % more grip; "
    assert study.stability.as_text().startswith(text)
    assert study.stability == kept(slippery)


def test_the_counts_by_cause_sum_up_to_the_counts_of_all_failures(slippery: Path) -> None:
    study = study_stability(slippery, Slippery(), DummyDriver())
    stability = study.stability
    assert len(stability.causes) > 1
    sizes = [cause.failures for cause in stability.causes]
    assert sizes == sorted(sizes, reverse=True)
    for grip in Grip:
        for number in ("judged", "failed", "compared", "same_cause"):
            parts = [getattr(cause.at(grip), number) for cause in stability.causes]
            assert sum(parts) == getattr(stability.total.at(grip), number)
    assert stability.total.again.fails.value == stability.total.again.keeps_cause.value == 1.0


@pytest.mark.parametrize("own", ["simulator", "terms", "tests"])
def test_the_friction_changes_by_two_percent_of_the_tests_own(own: str, tmp_path: Path) -> None:
    simulator, options = Slippery(), dict[str, Any]()
    if own == "simulator":
        simulator = Slippery(0.8)
    elif own == "terms":
        options = {"terms": Terms(conditions={"friction": 0.8})}
    else:
        options = {"strategy": Varied(seed=1)}
    folder = searched(tmp_path / "c", simulator, simulations=3, **options)
    simulator.frictions.clear()
    study_stability(folder, simulator, DummyDriver())
    with CampaignStore.open(folder) as store:
        failed = [test.id for test in store.tests(Outcome.FAIL)]
    own_frictions = {"tests": [0.5 + 0.01 * number for number in failed]}.get(own, 3 * [0.8])
    expected = [friction * grip.factor for friction in own_frictions for grip in Grip]
    assert simulator.frictions == pytest.approx(expected)


def test_an_interrupted_study_goes_on_and_a_complete_one_drives_nothing(campaign: Path) -> None:
    whole = study_stability(campaign, EmbeddedSimulator(), Planner(), out=campaign / "whole")
    assert kept(campaign) is None, "a study in another folder leaves no fact"
    simulations: list[int] = []

    def interrupt(now: Summary) -> None:
        simulations.append(now.simulations)
        if now.simulations == 3:
            signal.raise_signal(signal.SIGINT)

    def study() -> StabilityStudy:
        on_event = on_result(interrupt)
        return study_stability(campaign, EmbeddedSimulator(), Planner(), on_event=on_event)

    part = study()
    assert part.missing > 0
    assert kept(campaign) is None, "a part of the drives would look complete"
    study_again = study()
    assert study_again.missing == 0
    assert study_again.failures == whole.failures
    assert kept(campaign) == study_again.stability
    drives = len(simulations)
    assert study() == study_again
    assert len(simulations) == drives == len(Grip) * len(whole.failures)
    assert len(list(campaign.glob("rerun/*/campaign.sqlite"))) == 1
    assert not check_campaign(campaign).findings
    assert read_reruns(campaign) == [], "a study is no rerun in varied conditions"


def test_the_largest_study_is_kept(slippery: Path) -> None:
    def studied(**options: Any) -> int:
        study = study_stability(slippery, Slippery(), DummyDriver(), **options)
        return study.stability.total.failures

    assert studied(most=5) == 5
    first = kept(slippery)
    assert first is not None
    assert first.total.failures == 5
    assert studied() == 24
    assert studied(tests=[1, 2]) == 2
    largest = kept(slippery)
    assert largest is not None
    assert largest.total.failures == 24


def test_the_failures_to_study_are_evenly_spaced(slippery: Path) -> None:
    study = study_stability(slippery, Slippery(), DummyDriver(), most=3)
    ids = [failure.id for failure in study.failures]
    with CampaignStore.open(slippery) as store:
        failed = [test.id for test in store.tests(Outcome.FAIL)]
    assert ids == [failed[0], failed[len(failed) // 2], failed[-1]]


def test_a_study_with_other_parts_leaves_no_fact(slippery: Path) -> None:
    class OtherDriver(DummyDriver):
        pass

    study_stability(slippery, Slippery(), OtherDriver())
    assert kept(slippery) is None


def test_a_study_without_a_recorded_condition_leaves_no_fact(tmp_path: Path) -> None:
    simulator = Slippery()
    folder = searched(tmp_path / "c", simulator, simulations=3, strategy=Varied(seed=1))
    simulator.frictions.clear()
    study = study_stability(folder, simulator, DummyDriver(), instead=["friction"])
    assert simulator.frictions == pytest.approx(3 * [grip.factor for grip in Grip])
    assert not study.is_own
    assert kept(folder) is None


def test_a_campaign_without_failures_is_studied_with_no_drive(tmp_path: Path) -> None:
    folder = searched(tmp_path / "c", DummySimulator(), simulations=2)
    study = study_stability(folder, Slippery(), DummyDriver())
    assert (study.failures, study.folder, study.stability.as_text()) == ((), None, "")
    assert kept(folder) is None, "the simulator is another"


def test_failures_that_do_not_repeat_are_named(slippery: Path) -> None:
    class Mended(Slippery):
        def drive(self, road: Road, driver: Driver) -> Drive:
            self.usual = 0.0 if self.kind(road) == 1 else 1.0
            return super().drive(road, driver)

    study = study_stability(slippery, Mended(), DummyDriver())
    number = kinds_of(slippery)[1]
    words = f"of 24 failures, {number} pass when driven again, {number} pass with 2 % more grip;"
    assert study.stability.as_text().startswith(words)
    assert study.stability.total.again.fails == Share(24 - number, 24)


def test_broken_drives_are_not_judged(slippery: Path) -> None:
    class Breaking(Slippery):
        def drive(self, road: Road, driver: Driver) -> Drive:
            drive = super().drive(road, driver)
            is_broken = self.friction > 1.0 and self.kind(road) == 1
            return replace(drive, trouble=Trouble("no connection")) if is_broken else drive

    study = study_stability(slippery, Breaking(), DummyDriver())
    broken = kinds_of(slippery)[1]
    assert study.stability.total.more_grip.fails == Share(24 - broken, 24 - broken)
    assert study.stability.as_text().endswith(f"; {broken} drives could not be judged")


def test_a_simulator_without_friction_is_refused(slippery: Path) -> None:
    with pytest.raises(FreneticError, match="DummySimulator cannot vary friction"):
        study_stability(slippery, DummySimulator(), DummyDriver())
    with pytest.raises(FreneticError, match=r"driven with 2 % more grip: friction is 1\.53"):
        study_stability(slippery, Slippery(1.5), DummyDriver())
    assert not (slippery / "rerun").exists()


def test_only_failures_are_studied(campaign: Path) -> None:
    with CampaignStore.open(campaign) as store:
        passed = next(store.tests(Outcome.PASS)).id
    with pytest.raises(CampaignError, match=f"test {passed} is PASS: only failures are studied"):
        study_stability(campaign, EmbeddedSimulator(), Planner(), tests=[passed])


def test_a_damaged_fact_is_an_error_in_one_line(slippery: Path) -> None:
    with CampaignStore.open(slippery, readonly=False) as store:
        store.keep(**{STABILITY: {"total": 3}})
    with pytest.raises(CampaignError, match="the fact stability is damaged"):
        kept(slippery)


def test_shares_and_intervals_are_in_the_json(slippery: Path) -> None:
    study = study_stability(slippery, Slippery(), DummyDriver())
    document: Any = study.as_json()
    share = Share(kinds_of(slippery)[1], 24)
    assert document["stability"]["passes_with_more_grip"] == {
        "count": share.count,
        "total": 24,
        "share": share.count / 24,
        "interval": list(share.interval),
    }
    assert document["missing"] == 0
    assert sum(cause["failures"] for cause in document["stability"]["causes"]) == 24
