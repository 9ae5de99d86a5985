"""Foresight: a model of the driver that a search may ask, and how often it follows the model."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np

from frenetic.search.archive import FAR, Archive, Place, critical_places
from frenetic.search.known_failures import nearest_known_square
from frenetic.search.records import Candidate, Evaluation

# The values are our choice.
_COMPARED = 50  # last children of either kind, with and without foresight, that are compared
_POWER = 3.0  # power of the shares of new failures among them
_LEAST_SHARE = 0.05  # least share of children of either kind


@runtime_checkable
class Foresight(Protocol):
    """A model of the driver under test: what it does on a road that it has not driven."""

    @property
    def is_ready(self) -> bool:
        """Whether the model can foresee."""

    def learn(self, candidate: Candidate, evaluation: Evaluation) -> None:
        """Learn from a drive."""

    def foresee(self, candidates: Sequence[Candidate]) -> Sequence[Evaluation | None]:
        """Return what the driver will do on each road; None where nothing is foreseen."""

    def facts(self) -> Mapping[str, Any]:
        """Return facts about the model for reports, see `Strategy.facts`."""


def promise_of(
    candidate: Candidate, evaluation: Evaluation | None, archive: Archive
) -> tuple[float, Place | None]:
    """Return the promise of a candidate, in m, and the place that is foreseen.

    The promise of a foreseen failure is its difference from the known failures. The promise of a
    foreseen pass is negative: the margin to failing. If nothing is foreseen, it is -infinity, and
    the place is None.

    Args:
        candidate: The candidate.
        evaluation: What is foreseen; None for nothing.
        archive: The archive with the known failures.
    """
    if evaluation is None or evaluation.fitness is None:
        return -math.inf, None
    place = critical_places(evaluation, candidate, evaluation.fitness)[0]
    if not place.has_failed:
        return min(-place.fitness, -0.0), place
    known = archive.failures(place.side)
    return math.sqrt(nearest_known_square(known, place.vector, FAR * FAR)), place


class ForesightTrial:
    """A running comparison of children that foresight chose with children chosen without it."""

    def __init__(self) -> None:
        # Novelties of children chosen without foresight, and of children chosen with it.
        self._novelties: tuple[list[float], list[float]] = [], []

    def learn(self, novelty: float, *, is_foreseen: bool) -> None:
        """Learn how new the failure of a child was, 0 to 1; 0 if it passed."""
        self._novelties[is_foreseen].append(novelty)

    def chooses(self, rng: np.random.Generator) -> bool:
        """Return whether foresight chooses the next child, at random.

        The chance grows with the share of new failures among the children that foresight chose.
        """
        last = (novelties[-_COMPARED:] for novelties in self._novelties)
        # Both shares begin at one half, as if one of two children had brought a new failure.
        without, with_foresight = (
            ((sum(novelties) + 1.0) / (len(novelties) + 2.0)) ** _POWER for novelties in last
        )
        share = with_foresight / (without + with_foresight)
        share = min(max(share, _LEAST_SHARE), 1.0 - _LEAST_SHARE)
        return bool(rng.random() < share)

    def facts(self) -> dict[str, int]:
        """Return the numbers of children and of new failures, without foresight and with it."""
        facts: dict[str, int] = {}
        for kind, novelties in zip(("without", "with"), self._novelties, strict=True):
            facts[f"children {kind} foresight"] = len(novelties)
            facts[f"new failures {kind} foresight"] = round(sum(novelties))
        return facts
