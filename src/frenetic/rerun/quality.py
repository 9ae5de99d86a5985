"""How well two versions of a driver drive on roads that both pass, undisturbed and disturbed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from frenetic.analysis.quality import drive_quality
from frenetic.analysis.quality_differences import PairedQuality
from frenetic.campaign.record import Test
from frenetic.oracle.outcome import Outcome
from frenetic.rerun.reruns import Rerun


def paired_quality(pairs: Iterable[tuple[Test, Test]], conditions: str = "") -> PairedQuality:
    """Return the measures of two versions' drives on the same roads.

    Args:
        pairs: drives of the old and the new version on each road, with their trajectories.
        conditions: conditions of the drives, in words; empty for the campaign's conditions.
    """
    fails, qualities = [], []
    for old, new in pairs:
        if not (old.outcome.is_driven and new.outcome.is_driven):
            continue
        fails.append((old.outcome is Outcome.FAIL, new.outcome is Outcome.FAIL))
        if not any(fails[-1]) and old.drive is not None and new.drive is not None:
            qualities.append(
                (drive_quality(old.road, old.drive), drive_quality(new.road, new.drive))
            )
    return PairedQuality(conditions, fails, qualities)


def paired_tests(old: Rerun, new: Rerun) -> Sequence[tuple[Test, Test]]:
    """Return the drives of two reruns on the roads that both drove."""
    drives = {test.id: test.drives[0].test for test in new.tests}
    return [(test.drives[0].test, drives[test.id]) for test in old.tests if test.id in drives]
