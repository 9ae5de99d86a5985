"""A campaign whose roads tests drive again."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from frenetic.campaign import Budget, Campaign
from frenetic.drivers import Planner
from frenetic.search import Frenetic2021
from frenetic.simulators import EmbeddedSimulator


@pytest.fixture(scope="session")
def searched_campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a campaign; tests must not change it, but may copy it."""
    folder = tmp_path_factory.mktemp("searched") / "c"
    Campaign(
        strategy=Frenetic2021(seed=3, max_redraws=10),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(simulations=60),
        folder=folder,
    ).run()
    return folder


@pytest.fixture
def campaign(searched_campaign: Path, tmp_path: Path) -> Path:
    """Copy of the campaign, which a test may change."""
    return Path(shutil.copytree(searched_campaign, tmp_path / "c"))
