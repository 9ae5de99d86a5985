"""Measures by which campaigns are compared: `MEASURES`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from frenetic.analysis.campaign_measures import CampaignMeasures
from frenetic.analysis.diameter import MOST_COMPRESSED
from frenetic.analysis.failure_stability import GRIP_CHANGE, Grip
from frenetic.analysis.spaces import SPACES, Space

RADII: Final = (0.5, 1.0, 2.0)
"""Radii at which failures unlike each other are measures, in each space (our choice)."""
MAIN_RADIUS: Final = 1.0
"""Radius of the main measure in each space."""


@dataclass(frozen=True)
class Measure:
    """Measure: a number by which campaigns are compared."""

    name: str
    """Name of the attribute of `CampaignMeasures`, unless a subclass says otherwise."""
    title: str
    """Title for people."""
    definition: str
    """Definition, in a sentence or two."""
    short: str
    """Title for a narrow column."""
    unit: str = ""
    """Unit; empty without a unit."""
    more_is_better: bool = True
    """Whether more is better for a search, rather than less."""
    decimals: int = 0
    """Number of decimal places of values as text."""
    is_main: bool = False
    """Whether short tables, such as the command's, show the measure."""
    is_shared_with_search: bool = False
    """Whether the search `frenetic` itself uses the difference behind the measure."""

    def of(self, campaign: CampaignMeasures) -> float | None:
        """Return the measure's value; None if the campaign lacks it.

        The value is infinite for an event that never happened, which is worse than any number.
        """
        value = getattr(campaign, self.name)
        return None if value is None else float(value)

    def text(self, value: float) -> str:
        """Return a value as text, without the unit; "none" for an infinite value."""
        return "none" if math.isinf(value) else f"{value:.{self.decimals}f}"

    @property
    def heading(self) -> str:
        """Title, with the unit if there is one."""
        return f"{self.title} ({self.unit})" if self.unit else self.title

    @property
    def sign(self) -> float:
        """Factor 1 or -1 that makes larger values better."""
        return 1.0 if self.more_is_better else -1.0

    @property
    def better(self) -> str:
        """Word for better values: more or less."""
        return "more" if self.more_is_better else "less"


@dataclass(frozen=True, kw_only=True)
class UnlikeMeasure(Measure):
    """Measure: the number of failures unlike each other in a space, at a radius."""

    space: str
    """Name of the space, see `SPACES`."""
    radius: float
    """Root mean square difference up to which average linkage joins failures."""

    @classmethod
    def at(cls, space: Space, radius: float) -> UnlikeMeasure:
        """Return the measure in a space at a radius."""
        at_radius = f"{radius:g}"
        return cls(
            f"{space.name}_{at_radius.replace('.', '_')}",
            f"unlike in {space.title}, radius {at_radius}",
            "Clusters of failures, joined up to this root mean square difference of"
            f" {space.definition}.",
            f"{space.title} {at_radius}",
            is_main=radius == MAIN_RADIUS,
            space=space.name,
            radius=radius,
        )

    def of(self, campaign: CampaignMeasures) -> float | None:
        """Return the number of failures unlike each other; None if it was not measured."""
        unlike = campaign.unlike.get(self.space)
        return None if unlike is None else float(unlike.unlike_at(self.radius))


HEADLINE: Final = "distinct_failures"
"""Name of the measure that orders groups."""


def _all_measures() -> Iterator[Measure]:
    """Yield all measures, in the order in which they are shown."""
    yield Measure(
        HEADLINE,
        "distinct failures",
        "Clusters of failures that are the same problem: side, road and drive before the departure"
        " differ by up to 2 m.",
        "distinct",
        is_main=True,
        is_shared_with_search=True,
    )
    yield Measure(
        "failures",
        "failures",
        "FAIL outcomes. A road that was driven again in the same conditions counts once, in this"
        " and every other measure but exact repeats.",
        "failures",
        is_main=True,
    )
    for space in SPACES.values():
        for radius in RADII:
            yield UnlikeMeasure.at(space, radius)
    yield from _OTHER_MEASURES


_OTHER_MEASURES: Final = (
    Measure(
        "cells",
        "cells of the feature map",
        "Cells that hold a failure, of 10 x 10 x 10 x 10 over direction coverage 0.05..1.05,"
        " largest curvature 0..0.07 1/m, standard deviation of steering 0..0.3 rad and mean"
        " lateral position -1.5..1.5 m, on the failures' segments.",
        "cells",
        is_main=True,
    ),
    Measure(
        "unlike_roads",
        "failing roads unlike each other",
        "Failing roads, each of which differs from every one counted before it in more than a"
        " fifth of its steps of 5 m: whole roads, whatever happens on them.",
        "roads",
        is_main=True,
    ),
    Measure(
        "competition_sparseness",
        "competition's sparseness",
        "As the competition of 2021 and 2022, mistakes included: per failure the largest edit"
        " distance to those after it in the order of the tests, mean. One odd road raises it for"
        " all. None for fewer than two failures, which counts as worse than any number.",
        "sparseness",
        unit="edits",
        decimals=1,
        is_main=True,
    ),
    Measure(
        "test_set_diameter",
        "test-set diameter",
        "As Feldt, Poulding, Clark and Yoo (2016), first formula: how much the curvatures of the"
        f" failing roads hold that the other roads do not, by zlib, of at most {MOST_COMPRESSED}"
        " roads. It grows with their number. None for fewer than two failures, which counts as"
        " worse than any number.",
        "diameter",
        decimals=3,
    ),
    Measure(
        "mean_distinct_failures",
        "distinct failures over the budget",
        "Mean of the curve of distinct failures over the simulations, in failures: early ones"
        " count more.",
        "distinct, mean",
        decimals=1,
        is_shared_with_search=True,
    ),
    Measure(
        "mean_failures",
        "failures over the budget",
        "Mean of the curve of failures over the simulations, in failures: early ones count more.",
        "failures, mean",
        decimals=1,
    ),
    Measure(
        "simulations_to_failure",
        "simulations to first failure",
        "Simulations up to and with the first failure; none if there was none, which counts as"
        " later than any.",
        "first failure",
        more_is_better=False,
        is_main=True,
    ),
    Measure(
        "kilometres_to_failure",
        "kilometres to first failure",
        "Length of road driven up to and with the first failure; none if there was none.",
        "first failure",
        unit="km",
        more_is_better=False,
        decimals=2,
    ),
    Measure(
        "seconds_to_failure",
        "simulated time to first failure",
        "Simulated time up to and with the first failure; none if there was none.",
        "first failure",
        unit="s",
        more_is_better=False,
    ),
    Measure(
        "min_moobd",
        "lowest MOOBD",
        "Lowest minimum oob distance of all drives: how near to failing, or beyond, a driver was"
        " brought. The one measure that tells searches apart where none fails.",
        "lowest MOOBD",
        unit="m",
        more_is_better=False,
        decimals=2,
        is_main=True,
    ),
    Measure(
        "passes_with_more_grip",
        f"share that passes {Grip.MORE}",
        f"Of the failures that were driven again, the share that passes {Grip.MORE}: failures at"
        " the very limit. None without a failure, which counts as worse than any number.",
        f"pass {Grip.MORE}",
        more_is_better=False,
        decimals=2,
        is_main=True,
    ),
    Measure(
        "keeps_cause",
        "share that keeps its cause",
        "Of the failures that were driven again as they were, with"
        f" {100.0 * GRIP_CHANGE:g} % less and with {100.0 * GRIP_CHANGE:g} % more grip, the share"
        " with its recorded cause in each of these drives that fails. None without a failure, which"
        " counts as worse than any number.",
        "keep cause",
        decimals=2,
        is_main=True,
    ),
    Measure(
        "valid_share",
        "valid share",
        "Valid roads divided by all roads tested, refused ones included.",
        "valid share",
        decimals=3,
        is_main=True,
    ),
    Measure(
        "invalid_roads",
        "invalid roads",
        "Roads that were refused, so that nothing was driven.",
        "invalid",
        more_is_better=False,
    ),
    Measure(
        "failing_repeats",
        "exact repeats",
        "Failures on a road that had failed before in the same conditions.",
        "repeats",
        more_is_better=False,
    ),
    Measure(
        "strategy_seconds",
        "generator time",
        "Wall time in which the search or generator computed.",
        "generator time",
        unit="s",
        more_is_better=False,
        decimals=2,
    ),
)

MEASURES: Final[Mapping[str, Measure]] = MappingProxyType(
    {measure.name: measure for measure in _all_measures()}
)
"""Name -> measure, in the order in which they are shown."""

SHARED_TEXT: Final = (
    "The search frenetic itself uses the difference behind distinct failures, also over the"
    " budget; no search uses the other measures, beyond the outcome and the MOOBD of each drive."
)
"""Sentence about the measures that a search uses itself, see `Measure.is_shared_with_search`."""


def campaign_values(campaign: CampaignMeasures) -> dict[str, float | None]:
    """Return the value of each measure by its name; None if the campaign lacks it."""
    return {name: measure.of(campaign) for name, measure in MEASURES.items()}
