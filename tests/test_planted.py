"""Drivers with known faults: Frenetic names the cause, as the page on causes shows."""

from __future__ import annotations

import re
from pathlib import Path

import planted_drivers as planted
import pytest

from frenetic import EmbeddedSimulator, Frenetic
from frenetic.analysis.caution import caution
from frenetic.analysis.clusters import distinct_failures
from frenetic.analysis.failures import Failure
from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.rerun.minimise import Minimised, minimise_causes
from frenetic.segments.causes import Kind

PAGE = Path(__file__).parent.parent / "docs" / "causes.md"

CAUSES: dict[type[planted.Sound], Kind | str] = {
    planted.BrakesLate: Kind.BRAKES_LATE,
    planted.WeakSteering: Kind.TOO_LITTLE,
    planted.ShortWheelbase: Kind.TOO_LITTLE,
    planted.Lagging: Kind.OSCILLATES,
    planted.Limited: Kind.HELD,
    planted.WrongSign: Kind.WRONG_WAY,
    planted.TooFast: Kind.TOO_FAST,
    planted.CutsBends: Kind.CUTS,
    planted.Raises: "raises ValueError",
    planted.Stops: Kind.STANDS,
    planted.Unrepeatable: "",  # any
    planted.Sound: "",  # none
}
HEAVY = {
    planted.BrakesLate,
    planted.ShortWheelbase,
    planted.Lagging,
    planted.Limited,
    planted.TooFast,
    planted.CutsBends,
    planted.Raises,
    planted.Stops,
    planted.Unrepeatable,
}
"""Drivers with long searches, or with a kind of fault that a light test covers, too."""
SHARE = 0.6
"""Least share of the failures that have the planted cause."""


@pytest.mark.parametrize(
    "driver",
    [
        pytest.param(driver, marks=pytest.mark.heavy) if driver in HEAVY else driver
        for driver in CAUSES
    ],
)
def test_the_planted_cause_is_named(driver: type[planted.Sound], tmp_path: Path) -> None:
    campaign = Campaign(
        strategy=Frenetic(seed=1),
        simulator=EmbeddedSimulator(),
        driver=driver(),
        budget=Budget(simulations=150),
        folder=tmp_path,
    )
    summary = campaign.run()
    with CampaignStore.open(tmp_path) as store:
        clusters, cautions = distinct_failures(store), caution(store)
    assert (summary.failed == 0) is (driver is planted.Sound)
    assert ("random roads passed, so fewer than" in cautions) is (driver is planted.Sound)
    assert bool(summary.not_repeatable) is (driver is planted.Unrepeatable)
    if not CAUSES[driver]:
        return
    main_cause = max(clusters.causes, key=lambda cause: cause.failures)
    assert main_cause.words.startswith(str(CAUSES[driver]).partition("{")[0])
    assert main_cause.failures >= SHARE * summary.failed
    ((_, minimised),) = minimise_causes(tmp_path, clusters.causes, campaign.tester, 50, 60.0)
    assert isinstance(minimised, Minimised)
    tests = (minimised.original, minimised.smallest)
    failures = [failure for failure in map(Failure.of_test, tests) if failure]
    assert len({failure.cause and failure.cause.kind for failure in failures}) == 1
    before, after = minimised.shapes
    assert after.length < before.length
    fault = str(driver.__doc__).splitlines()[0].rstrip(".")
    page = PAGE.read_text(encoding="utf-8").splitlines()
    (row,) = (line for line in page if fault[0].lower() + fault[1:] in line)
    assert row.startswith("| " + re.split(r"\{|,| ValueError", str(CAUSES[driver]))[0])
