"""What a campaign's analysis says of its failures, as tables hold it: cause, certainty, number."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

from frenetic.analysis.cause_trials import tried_failures
from frenetic.analysis.clusters import Clusters, distinct_failures
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.errors import Fault
from frenetic.oracle.outcome import Outcome
from frenetic.rerun.minimised_roads import minimised_drives, minimised_tests
from frenetic.segments.causes import Cause, as_text


@dataclass(frozen=True)
class FailureAnalysis:
    """Distinct failures, certainties of causes and minimised roads of a campaign."""

    numbers: Mapping[int, int]
    """Id of a test -> number of its distinct failure, from 1 in the order of `Clusters`."""
    certainties: Mapping[Cause | Fault | None, str]
    """Cause without the side of its bends -> how sure it is, for those that were tried."""
    minimised_lengths: Mapping[int, float]
    """Id of a test -> length of its minimised road, in m."""

    @classmethod
    def of(cls, store: CampaignStore, clusters: Clusters | None = None) -> Self:
        """Return the analysis of a campaign.

        Args:
            store: the campaign.
            clusters: its distinct failures, if they are known.

        Raises:
            CampaignError: the campaign is damaged.
        """
        clusters = distinct_failures(store) if clusters is None else clusters
        minimised = minimised_drives(store, minimised_tests(store.folder))
        tried = tried_failures(store.facts)
        return cls(
            {i: number for number, cluster in enumerate(clusters, 1) for i in cluster.ids},
            {
                without_side(group.clusters[0].cause or group.fault): str(
                    tried[group.example].certainty(group.failures / clusters.failures)
                )
                for group in clusters.causes
                if group.example in tried
            },
            {test_id: test.road.length for test_id, test in minimised.items()},
        )

    def certainty_of(self, cause: Cause | Fault | None) -> str | None:
        """Return how sure a cause is, whatever the side of its bends; None if it was not tried."""
        return self.certainties.get(without_side(cause))

    def values_of(self, test: Test) -> dict[str, Any]:
        """Return the values of a failed test in its `FAILURE_COLUMNS`, without missing ones.

        The test was read with the values of its segment.
        """
        cause = cause_of_test(test)
        row = {
            "cause": cause_text(without_side(cause)),
            "cause_side": cause.bend_side if isinstance(cause, Cause) else None,
            "cause_certainty": self.certainty_of(cause),
            "distinct_failure": self.numbers.get(test.id),
            "minimised_length": self.minimised_lengths.get(test.id),
        }
        return {name: value for name, value in row.items() if value is not None}


def cause_of_test(test: Test) -> Cause | Fault | None:
    """Return what the driver did wrong in a test that failed, or the fault that ended the drive.

    None if the test did not fail, or was read without the values of its segment.
    """
    if test.outcome is not Outcome.FAIL:
        return None
    values = test.stored_values or test.measure()
    return test.result.fault if values is None or values.cause is None else values.cause


def cause_text(cause: Cause | Fault | None) -> str | None:
    """Return the cause of a failure in words; None without a cause."""
    if isinstance(cause, Cause):
        return as_text(*cause)
    return None if cause is None else str(cause)


def without_side(cause: Cause | Fault | None) -> Cause | Fault | None:
    """Return a cause without the side of its bends."""
    return cause._replace(bend_side=None) if isinstance(cause, Cause) else cause
