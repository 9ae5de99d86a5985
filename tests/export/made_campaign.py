"""A campaign whose tests end in every way but ERROR, and copies that are damaged or told anew."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Protocol

import pytest

from frenetic._support.json_value import JSONValue
from frenetic.campaign import Budget, Campaign, CampaignStore, Test
from frenetic.campaign.database import DATABASE
from frenetic.drivers import Planner
from frenetic.search import Frenetic2021
from frenetic.simulators import EmbeddedSimulator


@pytest.fixture(scope="session")
def made_campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its folder; nothing in it may be changed."""
    folder = tmp_path_factory.mktemp("exported") / "c"
    Campaign(
        strategy=Frenetic2021(seed=3),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(simulations=60),
        folder=folder,
        max_in_flight=16,
    ).run()
    return folder


@pytest.fixture
def damaged(made_campaign: Path, tmp_path: Path) -> Callable[[str], Path]:
    """Makes a copy in which a statement changed one row."""

    def damage(statement: str) -> Path:
        folder = Path(shutil.copytree(made_campaign, tmp_path / "damaged"))
        with closing(sqlite3.connect(folder / DATABASE)) as connection:
            assert connection.execute(statement).rowcount == 1
            connection.commit()
        return folder

    return damage


class ToldAnew(Protocol):
    """Makes a sound campaign of the tests, each of them changed, with a changed configuration."""

    def __call__(self, change: Callable[[Test], Test], **config: JSONValue) -> Path: ...


@pytest.fixture
def told_anew(made_campaign: Path, tmp_path: Path) -> ToldAnew:
    def tell(change: Callable[[Test], Test], **config: JSONValue) -> Path:
        folder = tmp_path / "told anew"
        with (
            CampaignStore.open(made_campaign) as old,
            CampaignStore.create(folder, {**old.config, **config}) as new,
        ):
            tests = {test.id: change(test) for test in old.tests(with_trajectory=True)}
            for candidate, _ in old.candidates():
                test = tests.get(candidate.id)
                new.add_candidate(candidate if test is None else test.candidate)
            for test in tests.values():
                new.add_result(test)
        return folder

    return tell
