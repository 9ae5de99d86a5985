"""A campaign whose folder is removed while it runs says so, and does not search into nothing."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from events import on_test

from frenetic import Budget, Campaign, EmbeddedSimulator, Planner, RandomSearch
from frenetic.campaign.database import DATABASE
from frenetic.errors import CampaignError


@pytest.mark.parametrize("what", ["folder", "database", "replaced"])
def test_a_removed_database_ends_the_campaign(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("frenetic.campaign.loop.PROGRESS_INTERVAL", 0.0)
    folder = tmp_path / "campaign"
    campaign = Campaign(
        strategy=RandomSearch(seed=1),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(simulations=1000),
        folder=folder,
    )
    seen = 0

    def remove(_: object) -> None:
        nonlocal seen
        seen += 1
        if seen == 5:
            if what == "folder":
                shutil.rmtree(folder)
            else:
                (folder / DATABASE).rename(folder / "elsewhere")
            if what == "replaced":
                (folder / DATABASE).write_bytes(b"another file")

    with pytest.raises(CampaignError, match=r"was removed or replaced while it was written"):
        campaign.run(on_event=on_test(remove))
    assert seen < 20
