"""Objectives: what they measure, their order, and campaigns that have one."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from campaigns import refused
from checksums import execute
from contents import contents

from frenetic.analysis.groups import parts_of
from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.campaign.check import check_campaign
from frenetic.campaign.objective import Objective, in_words, objectives
from frenetic.drivers import Planner
from frenetic.errors import FreneticError
from frenetic.oracle import judge
from frenetic.road import Road
from frenetic.search import Evaluation, Frenetic, Frenetic2021
from frenetic.simulators import EmbeddedSimulator
from frenetic.spec import Spec

OWN = """
def slowest(road, drive):
    return float(drive.trajectory.speed[20:].min())

def broken(road, drive):
    raise RuntimeError("no such column")

def endless(road, drive):
    return float("inf")
"""


class Watching(Frenetic):
    """Notes what it minimises."""

    def __init__(self, seed: int) -> None:
        super().__init__(seed=seed, random_budget=1.0)
        self.severities: list[float | None] = []

    def tell(self, evaluation: Evaluation) -> None:
        self.severities.append(evaluation.severity)
        super().tell(evaluation)


def campaign(folder: Path, objective: str, simulations: int = 50) -> Campaign:
    return Campaign(
        strategy=Watching(seed=3),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(simulations=simulations),
        folder=folder,
        objective=objective,
    )


def severities(campaign: Campaign) -> list[float | None]:
    assert isinstance(campaign.strategy, Watching)
    return campaign.strategy.severities


def test_built_in_objectives_agree_with_the_oracle() -> None:
    road = Road(np.array([0.0, 0.0, 0.05, 0.06, 0.0, 0.0]))
    with EmbeddedSimulator() as simulator:
        drive = simulator.drive(road, Planner(aggression=1.4))
    result = judge(road, drive)
    assert Objective.load("moobd").measure(road, drive) == result.moobd
    assert Objective.load("moobd").severity(road, drive) is None
    share = Objective.load("oob-share")
    assert share.severity(road, drive) == -(result.max_oob_share or 0.0) < 0.0
    path = drive.trajectory
    fastest = np.abs(path.speed * path.yaw_rate).max()
    severity = Objective.load("lateral-acceleration").severity(road, drive)
    assert severity == pytest.approx(-fastest)
    assert 3.0 < fastest < 20.0


def test_a_search_minimises_the_objective_and_raises_it(tmp_path: Path) -> None:
    search = campaign(tmp_path, "lateral-acceleration", simulations=120)
    search.run()
    told = [value for value in severities(search) if value is not None]
    assert len(told) == 120
    assert np.mean(told[60:]) < np.mean(told[:30])


def test_an_interrupted_campaign_with_an_objective_goes_on_as_it_would_have(tmp_path: Path) -> None:
    whole = campaign(tmp_path / "whole", "oob-share", simulations=60)
    whole.run()
    campaign(tmp_path / "parts", "oob-share", simulations=45).run()
    rest = campaign(tmp_path / "parts", "oob-share", simulations=60)
    rest.resume()
    assert severities(rest) == severities(whole)
    without = ("budget_spent",)
    whole_tests, tests = (contents(tmp_path / one, without=without) for one in ("whole", "parts"))
    assert tests == whole_tests
    with refused('another objective: "oob-share", not "moobd"'):
        campaign(tmp_path / "parts", "moobd", simulations=70).resume()


def test_an_objective_of_ones_own_is_recorded(tmp_path: Path) -> None:
    (tmp_path / "own.py").write_text(OWN, encoding="utf-8")
    name = f"{tmp_path / 'own.py'}:slowest"
    campaign(tmp_path / "c", name, simulations=10).run()
    with CampaignStore.open(tmp_path / "c") as store:
        assert store.config["objective"] == name
        spec = Spec.from_json(store.config, source="a campaign")
    assert spec.objective == name


def test_its_values_are_kept_and_named(tmp_path: Path) -> None:
    folder = tmp_path / "c"
    Campaign(
        strategy=Frenetic2021(seed=3, threshold=-0.4),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(simulations=30),
        folder=folder,
        objective="oob-share",
    ).run()
    with CampaignStore.open(folder) as store:
        shares = {t.id: t.result.max_oob_share for t in store.tests() if t.outcome.is_driven}
        values = objectives(store)
        text = in_words(store.config, values)
        assert values == {t.id: t.objective for t in store.tests() if t.objective is not None}
    # Drives are measured as they are stored, which is rounded.
    assert values == pytest.approx(shares, abs=2e-3)
    best = max(values.values())
    first = min(one for one, value in values.items() if value == best)
    assert text.startswith("oob-share: largest share of the car outside its lane, higher is worse")
    assert f"threshold -0.4; best {max(list(values.values())[:3]):.3g} after 3, " in text
    assert text.endswith(f"{best:.3g} after 30 drives, in test {first}")
    assert check_campaign(folder).findings == ()
    last = (folder / "campaign.log").read_text(encoding="utf-8").splitlines()[-1]
    assert json.loads(last)["best"] == best
    assert parts_of(folder)["objective"] == "oob-share"


def test_a_changed_value_is_found(tmp_path: Path) -> None:
    campaign(tmp_path, "oob-share", simulations=3).run()
    execute(tmp_path, "UPDATE test SET objective = 0.123 WHERE told = 1", renew=False)
    assert "test 1 does not match its checksum" in check_campaign(tmp_path).findings[0]


@pytest.mark.parametrize(
    ("name", "why"),
    [("broken", "raised RuntimeError: no such column"), ("endless", "is inf: a finite number")],
)
def test_an_objective_without_a_value_ends_the_campaign(
    tmp_path: Path, name: str, why: str
) -> None:
    (tmp_path / "own.py").write_text(OWN, encoding="utf-8")
    with refused(f"{why}.*; 0 results stored, ") as caught:
        campaign(tmp_path / "c", f"{tmp_path / 'own.py'}:{name}").run()
    assert ("own.py:" in str(caught.value).partition("raised")[2]) == (name == "broken")
    with CampaignStore.open(tmp_path / "c") as store:
        assert len(list(store.candidates())) == 1
        assert store.counts().told == 0


def test_an_unknown_objective_is_refused() -> None:
    with pytest.raises(FreneticError, match=r"unknown objective 'oob'.*oob-share"):
        Objective.load("oob")
