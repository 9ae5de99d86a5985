"""Drivers with known faults: what Frenetic says of them, on the page that shows it."""

from __future__ import annotations

from pathlib import Path

import planted_drivers as planted
import pytest

from frenetic import EmbeddedSimulator, Frenetic
from frenetic.again.minimise import Minimised, minimise_causes
from frenetic.analysis.causes import Kind
from frenetic.analysis.failures import Failure, caution, distinct_failures
from frenetic.campaign import Budget, Campaign, CampaignStore

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
SHARE = 0.6
"""Least share of the failures that have the planted cause."""


@pytest.mark.parametrize("driver", CAUSES)
def test_the_planted_cause_is_named(
    driver: type[planted.Sound], tmp_path: Path, pytestconfig: pytest.Config
) -> None:
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
    is_sound = driver is planted.Sound
    assert (summary.failed == 0) is is_sound
    assert bool(summary.not_repeatable) is (driver is planted.Unrepeatable)
    said = [one for one in clusters.causes if one.failures >= 0.1 * summary.failed]
    if not is_sound:
        most = max(said, key=lambda one: one.failures)
        assert most.words.startswith(str(CAUSES[driver]).partition("{")[0])
        assert most.failures >= SHARE * summary.failed or driver is planted.Unrepeatable
    texts = [f"{one.words} ({one.failures})" for one in said]
    texts += filter(None, [cautions if is_sound else "", summary.not_repeatable])
    example = "–"
    if said and not summary.not_repeatable:
        ((_, found),) = minimise_causes(tmp_path, clusters, campaign.tester, 50, 60.0)
        assert isinstance(found, Minimised)
        causes = [Failure.of_test(one) for one in (found.original, found.smallest)]
        assert len({one.cause and one.cause.kind for one in causes if one}) == 1
        before, after = found.shapes
        example = f"{before.length:.0f} m, cut to {after.length:.0f} m"
    (does, *_) = str(driver.__doc__).splitlines()
    row = f"| {does.rstrip('.')} | {summary.failed} | {'; '.join(texts)} | {example} |"
    if pytestconfig.getoption("--write-outputs"):
        page = PAGE.read_text(encoding="utf-8").splitlines()
        others = [line for line in page if not line.startswith(row[:20])]
        PAGE.write_text("\n".join([*others, row, ""]), encoding="utf-8", newline="\n")
    assert row in PAGE.read_text(encoding="utf-8").splitlines()
