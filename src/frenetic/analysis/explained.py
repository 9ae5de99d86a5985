"""Causes of a campaign's failures with their evidence and their trials."""

from __future__ import annotations

from dataclasses import dataclass

from frenetic._support.json_value import JSONValue
from frenetic.analysis.cause_trials import Certainty, TriedFailure, tried_failures
from frenetic.analysis.clusters import CauseGroup, Clusters
from frenetic.analysis.passing import passing_drives
from frenetic.campaign.store import CampaignStore
from frenetic.segments.evidence import Evidence, evidence_of_result
from frenetic.segments.passing import PassingDrives


@dataclass(frozen=True)
class ExplainedCause:
    """A cause with the evidence of an example, and what its trials showed."""

    group: CauseGroup
    """The failures with the cause."""
    share: float
    """Share of all compared failures that have the cause, above 0 to 1."""
    evidence: Evidence | None
    """Evidence of the example; None for a fault of the driver."""
    tried: TriedFailure | None
    """Trials of the example; None if it was not tried."""

    @property
    def certainty(self) -> Certainty | None:
        """How sure the cause is; None if it was not tried."""
        return None if self.tried is None else self.tried.certainty(self.share)

    def as_text(self) -> str:
        """Return evidence and trials of the example, after a subject; empty without both."""
        texts = [
            "" if self.evidence is None else self.evidence.text,
            "" if self.tried is None else self.tried.as_text(),
        ]
        return "; ".join(filter(None, texts))

    def as_json(self) -> dict[str, JSONValue]:
        """Return the cause as a JSON object."""
        return {
            "cause": self.group.words,
            "certainty": None if self.certainty is None else str(self.certainty),
            "failures": self.group.failures,
            "distinct_failures": len(self.group.clusters),
            "example": self.group.example,
            "evidence": None if self.evidence is None else self.evidence.as_json(),
            "trials": None if self.tried is None else self.tried.as_json(),
        }


def explained_causes(
    store: CampaignStore, clusters: Clusters, passing: PassingDrives | None = None
) -> tuple[ExplainedCause, ...]:
    """Return the causes of a campaign's failures, the most frequent first after faults.

    Args:
        store: the campaign.
        clusters: its distinct failures.
        passing: its passing drives, if they are read already.

    Raises:
        CampaignError: the campaign is damaged.
    """
    tried = tried_failures(store.facts)
    passing = passing_drives(store) if passing is None else passing
    causes = []
    for group in clusters.causes:
        evidence = None
        if group.fault is None:
            test = store.test(group.example)
            evidence = evidence_of_result(test.segment, test.result, passing)
        share = group.failures / clusters.failures
        causes.append(ExplainedCause(group, share, evidence, tried.get(group.example)))
    return tuple(causes)
