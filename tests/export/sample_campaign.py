"""A campaign with every outcome but ERROR, and damaged or rewritten copies of it."""

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
def sample_campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a campaign; tests must not change it."""
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
def damaged(sample_campaign: Path, tmp_path: Path) -> Callable[[str], Path]:
    """Function that copies the campaign and changes a row of the copy by a statement."""

    def damage(statement: str) -> Path:
        folder = Path(shutil.copytree(sample_campaign, tmp_path / "damaged"))
        with closing(sqlite3.connect(folder / DATABASE)) as connection:
            assert connection.execute(statement).rowcount == 1
            connection.commit()
        return folder

    return damage


class RewriteCampaign(Protocol):
    """Writes a copy of the campaign with changed tests and a changed configuration."""

    def __call__(self, change: Callable[[Test], Test], **config: JSONValue) -> Path: ...


@pytest.fixture
def rewrite_campaign(sample_campaign: Path, tmp_path: Path) -> RewriteCampaign:
    def rewrite(change: Callable[[Test], Test], **config: JSONValue) -> Path:
        folder = tmp_path / "rewritten"
        with (
            CampaignStore.open(sample_campaign) as old,
            CampaignStore.create(folder, {**old.config, **config}) as new,
        ):
            tests = {test.id: change(test) for test in old.tests(with_trajectory=True)}
            for candidate, _ in old.candidates():
                test = tests.get(candidate.id)
                new.add_candidate(candidate if test is None else test.candidate)
            for test in tests.values():
                new.add_result(test)
        return folder

    return rewrite
