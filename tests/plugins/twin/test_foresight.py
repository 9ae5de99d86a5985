"""The search with foresight: a twin learns the driver and predicts the outcome of roads."""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
import pytest
from contents import contents
from events import on_result

from frenetic import EmbeddedSimulator, Stanley
from frenetic._support.option_text import part_word
from frenetic.campaign import Campaign, CampaignStore
from frenetic.campaign.check import check_campaign
from frenetic.campaign.configuration import recorded_spec
from frenetic.campaign.evaluation import evaluate
from frenetic.campaign.guarded_strategy import SEARCH_FACTS
from frenetic.drivers.driver import Driver
from frenetic.errors import CampaignError, FreneticError
from frenetic.oracle.outcome import Outcome
from frenetic.plugins.twin.foresight import foresight
from frenetic.plugins.twin.law_twin import CAR, LAWS, SPEED, LawTwin
from frenetic.plugins.twin.model import TwinModel
from frenetic.plugins.twin.profile import Fitted, TwinProfile
from frenetic.search import Candidate, Evaluation, Frenetic, RandomSearch
from frenetic.search.archive import critical_places
from frenetic.simulators.conditions import in_conditions
from frenetic.spec import Spec

if TYPE_CHECKING:
    from command_line import Frenetic as Command

pytest_plugins = ["command_line"]

HIDDEN_DRIVER = Stanley(lateral_acceleration=7.5, offset_gain=0.8, braking=4.0)
"""Driver under test, whose parameters the twin has to find."""
TWIN = TwinProfile.of("twin", Spec(driver="planner,lateral_acceleration=7.8"))


def drive_all(
    candidates: Sequence[Candidate], driver: Driver, spec: Spec
) -> list[tuple[Candidate, Evaluation]]:
    """Drive candidates; return each with its evaluation."""
    simulator = EmbeddedSimulator(rules=spec.rules)
    evaluated = []
    for candidate in candidates:
        road = candidate.road(spec.terms.lane_width)
        with in_conditions(candidate.conditions, simulator, driver) as conditioned:
            drive = simulator.drive(road, conditioned)
        evaluated.append((candidate, evaluate(candidate, road, drive)))
    return evaluated


@pytest.mark.heavy
def test_a_twin_learns_a_driver_and_predicts_where_it_fails() -> None:
    spec = Spec()
    search = RandomSearch(seed=1)
    roads = [search.ask() for _ in range(60)]
    models = [TwinModel.of(law, [*SPEED, *steering, *CAR]) for law, steering in LAWS.items()]
    twin = LawTwin(models, spec)
    drives = drive_all(roads, HIDDEN_DRIVER, spec)
    for candidate, evaluation in drives[:20]:
        twin.learn(candidate, evaluation)
    assert twin.is_ready
    facts = twin.facts()
    assert facts["twin"].startswith("stanley, ")
    assert facts["loss"] < 0.05
    agreed, differences = 0, []
    for candidate, evaluation in drives[20:]:
        (prediction,) = twin.foresee([candidate])
        assert prediction is not None
        agreed += prediction.outcome == evaluation.outcome
        if Outcome.FAIL == prediction.outcome == evaluation.outcome:
            predicted, driven = (
                critical_places(e, candidate, e.moobd or 0.0)[0] for e in (prediction, evaluation)
            )
            differences.append(float(np.linalg.norm(predicted.vector - driven.vector)))
    assert agreed > 0.9 * len(drives[20:])
    assert len(differences) > 5
    assert np.median(differences) < 1.0


def spec_of(**options: Any) -> Spec:
    """Return a search whose twin differs from the driver under test in its speed in bends only."""
    return Spec(
        strategy=part_word("foresight", {"random_roads": 15, "random_budget": 0.5, **options}),
        driver="stanley,lateral_acceleration=7.5",
        seed=3,
        max_in_flight=4,
        simulations=36,
    )


@pytest.fixture
def profile(tmp_path: Path) -> Path:
    """A profile with one parameter to fit, the speed in bends."""
    spec = Spec.of(spec_of(), {"driver": "lateral_acceleration=7.0"})
    entries = {"low": 3.0, "high": 12.0, "from": 6.0, "to": 8.0}
    speed = {"name": "driver.lateral_acceleration", "value": 7.0, **entries}
    fitted = msgspec.convert({**speed, "is_determined": True, "at_bound": False}, Fitted)
    TwinProfile.of("twin", spec, fitted=[fitted]).write(tmp_path / "twin.json")
    return tmp_path / "twin.json"


@pytest.mark.heavy
def test_a_campaign_with_foresight_finds_more_and_goes_on_with_the_same_roads(
    tmp_path: Path, profile: Path
) -> None:
    def stop(progress: Any) -> None:
        if progress.simulations == 28:
            raise KeyboardInterrupt

    whole = tmp_path / "whole"
    Campaign.of(spec_of(profile=str(profile)), folder=whole, workers=1).run()
    with CampaignStore.open(whole) as store:
        facts: Any = store.fact(SEARCH_FACTS)
    foreseen_children = facts["children with foresight"]
    assert foreseen_children > facts["children without foresight"]
    assert facts["new failures with foresight"] > 0.7 * foreseen_children
    first = Campaign.of(spec_of(profile=str(profile)), folder=tmp_path / "found", workers=1)
    assert first.run(on_event=on_result(stop)).interrupted
    with CampaignStore.open(tmp_path / "found") as store:
        recorded = recorded_spec(store.config, source="campaign")
    before = profile.read_bytes()
    msgspec.structs.replace(TwinProfile.read(profile), name="another").write(profile)
    with pytest.raises(CampaignError, match="made with another strategy"):
        Campaign.of(recorded, folder=tmp_path / "found", workers=1).resume()
    profile.write_bytes(before)
    # The number of workers makes no difference either.
    Campaign.of(recorded, folder=tmp_path / "found", workers=2).resume()
    assert contents(tmp_path / "found") == contents(whole)
    assert check_campaign(tmp_path / "found").findings == ()


def test_a_profile_predicts_from_the_start_and_is_fitted_further(profile: Path) -> None:
    twin = LawTwin([TwinModel.of_profile(TwinProfile.read(profile))], Spec(), is_ready=True)
    search = RandomSearch(seed=2)
    drives = drive_all([search.ask() for _ in range(25)], Stanley(lateral_acceleration=7.5), Spec())
    assert twin.foresee([drives[0][0]]) != [None]
    assert twin.facts() == {"twin": "stanley, lateral_acceleration 7"}
    for candidate, evaluation in drives:
        twin.learn(candidate, evaluation)
    assert twin.facts() == {
        "twin": "stanley, lateral_acceleration 7.5",
        "loss": pytest.approx(0.0, abs=0.02),
    }


@pytest.mark.heavy
def test_foresight_works_in_a_domain_whose_fog_the_driver_ignores(profile: Path) -> None:
    conditions = {"friction": {"low": 0.5, "high": 1.0}, "fog": {"low": 20.0, "high": 200.0}}
    search = foresight(Spec.of(spec_of(), {"odd": {"conditions": conditions}}), profile)
    assert isinstance(search, Frenetic)
    simulator = EmbeddedSimulator()
    for _ in range(40):
        candidate = search.ask()
        friction = {n: v for n, v in candidate.conditions.items() if n == "friction"}
        road = candidate.road(4.0)
        with in_conditions(friction, simulator, HIDDEN_DRIVER) as conditioned:
            search.tell(evaluate(candidate, road, simulator.drive(road, conditioned)))
    assert search.facts()["children with foresight"] > 0


def test_run_show_and_report_show_the_facts_of_foresight(frenetic: Command) -> None:
    TWIN.write(Path("twin.json"))
    foresight = ("--strategy", "foresight,profile=twin.json,random_roads=4")
    run = ("run", *foresight, "--seed", "3", "--workers", "1", "--out", "found")
    facts = frenetic(*run, "--simulations", "20", "--json").json["facts"]
    assert facts["twin"] == "planner"
    shown = " ".join(frenetic("show", "found").out.split())
    children = f"children with foresight {facts['children with foresight']}"
    assert children in shown
    assert frenetic("show", "found", "--json").json["facts"]["search"] == facts
    assert children in Path("found/report.html").read_text(encoding="utf-8")
    assert "twin.json" in Path("found/campaign.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("options", "entries", "message"),
    [
        (("--criteria", "speed_limit=60"), {}, "speed limit 70, not 60"),
        (("--map-size", "150"), {}, "map size 200, not 150"),
        (("--criteria", "oob_tolerance=0.5"), {}, "oob tolerance 0.95, not 0.5"),
        ((), {"driver": "nobody"}, "nobody"),
        pytest.param(
            (), {"driver": "highway-env"}, "no driver for a twin", marks=pytest.mark.heavy
        ),
        ((), {"driver": "planner,courage=3"}, "courage"),
        ((), {"oob_tolerance": 2}, "oob_tolerance"),
        ((), {"with": {"noise": 0.1}}, "the condition noise, which nobody fitted"),
    ],
)
def test_an_unsuitable_twin_is_refused_in_one_line(
    frenetic: Command, options: tuple[str, ...], entries: dict[str, Any], message: str
) -> None:
    TWIN.write(Path("twin.json"))
    document = json.loads(Path("twin.json").read_text(encoding="utf-8"))
    document["driven"] |= entries
    Path("twin.json").write_text(json.dumps(document), encoding="utf-8")
    foresight = ("--strategy", "foresight,profile=twin.json")
    answer = frenetic("run", *foresight, *options, "--out", "found")
    assert answer.refuses(message)
    assert not Path("found").exists()


def test_a_twin_of_another_lane_width_is_refused(tmp_path: Path) -> None:
    TWIN.write(tmp_path / "twin.json")
    make = partial(foresight, Spec(lane_width=5.0), tmp_path / "twin.json")
    with pytest.raises(FreneticError, match="lane width 4, not 5"):
        make()
