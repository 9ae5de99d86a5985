"""Curves by which campaigns are compared: `CURVES`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray, IntArray
from frenetic._support.words import capitalised
from frenetic.analysis.campaign_measures import CampaignMeasures
from frenetic.analysis.spaces import SPACES

CURVE_RADII: Final = np.round(np.arange(61) * 0.05, 2)
"""Radii at which failures unlike each other are counted for a curve, (61,), 0 to 3 (our choice)."""


@dataclass(frozen=True)
class Curve:
    """Curve: numbers of failures over the simulations, or over the radius in a space."""

    name: str
    """Name of a measure, for a curve over the simulations; or name of a space."""
    title: str
    """Title of the numbers, for people."""
    caption: str = ""
    """Sentence under a chart; empty without one."""

    @property
    def is_over_radius(self) -> bool:
        """Whether the curve is over the radius in a space, rather than over the simulations."""
        return self.name in SPACES

    @property
    def x_title(self) -> str:
        """Title of the positions, for people."""
        return "radius" if self.is_over_radius else "simulations"

    def points(self, campaign: CampaignMeasures) -> tuple[FloatArray, IntArray] | None:
        """Return positions and numbers, (n,) each; None if they were not measured."""
        if self.is_over_radius:
            unlike = campaign.unlike.get(self.name)
            return None if unlike is None else (CURVE_RADII, unlike.unlike_over(CURVE_RADII))
        is_distinct = self.name == "distinct_failures"
        counts = campaign.distinct_after if is_distinct else campaign.failures_after
        return np.arange(len(counts), dtype=np.float64), counts

    def of_group(self, campaigns: Sequence[CampaignMeasures]) -> tuple[FloatArray, IntArray] | None:
        """Return positions, (n,), and numbers of each campaign, (campaigns, n).

        They are cut where the shortest campaign ends. None if a campaign lacks the curve.
        """
        positions: list[FloatArray] = []
        rows: list[IntArray] = []
        for campaign in campaigns:
            points = self.points(campaign)
            if points is None:
                return None
            positions.append(points[0])
            rows.append(points[1])
        n = min(map(len, rows))
        return positions[0][:n], np.array([row[:n] for row in rows], dtype=np.int64)


CURVES: Final[Mapping[str, Curve]] = MappingProxyType(
    {
        curve.name: curve
        for curve in (
            Curve("distinct_failures", "distinct failures"),
            Curve("failures", "failures"),
            *(
                Curve(
                    space.name,
                    f"failures unlike in {space.title}",
                    f"{capitalised(space.definition)}.",
                )
                for space in SPACES.values()
            ),
        )
    }
)
"""Name -> curve, in the order in which they are shown."""


def campaign_curves(campaign: CampaignMeasures) -> dict[str, tuple[FloatArray, IntArray]]:
    """Return positions and numbers of each curve that a campaign has, by the curve's name."""
    points = {name: curve.points(campaign) for name, curve in CURVES.items()}
    return {name: pair for name, pair in points.items() if pair is not None}
