"""A campaign whose tests end in every way but ERROR, and one that is damaged."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest
from checksums import forget_checksums

from frenetic.campaign import Budget, Campaign
from frenetic.campaign.store import DATABASE
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
        ordered=True,
    ).run()
    return folder


@pytest.fixture
def damaged(made_campaign: Path, tmp_path: Path) -> Callable[[str], Path]:
    """Makes a copy in which a statement was executed."""

    def damage(statement: str) -> Path:
        folder = Path(shutil.copytree(made_campaign, tmp_path / "damaged"))
        with closing(sqlite3.connect(folder / DATABASE)) as connection:
            connection.execute("PRAGMA ignore_check_constraints = ON")
            assert connection.execute(statement).rowcount == 1
            forget_checksums(connection)
            connection.commit()
        return folder

    return damage
