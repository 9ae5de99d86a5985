"""Importance sampling: estimate rare failures by drives in conditions in which they are common.

Each drive has standard normal numbers, which the domain turns into its conditions. The drives come
in stages, each of which draws the numbers from another distribution: first from the domain's
("plain" drives), then from a wider one, then around the failures so far. The weight of a failure is
the probability density of its conditions in the domain over their density among all draws, which is
the balance heuristic (Veach and Guibas 1995). The interval of the weighted sum is Fay and Feuer's
(1997); with equal weights it is Garwood's (1936).

If the road decides about failing and not the conditions, other distributions do not help, and the
remaining drives are plain. While few failures carry the estimate, the interval's upper end allows
for one more failure, in the conditions that were drawn least often. So the upper end falls with the
number of drives, whatever their distribution.
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
# All values that follow are our choice.
_PILOT_SHARE: Final = 0.2
"""Share of all drives in the first, plain stage."""
_COMMON_FAILURES: Final = 50
"""Failures expected in all drives from which on all drives are plain."""
_WIDE_SHARES: Final = (0.1, 0.1, 0.1)
"""Shares of the drives after the first stage that come from a wider distribution, one stage each,
until a drive fails there."""
_WIDE_DEVIATION: Final = 3.0
"""Standard deviation of the wider distribution, where the domain's is 1."""
_WIDE_PROBABILITY: Final = 0.5
"""Probability with which a wide stage draws a condition from the wider distribution."""
_CENTRES: Final = ((1.0, 0.2), (0.75, 0.3), (0.5, 0.3), (0.25, 0.1), (0.0, 0.1))
"""Centres of the draws around a failure, each with its share of the draws: 0 stands for the usual
conditions, 1 for the failure's conditions, other numbers for conditions in between."""
_MAX_FAILURES: Final = 200
"""Largest number of failures around which a stage draws."""
_REGION_DEVIATION: Final = 2.0
"""Standard deviation of the weights by which a failure is moved to the mean of the failures around
it, where the standard deviation of the domain's distribution is 1."""
_CARRYING_FAILURES: Final = 20.0
"""Effective number of failures from which on their largest weight bounds the weight of the next."""
_AROUND_SHARES: Final = (0.1, 0.15, 0.2, 0.25, 0.3)
"""Shares of the remaining drives in the stages around failures."""
_LEAST_SHARE: Final = 1e-12
"""Distance of a share of a distribution from 0 and 1, where a domain's amounts may be infinite."""


@dataclass(frozen=True)
class DriveResult:
    """Conditions of a drive in a domain, and whether the drive failed."""

    conditions: FloatArray
    """Standard normal numbers that stand for the conditions, (d,)."""
    is_failure: bool
    """Whether the drive failed."""


@dataclass(frozen=True)
class Stage:
    """Drives whose conditions come from one distribution."""

    drawn: Sequence[FloatArray | None]
    """Numbers that stand for each drive's conditions, (d,); None for a plain drive, whose numbers
    are drawn anew for each road that is tried."""
    density_ratio: Callable[[FloatArray], FloatArray]
    """Function of (n, d) numbers that returns, (n,), the density of their conditions in this stage
    over the density in the domain."""
    least_ratio: float
    """Least value of `density_ratio` for any conditions."""
    is_plain: bool = False
    """Whether the distribution is the domain's."""

    def __len__(self) -> int:
        """Return the number of drives."""
        return len(self.drawn)


class WeightedDrives:
    """Drives in conditions from several distributions, and the estimate from all of them.

    Args:
        dimension: number of standard normal numbers that stand for a drive's conditions.
        rng: generator that draws the conditions.
    """

    def __init__(self, dimension: int, rng: np.random.Generator) -> None:
        self._dimension, self._rng = dimension, rng
        self._drives: list[DriveResult] = []
        self._stages: list[Stage] = []
        # Fewest draws of any conditions, over the probability density of these conditions
        self._fewest_draws = 0.0
        self.plain: list[DriveResult] = []
        """Results of the plain drives."""

    def stages(self, drives: int) -> Iterator[Stage]:
        """Yield stages until they have as many drives as asked for.

        The caller drives a stage and calls `add` with its results before it takes the next stage.
        Plain drives come first. Others follow as long as they make the estimate more certain.

        Args:
            drives: number of all drives.
        """
        yield self._plain_stage(round(_PILOT_SHARE * drives))
        pilot_failures, pilot_drives = self.failures, self.drives
        pilot_rate = pilot_failures / pilot_drives
        is_common = pilot_rate * drives >= _COMMON_FAILURES
        remaining, helps = drives - pilot_drives, not is_common and self._dimension > 0
        for share in _WIDE_SHARES:
            if helps and self.effective_failures <= pilot_failures:  # only plain drives have failed
                yield self._wide_stage(round(share * remaining))
        drives_before, remaining, spent_share = self.drives, drives - self.drives, 0.0
        for number, share in enumerate(_AROUND_SHARES):
            spent_share += share
            # Stop if nothing has failed or, from the third stage on, if as many plain drives would
            # make the estimate more certain.
            plain_failures = pilot_rate * self.drives if number > 1 else 0.0
            helps = helps and self.effective_failures > plain_failures
            if helps:
                count = drives_before + round(spent_share * remaining) - self.drives
                yield self._stage_around_failures(count)
        if self.drives < drives:
            yield self._plain_stage(drives - self.drives)

    def _plain_stage(self, count: int) -> Stage:
        """Return a stage whose conditions are distributed as in the domain."""
        return Stage([None] * count, lambda numbers: np.ones(len(numbers)), 1.0, is_plain=True)

    def _wide_stage(self, count: int) -> Stage:
        """Return a stage that draws a condition from the domain's or from a wider distribution."""
        shape = count, self._dimension
        is_wide = self._rng.random(shape) < _WIDE_PROBABILITY
        deviations = np.where(is_wide, _WIDE_DEVIATION, 1.0)
        plain_probability = 1.0 - _WIDE_PROBABILITY

        def density_ratio(numbers: FloatArray) -> FloatArray:
            squares = numbers**2
            wider = np.exp(0.5 * (squares - squares / _WIDE_DEVIATION**2)) / _WIDE_DEVIATION
            ratios: FloatArray = np.prod(plain_probability + _WIDE_PROBABILITY * wider, axis=1)
            return ratios

        # The ratio is least at the usual conditions, where all numbers are 0.
        least = (plain_probability + _WIDE_PROBABILITY / _WIDE_DEVIATION) ** self._dimension
        return Stage([*(deviations * self._rng.standard_normal(shape))], density_ratio, least)

    def _stage_around_failures(self, count: int) -> Stage:
        """Return a stage that draws around the failures so far, and between them and the usual."""
        rng, failed, shares = self._rng, self._failed, self._shares / self._shares.sum()
        if len(shares) > _MAX_FAILURES:
            failed = failed[rng.choice(len(shares), _MAX_FAILURES, p=shares)]
            shares = np.full(_MAX_FAILURES, 1.0 / _MAX_FAILURES)
        # Each failure moves to the weighted mean of the failures around it.
        squares = np.sum((failed[:, None] - failed) ** 2, axis=2)
        weights = shares * np.exp(-0.5 * squares / _REGION_DEVIATION**2)
        means = weights @ failed / weights.sum(axis=1, keepdims=True)
        scales, scale_shares = np.array(_CENTRES).T
        centres = np.concatenate([scale * means for scale in scales])
        shares = np.outer(scale_shares, shares).ravel()
        chosen = rng.choice(len(shares), count, p=shares)

        def density_ratio(numbers: FloatArray) -> FloatArray:
            squares, total = np.sum(numbers**2, axis=1), np.zeros(len(numbers))
            for centre, share in zip(centres, shares, strict=True):
                squares_to_centre = np.sum((numbers - centre) ** 2, axis=1)
                total += share * np.exp(0.5 * (squares - squares_to_centre))
            return total

        # Around the usual conditions the stage draws as the domain does: at least that share.
        least = float(scale_shares[scales == 0.0].sum())
        drawn = centres[chosen] + rng.standard_normal((count, self._dimension))
        return Stage([*drawn], density_ratio, least)

    @property
    def drives(self) -> int:
        """Number of drives."""
        return len(self._drives)

    @property
    def effective_failures(self) -> float:
        """Number of failures with equal weights that would make the estimate as certain."""
        squares = float(np.sum(self._shares**2))
        return float(np.sum(self._shares)) ** 2 / squares if squares else 0.0

    @property
    def failures(self) -> int:
        """Number of failures in all drives."""
        return len(self._shares)

    def interval(self) -> tuple[float, float, float]:
        """Return the probability of a failure, and the ends of its two-sided interval.

        While few failures carry the estimate, the upper end allows for one more failure, in the
        conditions that were drawn least often.
        """
        largest_possible = 1.0 / self._fewest_draws
        is_carried = self.effective_failures >= _CARRYING_FAILURES
        next_weight = float(np.max(self._shares)) if is_carried else largest_possible
        low, high = weighted_interval(self._shares, min(next_weight, largest_possible), CONFIDENCE)
        return float(np.sum(self._shares)), low, high

    def add(self, stage: Stage, drives: Sequence[DriveResult]) -> None:
        """Add the results of a stage's drives, in the order of `Stage.drawn`."""
        self._drives += drives
        self._stages.append(stage)
        self._fewest_draws += stage.least_ratio * len(stage)
        if stage.is_plain:
            self.plain += drives
        failed = [drive.conditions for drive in self._drives if drive.is_failure]
        self._failed = np.array(failed).reshape(len(failed), self._dimension)
        # Expected number of draws of a failure's conditions, over their density in the domain
        draws = np.zeros(len(failed))
        for earlier in self._stages:
            draws += len(earlier) * earlier.density_ratio(self._failed)
        self._shares = 1.0 / draws
        """Weight of each failure: its share in the probability of a failure, (failures,)."""


def standard_normal_shares(normal: FloatArray) -> FloatArray:
    """Return the shares of a standard normal distribution below some numbers, within (0, 1)."""
    from scipy.special import ndtr  # imported here, since that takes long

    shares: FloatArray = np.clip(ndtr(normal), _LEAST_SHARE, 1.0 - _LEAST_SHARE)
    return shares
