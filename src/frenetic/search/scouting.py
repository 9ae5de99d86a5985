"""What a search tries until a road fails: kinds of roads, and how fast they may bend."""

from __future__ import annotations

import numpy as np

from frenetic.oracle.outcome import Outcome
from frenetic.search.archive import Archive
from frenetic.search.change_limit import ChangeLimit
from frenetic.search.operator_names import RANDOM
from frenetic.search.parents import ParentPool
from frenetic.search.random_roads import RandomRoads
from frenetic.search.records import Candidate, Evaluation
from frenetic.search.road_families import FAMILIES, FamilyChoice

# The values are our choice.
_FIRST_ROADS = 8  # random roads before the first child
_LEARNING_DRIVES = 30  # drives, after these, over which the share of random roads falls
_RANDOM_SHARE = 0.3  # share of random roads to which it falls, while no failure is known
_SHARP_RANDOM_SHARE = 0.5  # the same share among roads that may be sharper


class Scouting:
    """Chooses families of random roads, and the change that curvatures may have.

    In a road class, which has rules of its own, there is one kind of random road.

    Args:
        rng: Generator of the search.
        roads: Random roads of the search.
        parents: Drives and possible parents so far.
        archive: The archive, which knows whether a road has failed.
        sharper_after: See `ChangeLimit`.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        roads: RandomRoads,
        parents: ParentPool,
        archive: Archive,
        sharper_after: int,
    ) -> None:
        self._rng, self._parents, self._archive = rng, parents, archive
        self._families: FamilyChoice | None = None
        self._change_limit: ChangeLimit | None = None
        if not roads.has_class:
            self._families = FamilyChoice()
            self._change_limit = ChangeLimit(roads.limits, sharper_after)

    def choose_change(self) -> None:
        """Set how much curvatures of the next road may change from value to value."""
        if self._change_limit is not None:
            has_failures = self._archive.has_failures
            self._change_limit.choose(self._rng, self._parents.drives, has_failures=has_failures)

    @property
    def notice(self) -> str | None:
        """Warning that no road has failed, or only sharp ones; None if there is no such warning."""
        parents, limit = self._parents, self._change_limit
        if limit is not None and limit.has_lifted(parents.drives):
            usual = f"roads whose curvature changes by at most {limit.usual_change:g} 1/m a value"
            if limit.has_failed_within:
                return f"no failure on {usual} for long: roads that bend faster are tried, too"
            if self._archive.has_failures:
                return f"no failure on {usual}: those that fail bend faster"
            return f"no failure on {usual}: roads that bend faster are tried, too"
        if not parents.drives or self._archive.has_failures:
            return None
        if not parents.is_moobd or parents.lowest < 0.0:
            return None
        return (
            "nothing close to failing yet: the search follows the roads on which the car comes"
            " nearest to its lane's edge"
        )

    @property
    def random_share(self) -> float:
        """Chance that the next road is random rather than a child, while no failure is known."""
        limit = self._change_limit
        is_sharp = limit is not None and limit.is_lifted
        share = _SHARP_RANDOM_SHARE if is_sharp else _RANDOM_SHARE
        drives_after = self._parents.drives - _FIRST_ROADS
        return max(share, 1.0 - max(drives_after, 0) / _LEARNING_DRIVES)

    def choose_family(self) -> str:
        """Return the family of the next random road."""
        if self._families is None:
            return RANDOM
        return self._families.choose(self._rng, has_failures=self._archive.has_failures)

    def learn(self, candidate: Candidate, evaluation: Evaluation, novelty: float) -> None:
        """Learn a result: how new the failure was, 0 to 1, or how near to failing the car came."""
        operator = candidate.origin.operator
        if self._families is not None and operator in FAMILIES:
            progress = self._parents.progress(evaluation.fitness)
            self._families.learn(operator, max(novelty, progress))
        if self._change_limit is not None and evaluation.outcome is Outcome.FAIL:
            self._change_limit.learn_failure(candidate.curvatures, self._parents.drives)
