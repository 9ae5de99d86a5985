"""Back-to-back testing: what two versions of a driver drive, and what is said about them."""

from __future__ import annotations

import shutil
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from repeats import Counting, driven_in, failures_in, redriven
from repeats import recorded as recorded_test

from frenetic.again.paired import (
    BackToBack,
    Fate,
    Pair,
    PairedRoads,
    RoadSet,
    Verdict,
    Version,
    back_to_back_document,
    distinct_failures,
)
from frenetic.again.verdicts import Change, Repeat
from frenetic.again.versions import (
    back_to_back,
    drive,
    on_shared_roads,
    pair_up,
    plan,
)
from frenetic.campaign import Budget, Campaign, CampaignStore, Event
from frenetic.drivers import Controls, DriveSetup, Noisy, Observation, Planner
from frenetic.errors import CampaignError
from frenetic.outcome import Outcome
from frenetic.search import Frenetic
from frenetic.simulators import EmbeddedSimulator, Simulator

pytest_plugins = ["searched_campaign"]

FRESH = 12


def compared(folder: Path, simulator: Simulator | None = None, **how: Any) -> BackToBack:
    """The planner beside a calmer one, unless other versions are given."""
    old, new = how.pop("old", Planner()), how.pop("new", Planner(aggression=0.9))
    return back_to_back(
        folder, simulator or EmbeddedSimulator(), old, new, **{"fresh": FRESH, **how}
    )


@pytest.fixture(scope="module")
def found(searched_campaign: Path, tmp_path_factory: pytest.TempPathFactory) -> BackToBack:
    """What comes of it in one process, unbroken; nothing in its folders may be changed."""
    return compared(Path(shutil.copytree(searched_campaign, tmp_path_factory.mktemp("v") / "c")))


def driven_by(found: BackToBack) -> list[Any]:
    """All that was driven, set by set."""
    sets: Any = back_to_back_document(found)["sets"]
    return [roads["tests"] for roads in sets]


# What is driven


def test_both_versions_drive_fresh_random_roads_and_the_failing_ones(
    found: BackToBack, searched_campaign: Path
) -> None:
    fresh, old = found.sets
    assert [roads.roads for roads in found.sets] == [RoadSet.FRESH, RoadSet.OLD]
    failing = {test.id: test.moobd for test in failures_in(searched_campaign)}
    own = {pair.record.id: pair.drives(Version.OLD)[0].moobd for pair in old.pairs}
    assert own == failing, "drives repeat exactly"
    assert old.failing(Version.OLD) == len(old.pairs)
    assert {(len(pair.old), len(pair.new)) for pair in (*fresh.pairs, *old.pairs)} == {(1, 1)}
    drawn = driven_in(fresh.folder)
    assert len(drawn) == len(fresh.pairs) == FRESH
    assert {test.candidate.origin.operator for test in drawn} == {"random"}
    chosen = {test.candidate.curvatures.tobytes() for test in driven_in(searched_campaign)}
    assert not chosen & {test.candidate.curvatures.tobytes() for test in drawn}


def test_the_seed_of_a_campaign_is_not_fresh(campaign: Path) -> None:
    with pytest.raises(ValueError, match="seed 3 is that of the campaign"):
        plan(campaign, seed=3)
    assert plan(campaign).seed == 0
    first, second = (
        compared(campaign, new=Planner(aggression=a), fresh=2, seed=5) for a in (0.9, 0.8)
    )
    assert first.fresh.folder == second.fresh.folder


def test_what_is_stored_is_not_driven_again(found: BackToBack, campaign: Path) -> None:
    simulator = Counting()
    one = compared(campaign, simulator)
    driven = simulator.driven
    assert driven == 2 * sum(len(roads.pairs) for roads in one.sets)
    assert back_to_back_document(compared(campaign, simulator)) == back_to_back_document(one)
    assert simulator.driven == driven
    more = compared(campaign, simulator, fresh=FRESH + 5)
    assert simulator.driven - driven == 5 + FRESH + 5, "the old version's drives are stored"
    assert driven_by(more)[0][:FRESH] == driven_by(one)[0] == driven_by(found)[0]


def test_ctrl_c_loses_nothing(found: BackToBack, campaign: Path) -> None:
    roads = plan(campaign, fresh=FRESH)

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

    for at in (7, FRESH + 3, None):
        old = drive(roads, EmbeddedSimulator(), Planner(), on_event=interrupted(at))
        assert old.missing == (0 if at is None else roads.drives - at)
    for at in (FRESH - 1, FRESH + 4, None):
        calmer = Planner(aggression=0.9)
        new = drive(roads, EmbeddedSimulator(), calmer, old, on_event=interrupted(at))
        assert new.missing == (0 if at is None else roads.drives - at)
    resumed = pair_up(roads, old, new)
    assert driven_by(resumed) == driven_by(found)
    assert resumed.answer == found.answer


def test_repeats_under_noise_have_other_errors_each_the_same_for_both(campaign: Path) -> None:
    old, new = (Noisy(Planner(aggression=a), offset=0.3, heading=0.03) for a in (1.0, 0.95))
    found = compared(campaign, old=old, new=new, fresh=8, repeats=3)
    for pair in (pair for roads in found.sets for pair in roads.pairs):
        for drives in (pair.old, pair.new):
            assert len(drives) == 3
            assert len({str(one.conditions) for one in drives}) == 3
        assert [a.conditions for a in pair.old] == [b.conditions for b in pair.new]
        moobds = {one.moobd for one in pair.old}
        assert len(moobds) == 3, "other errors, another drive"


def test_a_version_is_not_compared_with_itself(campaign: Path) -> None:
    with pytest.raises(CampaignError, match="both versions are the same, planner"):
        compared(campaign, new=Planner())


# What is said


def paired(
    *counts: tuple[int, Outcome, Outcome], roads: RoadSet = RoadSet.FRESH, slower: float = 1.0
) -> PairedRoads:
    """Made-up pairs: how many with which outcomes of old and new."""
    pairs: list[Pair] = []
    for number, *outcomes in counts:
        for _ in range(number):
            test = recorded_test(id=len(pairs) + 1)
            old, new = (
                redriven(
                    {},
                    outcome,
                    {"PASS": 0.5, "FAIL": -1.0}.get(outcome),
                    test=test,
                    duration=duration,
                    reason="boom",
                )
                for outcome, duration in zip(outcomes, (10.0, 10.0 * slower), strict=True)
            )
            pairs.append(Pair(test, (old,), (new,)))
    return PairedRoads(roads, Path("fresh"), tuple(pairs), 1)


def result(*sets: PairedRoads) -> BackToBack:
    return BackToBack({"class": "a:Old"}, {"class": "a:New"}, {"class": "s:S"}, 0, sets)


PASS, FAIL, ERROR = Outcome.PASS, Outcome.FAIL, Outcome.ERROR


def test_the_answer_says_who_is_better_by_how_much() -> None:
    better = result(paired((21, FAIL, PASS), (2, PASS, FAIL), (10, FAIL, FAIL), (167, PASS, PASS)))
    assert better.verdict is Verdict.BETTER
    assert better.answer == (
        "new is better: of 200 fresh roads, it fails on 12, old on 31 (difference -9.5 points,"
        " 95 % interval -14.6 to -5.0)"
    )
    worse = result(paired((2, FAIL, PASS), (21, PASS, FAIL), (10, FAIL, FAIL), (167, PASS, PASS)))
    assert worse.verdict is Verdict.WORSE
    assert worse.answer.startswith("new is worse: of 200 fresh roads, it fails on 31, old on 12")
    level = result(paired((5, FAIL, PASS), (4, PASS, FAIL), (191, PASS, PASS)))
    assert level.verdict is Verdict.LEVEL
    assert level.answer.startswith("no difference shown: of 200 fresh roads, new fails on 4,")
    assert level.answer.endswith("; of all 200 roads, 5 pass now and 4 fail now")
    assert "fresh roads, 800," in level.notes[-1]


def test_the_verdict_rests_on_the_fresh_roads() -> None:
    chosen = paired((50, FAIL, PASS), roads=RoadSet.OLD)
    found = result(paired((200, PASS, PASS)), chosen)
    assert chosen.verdict is Verdict.BETTER
    assert found.verdict is Verdict.LEVEL
    assert found.answer.startswith(
        "no difference shown: of 200 fresh roads, new fails on 0, old on"
    )
    assert found.answer.endswith("; of all 250 roads, 50 pass now and 0 fail now")
    assert "rests on the fresh roads" in found.notes[0]


def test_better_by_crawling_is_said() -> None:
    pairs = (30, FAIL, PASS), (170, PASS, PASS)
    assert result(paired(*pairs, slower=1.5)).answer.startswith("new is better but 50 % slower: ")
    for slower in (1.0, 1.001, 0.9):
        assert result(paired(*pairs, slower=slower)).answer.startswith("new is better: ")
    for slower, words in ((1.5, "+50.0 % with new"), (0.5, "-50.0 % with new")):
        assert words in result(paired(*pairs, slower=slower)).time_in_words
    few = result(paired((5, PASS, PASS), slower=2.0))
    assert "too few roads to tell (median +100.0 %)" in few.time_in_words
    assert not few.is_slower
    fresh: Any = back_to_back_document(few)["sets"]
    unknown = {"value": 1.0, "low": None, "high": None, "cannot_tell": True}
    assert fresh[0]["time"]["relative_difference"] == unknown


def test_drives_that_broke_cannot_win() -> None:
    # Without them new is better; but what it does where it breaks nobody knows.
    found = result(paired((30, FAIL, PASS), (40, PASS, ERROR), (130, PASS, PASS)))
    assert found.fresh.difference is not None
    assert found.fresh.difference.sign == -1
    assert found.verdict is Verdict.UNKNOWN
    assert "drives that broke decide" in found.answer
    assert any("new broke in 40 drives" in note and "boom" in note for note in found.notes)
    harmless = result(paired((60, FAIL, PASS), (2, PASS, ERROR), (138, PASS, PASS)))
    assert harmless.verdict is Verdict.BETTER
    nothing = result(paired((3, PASS, ERROR)))
    assert nothing.answer == "cannot tell which is better: no fresh road was judged with both"


def test_what_makes_a_verdict_doubtful_is_noted() -> None:
    roads = paired((20, PASS, PASS))
    own = paired((3, PASS, PASS), (7, FAIL, PASS), roads=RoadSet.OLD)
    notes = result(roads, own).notes
    assert any("old passes 3 of the 10 roads on which its campaign failed" in one for one in notes)


def test_a_failure_is_new_only_where_the_old_version_passes(campaign: Path) -> None:
    worse = compared(campaign, new=Planner(aggression=2.0))
    fails_now = {
        (roads.folder, pair.record.id)
        for roads in worse.sets
        for pair in roads.judged
        if pair.change is Change.FAILS_NOW
    }
    new = [one for one in worse.distinct if one.fate is Fate.NEW]
    assert 0 < len(new) <= len(fails_now)
    assert {(one.folder, one.test_id) for one in new} <= fails_now
    failed_before = distinct_failures(worse.sets[1:])
    assert any(one.old == 0 for one in failed_before), "it fails otherwise on some of these roads"
    assert not any(one.fate is Fate.NEW for one in failed_before)


def test_two_campaigns_are_compared_on_the_random_roads_that_both_drove(tmp_path: Path) -> None:
    def made(name: str, driver: Planner, seed: int = 3, **more: Any) -> Path:
        Campaign(
            strategy=Frenetic(seed=seed),
            simulator=EmbeddedSimulator(**more),
            driver=driver,
            budget=Budget(simulations=60),
            folder=tmp_path / name,
        ).run()
        return tmp_path / name

    old, new = made("old", Planner()), made("new", Planner(aggression=2.5))
    found = on_shared_roads(old, new)
    assert found is not None
    assert found.verdict is Verdict.WORSE
    assert found.answer.startswith("new is worse: of ")
    assert " shared random roads, it fails on " in found.answer
    assert on_shared_roads(old, made("same", Planner(), seed=4)) is None
    elsewhere = on_shared_roads(old, made("elsewhere", Planner(aggression=2.5), seed=4))
    assert elsewhere is not None
    assert elsewhere.verdict is Verdict.UNKNOWN
    assert on_shared_roads(old, made("wet", Planner(aggression=2.5), friction=0.7)) is None


def test_half_of_the_repeats_decide_on_a_road() -> None:
    test = recorded_test()

    def drives(*outcomes: Outcome) -> tuple[Repeat, ...]:
        return tuple(redriven({}, one, None, test=test) for one in outcomes)

    steady = drives(PASS, PASS, PASS)
    pair = Pair(test, drives(FAIL, FAIL, PASS), drives(FAIL, PASS, PASS))
    assert pair.change is Change.PASSES_NOW
    roads = PairedRoads(RoadSet.FRESH, Path(), (pair, Pair(test, steady, steady)), 3)
    assert roads.failure_rate(Version.OLD) == pytest.approx(1 / 3)
    assert roads.failure_rate(Version.NEW) == pytest.approx(1 / 6)
    assert "of 2 fresh roads, 3 drives each, new fails in 16.7 %, old in 33.3 %" in (
        result(roads).answer
    )
    assert Pair(test, drives(ERROR), steady).change is Change.NOT_JUDGED


def test_distinct_failures_are_fixed_remain_or_are_new(found: BackToBack, campaign: Path) -> None:
    for version, name in ((Version.OLD, "old"), (Version.NEW, "new")):
        failing = sum(roads.failing(version) for roads in found.sets)
        assert sum(getattr(one, name) for one in found.distinct) == failing
    for one in found.distinct:
        with CampaignStore.open(one.folder) as store:
            assert store.test(one.test_id).outcome is FAIL
        if one.fate is Fate.FIXED:
            assert (one.old > 0, one.new) == (True, 0)
    turned = compared(campaign, old=Planner(aggression=0.9), new=Planner())
    fixed = sum(one.new == 0 for one in found.distinct)
    assert fixed == sum(one.old == 0 for one in turned.distinct) > 0


class Standing:
    """Never starts."""

    def reset(self, setup: DriveSetup) -> None:
        """Nothing."""

    def act(self, observation: Observation) -> Controls:
        return Controls(0.0, 0.0, 1.0)


class Crashing(Standing):
    """Breaks at once."""

    def act(self, observation: Observation) -> Controls:
        raise ValueError("no")


def test_a_failure_is_fixed_only_where_the_new_version_passes(campaign: Path) -> None:
    standing = compared(campaign, new=Standing(), fresh=2)
    fates = {one.fate for one in standing.distinct}
    assert fates == {Fate.CHANGED, Fate.NEW}, "it fails on these roads, though otherwise"
    broken = compared(campaign, new=Crashing(), fresh=2)
    crashes = [one for one in broken.distinct if one.fate is Fate.NEW]
    assert [one.description.split(" at ")[0] for one in crashes] == ["raises ValueError"]
