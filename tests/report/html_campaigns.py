"""Campaigns for the tests of the HTML report."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from frenetic._support.json_value import JSONValue
from frenetic.campaign import Budget, Campaign, CampaignStore, Test
from frenetic.conditions.domain import Domain
from frenetic.drivers import Planner
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Result
from frenetic.road.classes import RoadClass
from frenetic.search import Candidate, Frenetic2021, Origin, RandomSearch, Sweep
from frenetic.simulators import EmbeddedSimulator

HOSTILE = (
    "</script ></script><script>window.hacked = 1</script><!-- \u2028 & ' \" "
    "<img src=x onerror=hacked=1>"
)
"""A text that a page must show and never run."""


def make_searched(folder: Path, simulations: int = 150) -> Path:
    """Run a campaign with failures, random roads, and roads with parents."""
    Campaign(
        strategy=Frenetic2021(seed=10, max_redraws=10),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(simulations=simulations),
        folder=folder,
    ).run()
    return folder


def make_sloping(folder: Path, name: str = "urban-50") -> Path:
    """Run a campaign on icy roads of a class; the lanes of "urban-50" widen in bends."""
    road_class = RoadClass.of(name)
    Campaign(
        strategy=RandomSearch(seed=1, road_class=road_class),
        simulator=EmbeddedSimulator(friction=0.25),
        driver=Planner(),
        budget=Budget(simulations=12),
        folder=folder,
    ).run()
    return folder


def make_varied(folder: Path) -> Path:
    """Run a campaign in a domain with a cell that is hardly ever drawn."""
    conditions = {
        "friction": {"low": 0.1, "high": 1.0, "mean": 0.6, "deviation": 0.13},
        "gust": {"low": -20, "high": 20},
        "delay": {"low": 0.0, "high": 0.4, "chance": 0.5},
    }
    domain = Domain.from_entries(
        "varied", {"roads": "urban-50,length=300", "conditions": conditions}
    )
    Campaign(
        strategy=RandomSearch(seed=1, road_class=domain.road_class, domain=domain),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(simulations=40),
        folder=folder,
    ).run()
    return folder


def make_swept(folder: Path) -> Path:
    """Run a sweep over radius and speed limit with a driver that is too fast."""
    Campaign(
        strategy=Sweep(seed=1, radii=4, speeds=3, turns=1),
        simulator=EmbeddedSimulator(),
        driver=Planner(aggression=1.4),
        budget=Budget(simulations=100),
        folder=folder,
    ).run()
    return folder


def make_hostile(folder: Path, searched: Path) -> Path:
    """Write a campaign in which every text from outside is `HOSTILE`."""
    with CampaignStore.open(searched) as store:
        config = dict(store.config)
        (failure,) = store.tests(Outcome.FAIL, order_by="moobd", limit=1, with_trajectory=True)
    result = replace(failure.result, reason=HOSTILE)
    part: JSONValue = {"class": f"module:{HOSTILE}", "options": {HOSTILE: HOSTILE}}
    versions: JSONValue = {HOSTILE: HOSTILE}
    texts = {"strategy": part, "driver": part, "versions": versions, "seed": HOSTILE}
    with CampaignStore.create(folder / "it's <b>", {**config, **texts}) as store:
        for number in (1, 2):
            candidate = Candidate(
                number,
                failure.candidate.curvatures,
                failure.candidate.step,
                Origin(HOSTILE, (1,) if number == 2 else (), number - 1),
            )
            store.add_candidate(candidate)
            store.add_result(
                replace(
                    failure,
                    candidate=candidate,
                    result=result,
                    result_number=number,
                    elapsed=0.1 * number,
                )
            )
        return store.folder


def make_empty(folder: Path, searched: Path) -> Path:
    """Write a campaign that was killed before its first test."""
    with CampaignStore.open(searched) as store:
        config = store.config
    CampaignStore.create(folder, config).close()
    return folder


def make_refused(folder: Path, searched: Path) -> Path:
    """Write a campaign with one road, which was refused."""
    make_empty(folder, searched)
    with CampaignStore.open(folder, readonly=False) as store:
        candidate = Candidate(1, np.zeros(3), 10.0, Origin("random"))
        store.add_candidate(candidate)
        store.add_result(
            Test(
                candidate=candidate,
                result=Result(Outcome.INVALID, "too short"),
                result_number=1,
                budget_spent=0.0,
            )
        )
    return folder
