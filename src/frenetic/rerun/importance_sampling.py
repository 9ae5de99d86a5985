"""Importance sampling: estimate rare failures by conditions in which they are common.

Each drive has standard normal numbers, from which its conditions follow as the domain distributes
them. A stage draws these numbers from its own distribution: first the domain's ("plain" drives),
then a wider one, then around the failures so far. A failure weighs as much as its conditions are
more probable in the domain than among all draws; all stages count together by the balance heuristic
(Veach and Guibas 1995). The interval is the one of a weighted sum of Poisson numbers (Fay and Feuer
1997); with equal weights it is Garwood's (1936).

Where the road decides and not the conditions, other distributions gain nothing, and the rest are
plain drives. As long as few failures carry the estimate, the upper end allows for one more failure,
in the conditions that were drawn least often. So it falls with the number of drives, wherever they
were drawn.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.analysis.statistics import weighted_interval

CONFIDENCE: Final = 0.95
"""Confidence of the interval."""
# The following values are ours.
_PILOT_SHARE: Final = 0.2
"""Share of all drives in the first, plain stage."""
_COMMON_FAILURES: Final = 50
"""Failures expected in all drives from which on all drives stay plain."""
_WIDE_SHARES: Final = (0.1, 0.1, 0.1)
"""Shares of the other drives in a wider distribution: one stage each, until a drive fails there."""
_WIDE: Final = 3.0
"""Standard deviation of the wider distribution, in standard deviations of the domain's."""
_SCALES: Final = ((1.0, 0.2), (0.75, 0.3), (0.5, 0.3), (0.25, 0.1), (0.0, 0.1))
"""Centres of draws on the way from the usual conditions (0) to a failure (1), and their shares."""
_CENTRES: Final = 200
"""Most failures around which a stage draws."""
_REGION: Final = 2.0
"""Distance of failures of one region, in standard deviations of the domain's distribution."""
_CARRYING_FAILURES: Final = 20.0
"""Effective number of failures from which on their largest weight bounds the next one's."""
_AROUND_SHARES: Final = (0.1, 0.15, 0.2, 0.25, 0.3)
"""Shares of the remaining drives in the stages around failures."""


@dataclass(frozen=True)
class DriveResult:
    """Conditions of a drive in a domain, and whether it failed."""

    conditions: FloatArray
    """Standard normal numbers of the conditions, (d,)."""
    is_failure: bool


@dataclass(frozen=True)
class Stage:
    """Drives whose conditions come from a common distribution."""

    drawn: Sequence[FloatArray | None]
    """Standard normal numbers of each drive's conditions, (d,); None where the domain's
    distribution gives them, drawn anew for each road."""
    density_ratio: Callable[[FloatArray], FloatArray]
    """Function from (n, d) numbers to their density here over their density in the domain, (n,)."""
    least_ratio: float
    """Least value of `density_ratio`."""
    is_plain: bool = False
    """Whether the distribution is the domain's."""

    def __len__(self) -> int:
        """Return the number of drives."""
        return len(self.drawn)


class WeightedDrives:
    """Drives in conditions from several distributions, which count together.

    Args:
        dimension: number of standard normal numbers of a drive's conditions.
        rng: draws.
    """

    def __init__(self, dimension: int, rng: np.random.Generator) -> None:
        self._dimension, self._rng = dimension, rng
        self._drives: list[DriveResult] = []
        self._stages: list[Stage] = []
        self._least_drawn = 0.0  # least number of draws of any conditions, over their probability
        self.plain: list[DriveResult] = []
        """Plain drives."""

    def stages(self, drives: int) -> Iterator[Stage]:
        """Yield the drives, stage by stage; call `add` with each stage before taking the next one.

        Plain drives come first. Others follow as long as they carry the estimate better.
        """
        yield self._plain_stage(round(_PILOT_SHARE * drives))
        failures, pilot = self.failures, self.drives
        is_common = failures / pilot * drives >= _COMMON_FAILURES
        remaining, gains = drives - pilot, not is_common and self._dimension > 0
        for share in _WIDE_SHARES:
            if gains and self.effective_failures <= failures:  # only plain drives have failed
                yield self._wide_stage(round(share * remaining))
        first, remaining, spent = self.drives, drives - self.drives, 0.0
        for number, share in enumerate(_AROUND_SHARES):
            spent += share
            # Stop if as many plain drives would carry the estimate better, or nothing has failed.
            plain_failures = failures / pilot * self.drives if number > 1 else 0.0
            gains = gains and self.effective_failures > plain_failures
            if gains:
                yield self._stage_around_failures(first + round(spent * remaining) - self.drives)
        if self.drives < drives:
            yield self._plain_stage(drives - self.drives)

    def _plain_stage(self, count: int) -> Stage:
        """Return drives in conditions as the domain distributes them."""
        return Stage([None] * count, lambda numbers: np.ones(len(numbers)), 1.0, is_plain=True)

    def _wide_stage(self, count: int) -> Stage:
        """Draw each condition from the domain's distribution or from a wider one."""
        shape = count, self._dimension
        wide = np.where(self._rng.random(shape) < 0.5, _WIDE, 1.0)

        def density_ratio(numbers: FloatArray) -> FloatArray:
            squares = numbers**2
            wider = np.exp(0.5 * (squares - squares / _WIDE**2)) / _WIDE
            ratios: FloatArray = np.prod(0.5 + 0.5 * wider, axis=1)
            return ratios

        # The ratio is least at the usual conditions, where all numbers are 0.
        least = (0.5 + 0.5 / _WIDE) ** shape[1]
        return Stage([*(wide * self._rng.standard_normal(shape))], density_ratio, least)

    def _stage_around_failures(self, count: int) -> Stage:
        """Draw around the failures so far, and around points between them and the usual."""
        rng, centres, shares = self._rng, self._failed, self._shares / self._shares.sum()
        if len(shares) > _CENTRES:
            centres = centres[rng.choice(len(shares), _CENTRES, p=shares)]
            shares = np.full(_CENTRES, 1.0 / _CENTRES)
        # A centre moves to the middle of the region of failures around it.
        far = np.sum((centres[:, None] - centres) ** 2, axis=2)
        near = shares * np.exp(-0.5 * far / _REGION**2)
        centres = near @ centres / near.sum(axis=1, keepdims=True)
        scales, scale_shares = np.array(_SCALES).T
        around = np.concatenate([scale * centres for scale in scales])
        shares = np.outer(scale_shares, shares).ravel()
        chosen = rng.choice(len(shares), count, p=shares)

        def density_ratio(numbers: FloatArray) -> FloatArray:
            squares, total = np.sum(numbers**2, axis=1), np.zeros(len(numbers))
            for centre, share in zip(around, shares, strict=True):
                far = np.sum((numbers - centre) ** 2, axis=1)
                total += share * np.exp(0.5 * (squares - far))
            return total

        least = float(scale_shares[scales == 0.0].sum())  # of draws around the usual conditions
        drawn = around[chosen] + rng.standard_normal((count, len(around[0])))
        return Stage([*drawn], density_ratio, least)

    @property
    def drives(self) -> int:
        """Number of drives."""
        return len(self._drives)

    @property
    def effective_failures(self) -> float:
        """Number of failures of equal weight that would carry the estimate as well."""
        squares = float(np.sum(self._shares**2))
        return float(np.sum(self._shares)) ** 2 / squares if squares else 0.0

    @property
    def failures(self) -> int:
        """Number of failures in all drives."""
        return len(self._shares)

    def interval(self) -> tuple[float, float, float]:
        """Return the probability of a failure, and the ends of its two-sided interval.

        Where few failures carry the estimate, the upper end allows for one more failure, in the
        conditions that were drawn least often.
        """
        rarest = 1.0 / self._least_drawn
        is_carried = self.effective_failures >= _CARRYING_FAILURES
        largest = float(np.max(self._shares)) if is_carried else rarest
        low, high = weighted_interval(self._shares, min(largest, rarest), CONFIDENCE)
        return float(np.sum(self._shares)), low, high

    def add(self, stage: Stage, drives: Sequence[DriveResult]) -> None:
        """Add the drives of a stage, in its order."""
        self._drives += drives
        self._stages.append(stage)
        self._least_drawn += stage.least_ratio * len(stage)
        if stage.is_plain:
            self.plain += drives
        failed = [drive.conditions for drive in self._drives if drive.is_failure]
        self._failed = np.array(failed).reshape(len(failed), self._dimension)
        drawn = np.zeros(len(failed))
        for earlier in self._stages:
            drawn += len(earlier) * earlier.density_ratio(self._failed)
        self._shares = 1.0 / drawn
        """Share of each failure in the probability of a failure."""


def standard_normal_shares(normal: FloatArray) -> FloatArray:
    """Return the shares 0..1 of a standard normal distribution below some numbers."""
    from scipy.special import ndtr  # takes its time

    shares: FloatArray = np.clip(ndtr(normal), 1e-12, 1.0 - 1e-12)
    return shares
