"""What a search asks of a model of the driver, and how often it follows that model."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

import numpy as np

from frenetic.search.archive import FAR, Archive, Place, critical_places
from frenetic.search.known_failures import nearest_known_square
from frenetic.search.records import Candidate, Evaluation

# All values are ours.
_COMPARED = 50  # last children by which choices with and without foresight are compared
_TRUST = 3.0  # power of the shares of new failures among them
_LEAST_SHARE = 0.05  # of children that are chosen without foresight, and of those chosen with it


@runtime_checkable
class Foresight(Protocol):
    """A model of the driver under test: what it does on a road that it has not driven."""

    @property
    def is_ready(self) -> bool:
        """Whether the model can foresee."""

    def learn(self, candidate: Candidate, evaluation: Evaluation) -> None:
        """Learn from a drive."""

    def foresee(self, candidate: Candidate) -> Evaluation | None:
        """Return what the driver will do; None where nothing would be driven."""

    def facts(self) -> Mapping[str, Any]:
        """Return what the model has to tell, see `Strategy.facts`."""


def promise_of(
    candidate: Candidate, foresight: Foresight, archive: Archive
) -> tuple[float, Place | None]:
    """Return how new a failure foresight expects of a candidate, in m, and the place foreseen.

    Negative for a candidate that is expected to pass: the margin by which it passes. Without a
    place, nothing is foreseen.
    """
    evaluation = foresight.foresee(candidate)
    if evaluation is None or evaluation.severity is None:
        return -math.inf, None
    place = critical_places(evaluation, candidate, evaluation.severity)[0]
    if not place.has_failed:
        return min(-place.severity, -0.0), place
    known = archive.failures(place.side)
    return math.sqrt(nearest_known_square(known, place.vector, FAR * FAR)), place


class ForesightTrial:
    """A running comparison of children that foresight chose with children chosen without it."""

    def __init__(self) -> None:
        self._novelties: tuple[list[float], list[float]] = [], []  # without foresight, and with it

    def learn(self, novelty: float, *, is_foreseen: bool) -> None:
        """Take in how new the failure on a child's road was, 0 to 1."""
        self._novelties[is_foreseen].append(novelty)

    def chooses(self, rng: np.random.Generator) -> bool:
        """Return whether foresight chooses the next child: the likelier, the newer its failures."""
        last = (novelties[-_COMPARED:] for novelties in self._novelties)
        without, with_it = (
            ((sum(novelties) + 1.0) / (len(novelties) + 2.0)) ** _TRUST for novelties in last
        )
        share = with_it / (without + with_it)
        share = min(max(share, _LEAST_SHARE), 1.0 - _LEAST_SHARE)
        return bool(rng.random() < share)

    def facts(self) -> dict[str, int]:
        """Return the numbers of children and of new failures, without foresight and with it."""
        facts: dict[str, int] = {}
        for way, novelties in zip(("without", "with"), self._novelties, strict=True):
            facts[f"children {way} foresight"] = len(novelties)
            facts[f"new failures {way} foresight"] = round(sum(novelties))
        return facts
