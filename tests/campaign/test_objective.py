"""Objectives: their values, and campaigns that minimise them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from campaigns import campaign, refused
from contents import contents

from frenetic.analysis.groups import parts_of
from frenetic.campaign import Campaign, CampaignStore
from frenetic.campaign.check import check_campaign
from frenetic.campaign.objective import Objective
from frenetic.campaign.objective_values import objective_text, objective_values
from frenetic.drivers import Planner
from frenetic.errors import FreneticError
from frenetic.oracle.assessment import assess
from frenetic.oracle.verdict import judge
from frenetic.road import Road
from frenetic.search import Evaluation, Frenetic, Frenetic2021
from frenetic.simulators import EmbeddedSimulator

OWN_OBJECTIVES = """
def slowest(road, drive):
    return float(drive.trajectory.speed[20:].min())

def broken(road, drive):
    raise RuntimeError("no such column")

def endless(road, drive):
    return float("inf")
"""


class Recording(Frenetic):
    """Records the fitness of its results."""

    def __init__(self, seed: int) -> None:
        super().__init__(seed=seed, random_budget=1.0)
        self.fitness_values: list[float | None] = []

    def tell(self, evaluation: Evaluation) -> None:
        self.fitness_values.append(evaluation.fitness)
        super().tell(evaluation)


def search(folder: Path, objective: str, simulations: int = 50) -> Campaign:
    parts = {"strategy": Recording(seed=3), "simulator": EmbeddedSimulator(), "driver": Planner()}
    return campaign(folder, simulations, objective=objective, **parts)


def fitness_values(campaign: Campaign) -> list[float | None]:
    assert isinstance(campaign.strategy, Recording)
    return campaign.strategy.fitness_values


def test_built_in_objectives_agree_with_the_oracle() -> None:
    road = Road(np.array([0.0, 0.0, 0.05, 0.06, 0.0, 0.0]))
    with EmbeddedSimulator() as simulator:
        drive = simulator.drive(road, Planner(aggression=1.4))
    result = judge(road, drive)
    assert Objective.load("moobd").measure(road, drive) == result.moobd
    assert Objective.load("moobd").fitness(road, drive) is None
    share = Objective.load("oob-share")
    assert share.fitness(road, drive) == -(result.max_oob_share or 0.0) < 0.0
    count = len(assess(road, drive).distance)
    fastest = np.abs(drive.trajectory.lateral_acceleration[:count]).max()
    fitness = Objective.load("lateral-acceleration").fitness(road, drive)
    assert fitness == pytest.approx(-fastest)
    assert 3.0 < fastest < 20.0
    with pytest.raises(FreneticError, match=r"unknown objective 'oob'.*oob-share"):
        Objective.load("oob")


def test_a_campaign_resumed_with_an_objective_equals_one_run(tmp_path: Path) -> None:
    whole = search(tmp_path / "whole", "oob-share", simulations=40)
    whole.run()
    search(tmp_path / "parts", "oob-share", simulations=30).run()
    resumed = search(tmp_path / "parts", "oob-share", simulations=40)
    resumed.resume()
    values = fitness_values(resumed)
    assert values == fitness_values(whole)
    with CampaignStore.open(tmp_path / "whole") as store:
        assert {-value for value in objective_values(store).values()} == {*values} - {None}
    without = ("budget_spent",)
    whole_tests, tests = (contents(tmp_path / name, without=without) for name in ("whole", "parts"))
    assert tests == whole_tests
    with refused('another objective: "oob-share", not "moobd"'):
        search(tmp_path / "parts", "moobd", simulations=50).resume()


def test_values_of_an_objective_are_stored_described_and_logged(tmp_path: Path) -> None:
    folder = tmp_path / "c"
    parts = {"strategy": Frenetic2021(seed=3, threshold=-0.4), "simulator": EmbeddedSimulator()}
    campaign(folder, 30, driver=Planner(), objective="oob-share", **parts).run()
    with CampaignStore.open(folder) as store:
        shares = {t.id: t.result.max_oob_share for t in store.tests() if t.outcome.is_driven}
        values = objective_values(store)
        text = objective_text(store)
        assert values == {t.id: t.objective for t in store.tests() if t.objective is not None}
    # The objective is measured on the stored drives, which are rounded.
    assert values == pytest.approx(shares, abs=2e-3)
    worst = max(values.values())
    first = min(number for number, value in values.items() if value == worst)
    assert text.startswith("oob-share: largest share of the car outside its lane, higher is worse")
    share = f"at most {100.0 * worst:.0f} % of the car outside its lane"
    assert text.endswith(f"; {share}, in test {first}")
    assert check_campaign(folder).findings == ()
    last = (folder / "campaign.log").read_text(encoding="utf-8").splitlines()[-1]
    assert json.loads(last)["worst"] == worst
    assert parts_of(folder)["objective"] == "oob-share"


@pytest.mark.parametrize(
    ("name", "message"),
    [("broken", "raised RuntimeError: no such column"), ("endless", "is inf: a finite number")],
)
def test_an_objective_that_raises_or_is_infinite_ends_the_campaign(
    tmp_path: Path, name: str, message: str
) -> None:
    (tmp_path / "own.py").write_text(OWN_OBJECTIVES, encoding="utf-8")
    with refused(f"{message}.*; 0 results stored, ") as caught:
        search(tmp_path / "c", f"{tmp_path / 'own.py'}:{name}").run()
    assert ("own.py:" in str(caught.value).partition("raised")[2]) == (name == "broken")
    with CampaignStore.open(tmp_path / "c") as store:
        assert len(list(store.candidates())) == 1
        assert store.counts().result_count == 0
