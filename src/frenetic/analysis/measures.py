"""The numbers by which campaigns are compared: what they are called, mean and lie between."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Final

from frenetic.analysis.measuring import CampaignMeasures


class Topic(StrEnum):
    """What a measure tells of a search."""

    FOUND = "found"
    DIFFERENT = "diversity"
    COMPETITION = "as the competition"
    """Computed as the published code of the SBST/SBFT competition does it."""
    SOON = "first failure"
    COST = "cost"
    SPENT = "spent"


@dataclass(frozen=True)
class Measure:
    """A number by which campaigns are compared."""

    name: str
    """Of the attribute of `CampaignMeasures`."""
    title: str
    unit: str
    """Empty if it has none."""
    more_is_better: bool | None
    """For a search; None if neither is, so that nobody is better by it."""
    decimals: int
    definition: str
    """What it is, in a sentence or two."""
    bounds: str
    """Between what it lies, as a text."""
    short: str
    """A title for a narrow column."""
    topic: Topic
    is_main: bool = True
    """Whether it is shown where there is little room."""

    def of(self, campaign: CampaignMeasures) -> float | None:
        """This measure's value; None if the campaign has none.

        What never happened is infinitely late or infinitely little: worse than any number.
        """
        value = getattr(campaign, self.name)
        return None if value is None else float(value)

    def text(self, value: float) -> str:
        """A value for people, without its unit."""
        return "none" if math.isinf(value) else f"{value:.{self.decimals}f}"

    @property
    def heading(self) -> str:
        """Its title, with its unit if it has one."""
        return f"{self.title} ({self.unit})" if self.unit else self.title

    @property
    def better(self) -> str:
        """Which value is better: more, less or neither."""
        if self.more_is_better is None:
            return "neither"
        return "more" if self.more_is_better else "less"


HEADLINE: Final = "distinct_per_100"
"""The measure by which groups are put in order."""

MEASURES: Final[Mapping[str, Measure]] = MappingProxyType(
    {
        measure.name: measure
        for measure in (
            Measure(
                "distinct_per_100",
                "distinct failures per 100 simulations",
                "",
                True,
                1,
                "Distinct failures divided by the simulations of valid roads, times 100. A"
                " simulation that ended in an ERROR was spent and counts; a refused road was not"
                " driven and does not. Of a run of a bench that ended before its budget, what was"
                " left of that counts, too.",
                "0..100",
                "distinct per\u00a0100",
                Topic.FOUND,
            ),
            Measure(
                "distinct_failures",
                "distinct failures",
                "",
                True,
                0,
                "Clusters of failures that are the same problem: side, road and drive before the"
                " departure differ by up to 2 m.",
                "0..failures",
                "distinct",
                Topic.FOUND,
            ),
            Measure(
                "failures",
                "failures",
                "",
                True,
                0,
                "FAIL outcomes.",
                "0..simulations",
                "failures",
                Topic.FOUND,
            ),
            Measure(
                "failures_per_100",
                "failures per 100 simulations",
                "",
                True,
                1,
                "FAIL outcomes divided by simulations, ERROR included, times 100.",
                "0..100",
                "failures per\u00a0100",
                Topic.FOUND,
                is_main=False,
            ),
            Measure(
                "cells",
                "cells of the feature map",
                "",
                True,
                0,
                "Cells that hold a failure, of 10 x 10 x 10 x 10 over direction coverage"
                " 0.05..1.05, largest curvature 0..0.07 1/m, standard deviation of steering"
                " 0..0.3 rad and mean lateral position -1.5..1.5 m, on the failures' segments.",
                "0..10000",
                "cells",
                Topic.FOUND,
            ),
            Measure(
                "pairwise_diversity",
                "diversity of failures",
                "",
                True,
                3,
                "Mean share of its steps that must be edited to make one failure's segment"
                " another's, over all pairs of failures; of more than 200 failures, over those of"
                " 200. Depends on no order. None for fewer than two failures, which counts as"
                " worse than any number.",
                "0..1",
                "pairwise",
                Topic.DIFFERENT,
            ),
            Measure(
                "competition_sparseness",
                "competition's sparseness",
                "edits",
                True,
                1,
                "As the competition of 2021 and 2022, mistakes included: per failure the largest"
                " edit distance to those after it in the order of the tests, mean. One odd road"
                " raises it for all. None for fewer than two failures, which counts as worse than"
                " any number.",
                "0..about 60",
                "sparseness",
                Topic.COMPETITION,
            ),
            Measure(
                "competition_cells",
                "competition's map: cells",
                "",
                True,
                0,
                "As the competition of 2023, mistakes included: cells that hold a failure, of 10"
                " x 10 x 10 x 10 over DIR_COV 0..0.5 (it never exceeds 0.5), STD_SA 0..20 degrees"
                " of the front wheels, MAX_CURV 0..0.07 1/m and MEAN_LP 0..2 m. The competition"
                " published no ranges: these are ours, so its own tables cannot be compared.",
                "0..10000",
                "cells",
                Topic.COMPETITION,
                is_main=False,
            ),
            Measure(
                "simulations_to_failure",
                "simulations to first failure",
                "",
                False,
                0,
                "Simulations up to and with the first failure; none if there was none, which"
                " counts as later than any.",
                "1..simulations",
                "simulations",
                Topic.SOON,
            ),
            Measure(
                "virtual_seconds_to_failure",
                "virtual time to first failure",
                "s",
                False,
                0,
                "Simulations up to and with the first failure, each at its cost on the bench's"
                " clock, without the generator's own time.",
                "0..budget",
                "virtual time",
                Topic.SOON,
                is_main=False,
            ),
            Measure(
                "seconds_to_failure",
                "time to first failure",
                "s",
                False,
                2,
                "Wall time of the campaign up to the first failure: depends on the machine.",
                "0..",
                "wall time",
                Topic.SOON,
                is_main=False,
            ),
            Measure(
                "invalid_share",
                "invalid share",
                "",
                False,
                3,
                "Refused roads divided by all roads tested.",
                "0..1",
                "invalid share",
                Topic.COST,
            ),
            Measure(
                "generator_seconds",
                "generator time",
                "s",
                False,
                2,
                "Wall time that the strategy or generator itself took over the whole campaign:"
                " depends on the machine.",
                "0..",
                "generator time",
                Topic.COST,
            ),
            Measure(
                "tests",
                "tests",
                "",
                None,
                0,
                "Roads handed over to be tested: simulations and refused roads.",
                "0..",
                "tests",
                Topic.SPENT,
                is_main=False,
            ),
            Measure(
                "simulations",
                "simulations",
                "",
                None,
                0,
                "Valid roads that were driven, whether they ended in PASS, FAIL or ERROR.",
                "0..tests",
                "simulations",
                Topic.SPENT,
                is_main=False,
            ),
            Measure(
                "invalid",
                "invalid tests",
                "",
                None,
                0,
                "Roads that were refused and not driven.",
                "0..tests",
                "invalid tests",
                Topic.SPENT,
                is_main=False,
            ),
            Measure(
                "errors",
                "errors",
                "",
                None,
                0,
                "Simulations that broke.",
                "0..simulations",
                "errors",
                Topic.SPENT,
                is_main=False,
            ),
        )
    }
)
"""Name -> measure, in the order in which they are shown."""
