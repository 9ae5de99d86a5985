"""Whether a twin ranks roads well enough to start a search from: figures and a verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, TypeAlias

import numpy as np

from frenetic._support.arrays import FloatArray, IntArray
from frenetic._support.words import counted
from frenetic.analysis.statistics import a12
from frenetic.plugins.twin.profile import PredictionFigures, TwinProfile

UNFITTED: Final = "the driver as it was"
"""Name of the baseline that drives with the twin before its fit."""
CURVATURE: Final = "largest curvature"
"""Name of the baseline that ranks roads by their largest curvature."""
MIN_OUTCOMES: Final = 10
"""Fewest failures, and fewest other drives, for a verdict; our choice."""
GOOD_AUC, FAIR_AUC = 0.65, 0.5
"""Least lower end of the AUC's interval for the verdicts good and fair; 0.5 is chance."""
GOOD_LIFT, FAIR_LIFT = 2.0, 1.3
"""Least lift of the top tenth for the verdicts good and fair; our choice."""
NEAR_BEST_LIFT: Final = 0.8
"""Share of the largest possible lift that is enough for both verdicts; our choice."""
OUTCOMES_RATIO: Final = 1.5
"""Ratio of the twin's failures to the recorded ones, or the inverse, that is noted; our choice."""
BOOTSTRAP_SAMPLES: Final = 400
"""Number of samples from which the interval of the AUC is taken; our choice."""
VERDICTS: Final[Mapping[str, str]] = {
    "good": "Good enough to start from",
    "fair": "Better than chance, start from it with care",
    "poor": "Not good enough to start from",
    "unknown": "Whether it is good enough to start from cannot be told",
}
"""Sentence of each verdict."""

_MOOBD_WEIGHT: Final = 1e-6  # [1/m] so small that the MOOBD only orders equal oob shares

Verdict: TypeAlias = Literal["good", "fair", "poor", "unknown"]


@dataclass(frozen=True)
class TwinDrive:
    """How a twin drove the road of a recorded drive."""

    failed: bool
    oob_share: float
    """Largest share of the car's box outside the ego lane."""
    moobd: float
    """Least oob distance, in m."""
    offset_error: float
    """Median difference of the lateral offset from the recorded drive's, in m."""

    @property
    def score(self) -> float:
        """Rank of the road for the twin, larger is worse: by oob share, then by MOOBD."""
        return self.oob_share - _MOOBD_WEIGHT * self.moobd


def auc_of(score: FloatArray, failed: FloatArray) -> float | None:
    """Return the chance that a failed drive ranks above another one.

    None if all drives failed, or none.
    """
    is_failed = failed > 0.5
    if is_failed.all() or not is_failed.any():
        return None
    return a12(score[is_failed], score[~is_failed])


def top_tenth(score: FloatArray, failed: FloatArray) -> float | None:
    """Return the lift of the top tenth: the failures' share there over their share in all.

    Roads of equal score count as if in random order. None if no drive failed.
    """
    if not failed.any():
        return None
    order = np.argsort(-score, kind="stable")
    _, group, counts = np.unique(-score[order], return_inverse=True, return_counts=True)
    expected_failures = (np.bincount(group, weights=failed[order]) / counts)[group]
    shares_found = np.concatenate(([0.0], np.cumsum(expected_failures))) / failed.sum()
    return float(np.interp(0.1 * len(score), np.arange(len(shares_found)), shares_found)) / 0.1


def figures_of(
    score: FloatArray, failed: FloatArray, twin_drives: Sequence[TwinDrive] | None = None
) -> PredictionFigures:
    """Return the figures of a ranking of roads.

    Args:
        score: score of each road, (n,), larger is worse.
        failed: 1 for each recorded drive that failed, else 0, (n,).
        twin_drives: how a twin drove the roads; None for a ranking without drives.
    """
    auc, lift = auc_of(score, failed), top_tenth(score, failed)
    if twin_drives is None:
        return PredictionFigures(auc=auc, top_tenth=lift)
    twin_failed = np.array([drive.failed for drive in twin_drives], dtype=np.float64)
    return PredictionFigures(
        auc=auc,
        top_tenth=lift,
        twin_failures=int(twin_failed.sum()),
        agreement=float((twin_failed == failed).mean()),
        offset_error=float(np.median([drive.offset_error for drive in twin_drives])),
    )


def auc_interval(
    score: FloatArray, failed: FloatArray, labels: IntArray
) -> tuple[float, float] | None:
    """Return the 95 % interval of the AUC: a bootstrap over independent groups of drives.

    None if fewer than half of the samples hold failures and other drives.
    """
    members = [np.flatnonzero(labels == label) for label in range(labels.max() + 1)]
    generator = np.random.default_rng(0)
    aucs = []
    for _ in range(BOOTSTRAP_SAMPLES):
        drawn = generator.integers(len(members), size=len(members))
        sample = np.concatenate([members[i] for i in drawn])
        auc = auc_of(score[sample], failed[sample])
        if auc is not None:
            aucs.append(auc)
    if len(aucs) < BOOTSTRAP_SAMPLES // 2:
        return None
    low, high = np.quantile(aucs, [0.025, 0.975])
    return float(low), float(high)


def verdict_of(
    twin: PredictionFigures,
    failed: FloatArray,
    interval: tuple[float, float] | None,
    baselines: Mapping[str, PredictionFigures],
) -> tuple[Verdict, str]:
    """Return whether a twin is good enough to start from, and why, in a sentence.

    Args:
        twin: figures of the twin.
        failed: 1 for each recorded drive that failed, else 0, (n,).
        interval: interval of the twin's AUC, as `auc_interval` returns it.
        baselines: name -> figures of a baseline.
    """
    drives, failures = len(failed), int(failed.sum())
    if min(failures, drives - failures) < MIN_OUTCOMES or twin.auc is None or interval is None:
        return "unknown", (
            f"{failures} of {drives} recorded drives failed: {MIN_OUTCOMES} failures and"
            f" {MIN_OUTCOMES} others are needed to say whether its ranking can be trusted"
        )
    low, high = interval
    lift = twin.top_tenth or 0.0
    largest_lift = min(10.0, drives / failures)
    no_worse = [
        name
        for name, figures in baselines.items()
        if figures.auc is not None and figures.auc >= twin.auc
    ]
    reason = (
        f"on drives that it has not seen its AUC is {twin.auc:.2f} ({low:.2f} to {high:.2f}), and"
        f" the tenth of the roads that it ranks first fails {lift:.1f} times as often as all"
        f" ({largest_lift:.1f} is possible)"
    )
    if no_worse:
        verb = "ranks" if len(no_worse) == 1 else "rank"
        reason += f"; {' and '.join(no_worse)} {verb} no worse"
    reason += _outcomes_note(twin.twin_failures, failures)
    is_near_best = lift >= NEAR_BEST_LIFT * largest_lift
    if low >= GOOD_AUC and (lift >= GOOD_LIFT or is_near_best) and not no_worse:
        return "good", reason
    # A fair twin may rank no better than before its fit, but better than curvature alone.
    if low > FAIR_AUC and set(no_worse) <= {UNFITTED} and (lift >= FAIR_LIFT or is_near_best):
        return "fair", reason
    return "poor", reason


def _outcomes_note(twin_failures: int | None, failures: int) -> str:
    """Return a clause about a twin that fails much more or less often; empty if it does not."""
    if twin_failures is None:
        return ""
    ratio = (twin_failures + 0.5) / (failures + 0.5)  # half a failure more: 0 needs no case
    if 1.0 / OUTCOMES_RATIO <= ratio <= OUTCOMES_RATIO:
        return ""
    return (
        f"; it fails on {counted(twin_failures, 'road')}, the record on {failures}: trust its"
        " order, not its outcomes"
    )


def answer(profile: TwinProfile) -> str:
    """Return whether a calibrated twin is good enough to start from, and which bounds decide."""
    assert profile.validation is not None
    decided = ", ".join(parameter.name for parameter in profile.fitted if parameter.at_bound)
    widen = f"; the bounds decide {decided}: widen them, and calibrate again" if decided else ""
    return f"{VERDICTS[profile.validation.verdict]}: {profile.validation.reason}{widen}"
