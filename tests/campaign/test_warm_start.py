"""Campaigns that start from the failures of earlier campaigns."""

from __future__ import annotations

import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from campaigns import campaign, refused
from contents import contents, execute, plain

from frenetic.analysis.clusters import distinct_failures
from frenetic.campaign import Campaign, CampaignStore
from frenetic.campaign.check import check_campaign
from frenetic.campaign.configuration import earlier_of
from frenetic.campaign.evaluation import evaluation_of
from frenetic.campaign.objective import Objective
from frenetic.campaign.warm_start import driven_again, read_earlier, still_failing
from frenetic.drivers import Planner
from frenetic.oracle.outcome import Outcome
from frenetic.search import Evaluation, Frenetic, Frenetic2021, RandomSearch
from frenetic.search.operator_names import EARLIER
from frenetic.simulators import EmbeddedSimulator

SIMULATIONS = 60


class Recording(Frenetic):
    """Records the evaluations that it starts from."""

    earlier: tuple[Evaluation, ...] = ()

    def start_from(self, earlier: Any) -> None:
        self.earlier = tuple(earlier)
        super().start_from(earlier)


def search(
    folder: Path, *earlier: Path, simulations: int = SIMULATIONS, **options: Any
) -> Campaign:
    usual = {"strategy": Recording(seed=5), "driver": Planner(), "simulator": EmbeddedSimulator()}
    return campaign(folder, simulations, start_from=earlier, **(usual | options))


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign of the driver's first version."""
    folder = tmp_path_factory.mktemp("first") / "v1"
    search(folder, strategy=Frenetic(seed=1), simulations=100).run()
    return folder


@pytest.fixture(scope="module")
def second(tmp_path_factory: pytest.TempPathFactory, first: Path) -> Path:
    """A campaign of the same driver that starts from the first."""
    folder = tmp_path_factory.mktemp("second") / "v2"
    search(folder, first).run()
    return folder


def test_roads_of_the_earlier_campaign_are_driven_first_and_fail_again(
    first: Path, second: Path
) -> None:
    with CampaignStore.open(first) as old, CampaignStore.open(second) as new:
        repeats = driven_again(new)
        operators = [candidate.origin.operator for candidate, _ in new.candidates()]
        assert operators.count(EARLIER) == len(repeats) > 10
        assert operators[0] == EARLIER
        assert EARLIER not in operators[SIMULATIONS // 2 :]
        for number, test in repeats.items():
            assert test.candidate.source is not None
            old_test, new_test = old.test(test.candidate.source.test), new.test(number)
            assert (
                old_test.candidate.curvatures.tobytes() == new_test.candidate.curvatures.tobytes()
            )
            # The same driver gives the same result.
            assert (old_test.outcome, old_test.moobd) == (new_test.outcome, new_test.moobd)
        failed = sum(test.outcome is Outcome.FAIL for test in repeats.values())
        assert failed > 5
        assert (
            still_failing(new) == f"{failed} of {failed} earlier failures driven again still failed"
        )
        (earlier,) = earlier_of(new.config)
        counts, taken = old.counts(), len(read_earlier(new))
        assert (earlier.folder, earlier.taken, earlier.left_out) == (str(first), taken, 0)
        assert (earlier.simulations, earlier.failures) == (counts.simulations, counts.failed)
        # Known failures differ from new ones.
        failing_ids = {n for n, test in repeats.items() if test.outcome is Outcome.FAIL}
        clusters = distinct_failures(new)
        assert 0 < clusters.known < len(clusters)
        assert failing_ids <= {
            number for cluster in clusters if cluster.was_known for number in cluster.ids
        }
    assert check_campaign(second).findings == ()


def test_an_interrupted_campaign_goes_on_without_the_earlier_campaign(
    tmp_path: Path, first: Path, second: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old, folder = tmp_path / "v1", tmp_path / "v2"
    shutil.copytree(first, old)
    drive_compiled, calls = EmbeddedSimulator.drive_compiled, iter(range(9, 0, -1))

    def stopping(self: EmbeddedSimulator, drives: Any, **options: Any) -> Any:
        if next(calls) == 1:
            raise KeyboardInterrupt
        return drive_compiled(self, drives, **options)

    with monkeypatch.context() as patched:
        patched.setattr(EmbeddedSimulator, "drive_compiled", stopping)
        assert search(folder, old).run().interrupted
    shutil.rmtree(old)
    assert not search(folder).resume().interrupted
    assert contents(folder) == contents(second)


def test_roads_that_do_not_fit_are_left_out_and_counted(tmp_path: Path, first: Path) -> None:
    smaller = search(tmp_path / "v2", first, strategy=Recording(seed=5, map_size=150.0))
    smaller.run()
    (earlier,) = smaller.start_from
    assert earlier.left_out > 0 < earlier.taken
    assert smaller.notes == (f"starts from {earlier}",)
    assert f"{earlier.left_out} left out that do not fit" in str(earlier)


def test_another_objective_is_measured_on_the_stored_drives(tmp_path: Path, first: Path) -> None:
    other = search(tmp_path / "v2", first, objective="lateral-acceleration", simulations=3)
    other.run()
    assert isinstance(other.strategy, Recording)
    fitness_values = [evaluation.fitness for evaluation in other.strategy.earlier]
    assert all(value is not None and -25.0 < value < -1.0 for value in fitness_values)


@pytest.mark.parametrize("objective", ["moobd", "lateral-acceleration"])
def test_a_strategy_gets_the_evaluations_of_earlier_drives(
    objective: str, tmp_path: Path, first: Path
) -> None:
    strategy = Recording(seed=5)
    search(tmp_path / "v2", first, strategy=strategy, objective=objective, simulations=3).run()
    measured = Objective.load(objective)
    with CampaignStore.open(first) as old, CampaignStore.open(tmp_path / "v2") as new:
        for test, evaluation in zip(read_earlier(new), strategy.earlier, strict=True):
            assert test.candidate.source is not None
            number = test.candidate.source.test
            original = evaluation_of(old.test(number), partial(old.trajectory, number), measured)
            assert replace(original, candidate=evaluation.candidate, budget_spent=0.0) == evaluation
            stored = evaluation_of(test, partial(new.earlier_trajectory, test.id), measured)
            assert plain(stored.trace) == plain(original.trace)


def test_several_campaigns_do_not_give_a_road_twice(
    tmp_path: Path, first: Path, second: Path
) -> None:
    both = search(tmp_path / "v3", second, first, simulations=2)
    both.run()
    with CampaignStore.open(tmp_path / "v3") as store:
        roads = [test.candidate.curvatures.tobytes() for test in read_earlier(store)]
    assert len(set(roads)) == len(roads) == sum(start.taken for start in both.start_from)
    assert min(start.taken for start in both.start_from) > 0


@pytest.mark.parametrize("strategy", [RandomSearch(seed=1), Frenetic2021(seed=1)])
def test_strategies_that_start_from_no_campaign_are_refused(strategy: Any, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="starts from no earlier campaign or real road: give none"):
        search(tmp_path / "v2", tmp_path, strategy=strategy)


def test_an_earlier_campaign_without_a_fitting_road_is_refused(tmp_path: Path, first: Path) -> None:
    folder = tmp_path / "v2"
    tiny = search(folder, first, strategy=Recording(seed=5, map_size=40.0))
    with refused("nothing can be taken from"):
        tiny.run()
    with refused("does not exist"):
        search(folder, tmp_path / "nowhere").run()
    assert not folder.exists()


@pytest.mark.parametrize(
    ("table", "change", "finding"),
    [
        ("test", "curvatures = x'00'", "earlier test 3: buffer size must be a multiple"),
        ("test", "moobd = NULL", "earlier test 3 is FAIL, with a MOOBD of None and"),
        ("test", "outcome = 'ERROR'", "earlier test 3 is ERROR, with a MOOBD of -"),
        ("test", "records = 0", "and 0 records; restore it from a copy"),
        ("test", "trajectory = NULL", "the trajectory of earlier test 3 is gone"),
        ("finding", "side = 'up'", "earlier test 3: Invalid enum value 'up'"),
    ],
)
def test_a_damaged_warm_start_is_a_finding_and_is_not_resumed(
    table: str, change: str, finding: str, tmp_path: Path, second: Path
) -> None:
    folder = tmp_path / "v2"
    shutil.copytree(second, folder)
    key = "id" if table == "test" else "test"
    assert execute(folder, f"UPDATE earlier_{table} SET {change} WHERE {key} = 3") == 1
    assert any(finding in text for text in check_campaign(folder).findings)
    with refused(finding):
        search(folder, simulations=SIMULATIONS + 5).resume()
