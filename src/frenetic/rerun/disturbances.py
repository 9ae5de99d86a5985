"""Disturbances: conditions in which two versions of a driver drive beside the campaign's own.

Two versions that both keep their lane in quiet conditions may differ once something disturbs them.
On each road both versions have the same noise, and the same gust at the same place.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, TypeAlias

import numpy as np

from frenetic.campaign.store import CampaignStore
from frenetic.campaign.tester import RoadTester
from frenetic.conditions.condition import (
    SEED,
    condition_named,
    known_conditions,
    require_allowed,
)
from frenetic.errors import FreneticError
from frenetic.simulators.conditions import Conditions, check_conditions, check_pair_in

Disturbance: TypeAlias = Mapping[str, float]
"""Name of a condition -> its amount in all drives."""

DEFAULT_DISTURBANCES: Final[tuple[Disturbance, ...]] = ({"noise": 0.1}, {"gust": 10.0})
"""Noise of 0.1 m about the place in the lane, and a gust of 10 m/s; our choice."""
_PLACES: Final = (0.2, 0.8)
"""First and last place of a disturbance with a place, as a share of the road; our choice."""
_SEEDS: Final = 2**31
"""Number of seeds from which the seed of noise is drawn; our choice."""


@dataclass(frozen=True)
class QualityPlan:
    """On which roads and in which conditions two versions are compared where both pass."""

    disturbances: Sequence[Disturbance] | None = None
    """Disturbances in which both versions drive the roads again; None for each of
    `DEFAULT_DISTURBANCES` that driver and simulator can have and that changes drives."""
    on_own_roads: bool = False
    """Whether the roads are the campaign's own, in place of the fresh roads."""

    def resolved(self, tester: RoadTester) -> QualityPlan:
        """Return the plan with the disturbances in which a tester's driver is to drive.

        Empty and repeated disturbances are left out.

        Raises:
            FreneticError: driver or simulator cannot have a disturbance, or its condition is
                unknown.
            ValueError: an amount is not allowed.
        """
        conditions = tester.terms.conditions
        if self.disturbances is None:
            possible = [
                disturbance
                for disturbance in DEFAULT_DISTURBANCES
                if not disturbance.items() <= conditions.items()
                and _is_possible(tester, disturbance)
            ]
            return replace(self, disturbances=possible)
        chosen = {
            tuple(sorted(disturbance.items())): disturbance
            for disturbance in self.disturbances
            if disturbance
        }
        check_disturbances(chosen.values())
        for disturbance in chosen.values():
            check_pair_in({**conditions, **disturbance}, tester.simulator, tester.driver)
        return replace(self, disturbances=list(chosen.values()))


UNDISTURBED: Final = QualityPlan(disturbances=())
"""Plan without disturbances."""


def check_disturbances(disturbances: Iterable[Disturbance]) -> None:
    """Check names and amounts of disturbances that a user gives.

    Raises:
        FreneticError: no condition has one of the names.
        ValueError: an amount is out of its range, or it sets a place or a seed, which are drawn.
    """
    for disturbance in disturbances:
        for name in disturbance:
            if name == SEED or condition_named(name).place_of:
                raise ValueError(f"{name} is drawn for each road: leave it out")
        require_allowed(disturbance)
        check_conditions(disturbance)


def _is_possible(tester: RoadTester, disturbance: Disturbance) -> bool:
    """Return whether driver and simulator can have a disturbance."""
    conditions = tester.terms.conditions_of(disturbance)
    try:
        check_pair_in(conditions, tester.simulator, tester.driver)
    except FreneticError:
        return False
    return True


def disturbed_conditions(
    folder: Path | str, tests: Iterable[int], disturbance: Disturbance
) -> dict[int, tuple[Conditions]]:
    """Return the conditions of one disturbed drive on each road, alike in each call.

    The seed of noise, and the place of a gust or a wet stretch, are drawn for each road by the id
    of its test.

    Args:
        folder: folder of the campaign that holds the roads.
        tests: ids of the tests.
        disturbance: condition -> amount.
    """
    places = [
        condition.name
        for condition in known_conditions().values()
        if condition.place_of in disturbance
    ]
    is_seeded = any(condition_named(name).is_seeded for name in disturbance)
    conditions: dict[int, tuple[Conditions]] = {}
    with CampaignStore.open(folder) as store:
        for number in tests:
            rng = np.random.default_rng(number)
            amounts = dict(disturbance)
            length = store.test(number, with_trajectory=False).candidate.length
            amounts |= {name: round(float(rng.uniform(*_PLACES)) * length, 1) for name in places}
            if is_seeded:
                amounts[SEED] = int(rng.integers(_SEEDS))
            conditions[number] = (amounts,)
    return conditions
