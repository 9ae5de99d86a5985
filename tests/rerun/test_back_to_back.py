"""Back-to-back tests: the drives of two versions of a driver, and the verdict on them."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pids import LIMIT
from repeats import Counting, driven_in, failures_in, recorded

from frenetic._support.json_value import JSONValue
from frenetic.campaign import Budget, Campaign, Event, RoadTester
from frenetic.drivers import Planner
from frenetic.errors import CampaignError
from frenetic.oracle.outcome import Outcome
from frenetic.rerun.back_to_back import (
    BackToBack,
    back_to_back,
    check_differ,
    compare_versions,
)
from frenetic.rerun.disturbances import UNDISTURBED
from frenetic.rerun.old_version import fresh_roads
from frenetic.rerun.paired_roads import Pair, PairedRoads
from frenetic.rerun.stability import Change
from frenetic.search import Frenetic
from frenetic.simulators import EmbeddedSimulator, Simulator

pytest_plugins = ["searched_campaign"]

FRESH = 12
CALMER = Planner(aggression=0.9)


def compare_planners(
    folder: Path, simulator: Simulator | None = None, **options: Any
) -> BackToBack:
    """Compare the planner with a calmer planner, or with ``new``."""
    new = options.pop("new", CALMER)
    simulator = simulator or EmbeddedSimulator()
    usual = {"fresh": FRESH, "quality": UNDISTURBED}
    return back_to_back(folder, simulator, Planner(), new, **{**usual, **options})


@pytest.fixture(scope="module")
def comparison(searched_campaign: Path, tmp_path_factory: pytest.TempPathFactory) -> BackToBack:
    """A comparison without interruption; tests must not change its folders."""
    return compare_planners(
        Path(shutil.copytree(searched_campaign, tmp_path_factory.mktemp("v") / "c"))
    )


def results_of(comparison: BackToBack) -> list[Any]:
    """Return the results of all drives: on fresh roads, on known roads."""
    return [
        [(old.id, old.result, new.result) for old, new in roads.pairs]
        for roads in (comparison.fresh, comparison.known)
    ]


# Drives


def test_both_versions_drive_fresh_random_roads_and_failing_roads(
    comparison: BackToBack, searched_campaign: Path
) -> None:
    moobds = {pair.old.id: pair.old.moobd for pair in comparison.known.pairs}
    assert moobds == {test.id: test.moobd for test in failures_in(searched_campaign)}
    assert comparison.known.failing[0] == len(comparison.known.pairs)
    fresh = driven_in(comparison.fresh.folder)
    assert len(fresh) == len(comparison.fresh.pairs) == FRESH
    assert (comparison.seed, {test.candidate.origin.operator for test in fresh}) == (0, {"random"})
    chosen = {test.candidate.curvatures.tobytes() for test in driven_in(searched_campaign)}
    assert not chosen & {test.candidate.curvatures.tobytes() for test in fresh}
    simulator = EmbeddedSimulator()
    for pair in comparison.known.pairs:
        assert pair.new.drive is not None
        drive = simulator.drive(pair.old.road, CALMER)
        assert len(drive.trajectory) == len(pair.new.drive.trajectory)


def test_stored_roads_are_not_driven_again(comparison: BackToBack, campaign: Path) -> None:
    simulator = Counting()
    first = compare_planners(campaign, simulator)
    known = len(first.known.pairs)
    assert simulator.driven == 2 * FRESH + known
    assert compare_planners(campaign, simulator).as_json() == first.as_json()
    assert simulator.driven == 2 * FRESH + known
    more = compare_planners(campaign, simulator, fresh=FRESH + 5)
    assert simulator.driven == 2 * FRESH + known + 5 + FRESH + 5, (
        "the old version drove these roads before"
    )
    assert compare_planners(campaign, simulator).as_json() == first.as_json(), (
        "from the larger number of stored roads"
    )
    assert results_of(more)[0][:FRESH] == results_of(first)[0] == results_of(comparison)[0]


def test_fresh_roads_differ_from_the_campaigns_roads(tmp_path: Path) -> None:
    tester, budget = RoadTester(EmbeddedSimulator(), Planner()), Budget(simulations=1)
    parts: Any = {"simulator": tester.simulator, "driver": tester.driver}
    Campaign(strategy=Frenetic(seed=0), budget=budget, folder=tmp_path, **parts).run()
    assert fresh_roads(tmp_path, tester, fresh=1).seed == 1


def test_an_interrupted_comparison_goes_on_with_the_same_results(
    comparison: BackToBack, campaign: Path
) -> None:
    def interrupted(at: int | None) -> Callable[[Event], None]:
        before = done = 0

        def watch(event: Event) -> None:
            nonlocal before, done
            if event.kind == "started":
                before, done = before + done, event.summary.simulations
            elif event.kind == "result":
                is_another, done = event.summary.simulations > done, event.summary.simulations
                if is_another and before + done == at:
                    signal.raise_signal(signal.SIGINT)

        return watch

    known = len(comparison.known.pairs)
    for at in (7, None):
        on_event = interrupted(at)
        tester = RoadTester(EmbeddedSimulator(), Planner())
        roads = fresh_roads(campaign, tester, fresh=FRESH, on_event=on_event)
        # The roads that are driven side by side are finished.
        assert (at or FRESH) <= len(roads.tests) <= FRESH
    for at in (1, None):
        tester = RoadTester(EmbeddedSimulator(), CALMER)
        new = compare_versions(roads, tester, on_event=interrupted(at))
        assert (new.missing > 0) is (at is not None)
    assert new.missing == 0 < known
    assert results_of(new) == results_of(comparison)
    assert new.answer == comparison.answer


def test_a_version_is_not_compared_with_itself(campaign: Path) -> None:
    with pytest.raises(CampaignError, match="both versions are the same, planner"):
        compare_planners(campaign, new=Planner())


def test_equal_programs_are_told_that_no_copy_is_kept() -> None:
    program: dict[str, JSONValue] = {
        "class": "frenetic.drivers.command:CommandDriver",
        "options": {"program": "./controller"},
        "version": "version 1, files 1f3a9c07",
    }
    with pytest.raises(CampaignError, match="keeps no copy, so give the new one another name"):
        check_differ(program, program)


HELPER = """
import os

VERSION = {version}
with open({log!r}, "a") as file:
    file.write(f"{{os.getpid()}} {{VERSION}}\\n")
"""
DRIVER = """
import helper
from frenetic import Planner

class Mine(Planner):
    def __init__(self):
        super().__init__(aggression=1.0 / helper.VERSION)

    def reset(self, setup):
        super().reset(setup)
        assert helper.VERSION == {version}
"""


@pytest.mark.heavy
def test_two_versions_of_a_module_are_imported_in_different_processes(tmp_path: Path) -> None:
    log = tmp_path / "imported"
    for version in (1, 2):
        folder = tmp_path / f"v{version}"
        folder.mkdir()
        (folder / "helper.py").write_text(HELPER.format(version=version, log=str(log)))
        (folder / "driver.py").write_text(DRIVER.format(version=version))

    def frenetic(*words: str) -> str:
        log.write_text("")
        command = [sys.executable, "-m", "frenetic", *words]
        process = subprocess.run(
            command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=LIMIT
        )
        assert process.returncode in (0, 1, 3), process.stderr
        return process.stdout

    search = ("--strategy", "random", "--simulations", "4", "--seed", "3", "--workers", "1")
    frenetic("run", "--driver", "v1/driver.py:Mine", *search, "--out", "c")
    compare = ("compare", "c", "--driver", "v2/driver.py:Mine", "--fresh", "4", "--json")
    document = json.loads(frenetic(*compare))
    imported = [line.split() for line in log.read_text().splitlines()]
    assert {version for _, version in imported} == {"1", "2"}
    assert len({process for process, _ in imported}) == len(imported)
    assert document["fresh"]["judged"] == 4
    for place in tmp_path.glob("c/rerun/*"):
        for test in driven_in(place):
            assert test.result.fault is None, test.reason


# Answers


PASS, FAIL, ERROR = Outcome.PASS, Outcome.FAIL, Outcome.ERROR
NONE = PairedRoads(Path("known"), ())


def paired(*counts: tuple[int, Outcome, Outcome], slower: float = 1.0) -> PairedRoads:
    """Return made-up pairs, from rows of number, outcome of old and outcome of new."""
    pairs: list[Pair] = []
    for number, *outcomes in counts:
        old, new = (
            recorded(outcome, None, id=len(pairs) + 1, duration=duration, reason="boom")
            for outcome, duration in zip(outcomes, (10.0, 10.0 * slower), strict=True)
        )
        pairs += [Pair(old, new)] * number
    return PairedRoads(Path("fresh"), tuple(pairs))


def result(fresh: PairedRoads, known: PairedRoads = NONE) -> BackToBack:
    return BackToBack({"class": "a:Old"}, {"class": "a:New"}, {"class": "s:S"}, 0, fresh, known)


def test_the_answer_names_the_better_version_and_the_difference() -> None:
    better = result(paired((21, FAIL, PASS), (2, PASS, FAIL), (10, FAIL, FAIL), (167, PASS, PASS)))
    assert better.answer == (
        "new is better: of 200 fresh roads, it fails on 12, old on 31 (difference -9.5 points,"
        " 95 % interval -14.6 to -5.0)"
    )
    worse = result(paired((2, FAIL, PASS), (21, PASS, FAIL), (10, FAIL, FAIL), (167, PASS, PASS)))
    assert worse.answer.startswith("new is worse: of 200 fresh roads, it fails on 31, old on 12")
    assert better.notes == worse.notes == ()  # more roads would not change the answer
    level = result(paired((5, FAIL, PASS), (4, PASS, FAIL), (191, PASS, PASS)))
    assert level.answer.startswith(
        "no difference shown: of 200 fresh roads, new fails on 4, old on"
    )
    assert "fresh roads, 800," in level.notes[-1]
    assert [level.fresh.changes[change] for change in Change] == [0, 5, 4, 191, 0]


def test_the_verdict_depends_on_the_fresh_roads_only() -> None:
    comparison = result(paired((200, PASS, PASS)), paired((50, FAIL, PASS)))
    assert comparison.answer.startswith(
        "no difference shown: of 200 fresh roads, new fails on 0, old"
    )
    assert "rests on the fresh roads" in comparison.notes[0]


def test_a_better_but_slower_version_is_called_slower() -> None:
    pairs = (30, FAIL, PASS), (170, PASS, PASS)
    assert result(paired(*pairs, slower=1.5)).answer.startswith("new is better but 50 % slower: ")
    for slower in (1.0, 1.001, 0.9):
        assert result(paired(*pairs, slower=slower)).answer.startswith("new is better: ")
    assert result(paired((9, FAIL, FAIL), (9, FAIL, PASS), slower=2.0)).time_difference is None
    few = result(paired((5, PASS, PASS), slower=2.0))
    assert few.as_json()["time_difference"] == {"value": 1.0, "low": None, "high": None}


def test_drives_with_a_broken_simulator_decide_no_verdict() -> None:
    # On the judged roads new is better, but on 40 roads its outcome is unknown.
    comparison = result(paired((30, FAIL, PASS), (40, PASS, ERROR), (130, PASS, PASS)))
    assert comparison.difference is not None
    assert comparison.difference.sign == -1
    assert comparison.verdict == "cannot tell"
    assert "the simulator broke decide" in comparison.answer
    assert any(
        "the simulator broke in 40 drives with new" in note and "boom" in note
        for note in comparison.notes
    )
    harmless = result(paired((60, FAIL, PASS), (2, PASS, ERROR), (138, PASS, PASS)))
    assert harmless.verdict == "new is better"
    for old, new in ((ERROR, PASS), (PASS, ERROR)):
        assert paired((1, old, new)).changes[Change.NOT_JUDGED] == 1
    nothing = result(paired((3, PASS, ERROR)))
    assert nothing.answer == "cannot tell which is better: no fresh road was judged with both"


def test_causes_count_roads_for_each_version(comparison: BackToBack) -> None:
    old, new = (sum(roads) for roads in zip(*comparison.causes.values(), strict=True))
    failing = zip(comparison.fresh.failing, comparison.known.failing, strict=True)
    assert [old, new] == [sum(numbers) for numbers in failing]
