"""Calibration: fits a twin to recorded drives, cross-validates it, and says what it is worth.

Each fold's twin is fitted from the model as it was, without the drives of the runs that it is
judged on, so the figures are those of the whole procedure. The twin in the profile is fitted on all
drives afterwards, from the best one of the folds.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from msgspec import structs
from threadpoolctl import threadpool_limits

from frenetic._support.arrays import FloatArray
from frenetic.analysis.statistics import ranks
from frenetic.errors import FreneticError
from frenetic.twin.calibration.driving import COLUMNS, IntArray, TwinDriver
from frenetic.twin.calibration.fitting import best, evaluate, fit, intervals, moved_alone
from frenetic.twin.calibration.loss import Loss, scores
from frenetic.twin.calibration.parameters import Model
from frenetic.twin.calibration.recordings import RecordedDrive, Recordings
from frenetic.twin.calibration.validation import (
    UNFITTED,
    VERDICTS,
    auc_interval,
    cluster_labels,
    figures_of,
    linear_model,
    road_features,
    severities,
    verdict_of,
)
from frenetic.twin.profile import Profile, Recording, Settings, Validation

PER_PARAMETER: Final = 50
LEAST_EVALUATIONS: Final = 100
LEAST_DRIVES: Final = 10

CURVATURE: Final = "largest curvature"
FEATURES: Final = "curvature features, fitted"


@dataclass(frozen=True, eq=False, kw_only=True)
class Calibration:
    """A calibrated twin with all that was found out about it."""

    profile: Profile
    validation: Validation
    fold: IntArray
    """(drives,) number of the fold in which each drive was held out."""
    folds: tuple[dict[str, float], ...]
    """Name -> value of the parameters that each fold found."""
    rows: FloatArray
    """(drives, COLUMNS) of the twins that have not seen them."""
    ranking: FloatArray
    """(drives,) the twins' scores of roads that they have not seen: each the rank of its road among
    all recorded ones, as the twin of its fold scores them. The folds' own scores are not
    comparable: one twin may leave its lane on every road by more than another."""

    @property
    def answer(self) -> str:
        """Whether the twin is good enough to start from, and why, and which bounds decide."""
        decided = ", ".join(one.name for one in self.profile.fitted if one.at_bound)
        widen = f"; the bounds decide {decided}: widen them, and calibrate again" if decided else ""
        return f"{VERDICTS[self.validation.verdict]}: {self.validation.reason}{widen}"


def calibrate(
    recordings: Recordings,
    model: Model,
    settings: Settings | None = None,
    *,
    name: str = "twin",
    workers: int = 1,
    drive_limit: float | None = None,
    on_progress: Callable[[int, int], None] = lambda *_: None,
) -> Calibration:
    """Fits and cross-validates a twin.

    Args:
        recordings: what it is to follow.
        model: driver and car, with the parameters to fit.
        settings: of the fit; they and the recordings decide the result, `workers` do not.
        name: of the profile.
        workers: number of processes. With more than one, a script needs
            ``if __name__ == "__main__":``.
        drive_limit: s after which a drive of a driver written in Python counts as hanging; by
            default half as long again as the simulator's ``wall_limit``, and 10 s.
        on_progress: called with the number of candidates driven, and of all.

    Raises:
        FreneticError: there are too few drives, or nothing to fit to; or the driver breaks whatever
            its parameters.
    """
    settings = settings or Settings()
    drives = recordings.drives
    p = len(model.parameters)
    evaluations = settings.evaluations or max(LEAST_EVALUATIONS, PER_PARAMETER * p)
    if len(drives) < LEAST_DRIVES:
        raise FreneticError(
            f"{len(drives)} recorded drives: at least {LEAST_DRIVES} are needed to calibrate on"
        )
    by_run = len(recordings.runs) > 1
    fold = folds_of(drives, settings.folds, by_run=by_run, seed=settings.seed)
    count = int(fold.max()) + 1
    everything = np.arange(len(drives))
    total = (count + 1) * evaluations + len(moved_alone(np.zeros(p))) + 2 * count + 2
    done = 0

    def notify(number: int) -> None:
        nonlocal done
        done = min(done + number, total)
        on_progress(done, total)

    def loss_on(indices: IntArray) -> Loss:
        return Loss(drives, indices, settings.weights)

    loss_on(everything)  # refuses drives that say nothing, before any is driven
    rows = np.empty((len(drives), COLUMNS))
    ranking = np.empty(len(drives))
    rankings = {
        UNFITTED: np.empty(len(drives)),
        CURVATURE: np.array([np.abs(drive.road.curvatures).max() for drive in drives]),
        FEATURES: np.empty(len(drives)),
    }
    features = np.stack([road_features(drive.road) for drive in drives])
    severity = severities(drives)
    places = []
    with (
        threadpool_limits(1),
        TwinDriver(
            model,
            drives,
            workers=workers,
            drive_limit=drive_limit,
            notify=notify,
        ) as twins,
    ):
        # One that hangs on its first road does not hang on all of them.
        twins.checked(twins.start, everything[:1])
        rankings[UNFITTED] = scores(twins.checked(twins.start, everything))
        for k in range(count):
            held_out, train = np.flatnonzero(fold == k), np.flatnonzero(fold != k)
            weights = linear_model(features[train], severity[train])
            rankings[FEATURES][held_out] = features[held_out] @ weights
            seed = settings.seed + k
            chosen = _sampled(train, drives, settings.sample, seed)
            loss = loss_on(chosen)
            found = best(fit(twins, chosen, loss, seed=seed, evaluations=evaluations))
            places.append(found.places)
            driven = twins.checked(found.places, everything)
            rows[held_out] = driven[held_out]
            ranking[held_out] = ranks(scores(driven))[held_out]
        seed = settings.seed + count
        chosen = _sampled(everything, drives, settings.sample, seed)
        loss = loss_on(chosen)
        others = evaluate(twins, np.stack(places), chosen, loss)
        near = best(others).places
        candidates = fit(twins, chosen, loss, seed=seed, evaluations=evaluations, start=near)
        final = best([*candidates, *others])
        alone = evaluate(twins, moved_alone(final.places), chosen, loss)
        final = best([final, *alone])
        notify(total)
    labels = cluster_labels([drives[i] for i in chosen])
    fitted = intervals(model.parameters, final, candidates, others, alone, labels)
    baselines = {k: figures_of(v, drives) for k, v in rankings.items()}
    twin = figures_of(ranking, drives, rows)
    interval = auc_interval(ranking, drives, seed=settings.seed)
    verdict, reason = verdict_of(twin, interval, baselines)
    validation = Validation(
        by="run" if by_run else "road",
        folds=count,
        twin=twin,
        baselines=baselines,
        verdict=verdict,
        reason=reason,
    )
    spec = model.spec({one.name: one.value for one in fitted}, drives[0].rules, recordings.terms)
    profile = Profile.of(
        name,
        spec,
        fitted=fitted,
        recordings=_of_profile(recordings),
        validation=validation,
        settings=structs.replace(settings, evaluations=evaluations, weights=loss.weights),
        loss=final.loss,
    )
    return Calibration(
        profile=profile,
        validation=validation,
        fold=fold,
        folds=tuple(model.values(one.tolist()) for one in places),
        rows=rows,
        ranking=ranking,
    )


def _of_profile(recordings: Recordings) -> list[Recording]:
    found = []
    for place in recordings.places:
        own = [drive for drive in recordings.drives if drive.recording == place]
        failures, runs = sum(drive.failed for drive in own), len({drive.run for drive in own})
        found.append(Recording(name=place, drives=len(own), failures=failures, runs=runs))
    return found


def folds_of(drives: Sequence[RecordedDrive], folds: int, *, by_run: bool, seed: int) -> IntArray:
    """(drives,) number of the fold of each drive; drives of one run, or road, share it.

    Folds hold about as many drives each.
    """
    names = [drive.run if by_run else drive.road.curvatures.tobytes().hex() for drive in drives]
    sizes = Counter(names)
    groups = list(sizes)
    np.random.default_rng(seed).shuffle(groups)
    count = min(folds, len(groups))
    if count < 2:
        raise FreneticError("all recorded drives are of one road: drives of others are needed")
    filled = [0] * count
    fold_of: dict[str, int] = {}
    for name in sorted(groups, key=lambda one: -sizes[one]):
        k = filled.index(min(filled))
        filled[k] += sizes[name]
        fold_of[name] = k
    return np.array([fold_of[name] for name in names], dtype=np.int64)


def _sampled(indices: IntArray, drives: Sequence[RecordedDrive], most: int, seed: int) -> IntArray:
    """At most so many of the drives, by chance, in order; up to half of them failures."""
    if len(indices) <= most:
        return indices
    generator = np.random.default_rng(seed)
    failed = np.array([drives[i].failed for i in indices])
    failing = generator.permutation(indices[failed])
    passing = generator.permutation(indices[~failed])
    wanted = min(len(failing), max(most // 2, most - len(passing)))
    return np.sort(np.concatenate((failing[:wanted], passing[: most - wanted])))
