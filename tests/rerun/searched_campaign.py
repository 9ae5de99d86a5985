"""The campaign whose roads are driven again."""

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
    """Its folder; nothing in it may be changed, but it can be copied."""
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
    """A copy of it, which may be written to."""
    return Path(shutil.copytree(searched_campaign, tmp_path / "c"))
