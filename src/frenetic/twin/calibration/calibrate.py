"""Calibration: fits a twin to recorded drives, cross-validates it, and says what it is worth.

Each fold's twin is fitted from the model as it was, without the drives of the runs that it is
judged on, so the figures are those of the whole procedure. The twin in the profile is fitted on all
drives afterwards, from the best one of the folds.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from threadpoolctl import threadpool_limits

from frenetic._support.arrays import FloatArray
from frenetic._support.json_value import plain
from frenetic.analysis.statistics import ranks
from frenetic.drive import Rules
from frenetic.errors import FreneticError
from frenetic.oracle import assess
from frenetic.spec import Part, Spec, describe
from frenetic.twin.calibration.determination import Interval, intervals, moved_alone
from frenetic.twin.calibration.driving import (
    COLUMNS,
    MOOBD,
    SHARE,
    IntArray,
    TwinDriver,
    why_broken,
)
from frenetic.twin.calibration.fitting import Evaluator, Journal, Stopped, best, fit
from frenetic.twin.calibration.loss import Logistic, Loss, check_weights, scores
from frenetic.twin.calibration.parameters import Model
from frenetic.twin.calibration.recordings import RecordedDrive, Recordings, on_grid
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
from frenetic.twin.profile import Figures, Fit, Fitted, Link, Profile, Recording, Validation

FOLDS: Final = 5
SAMPLE: Final = 300
"""Most drives of a fit."""
PER_PARAMETER: Final = 50
LEAST_EVALUATIONS: Final = 100
LEAST_DRIVES: Final = 10

CURVATURE: Final = "largest curvature"
FEATURES: Final = "curvature features, fitted"


@dataclass(frozen=True, kw_only=True)
class Settings:
    """The settings of a calibration."""

    seed: int = 0
    evaluations: int | None = None
    """Number of candidates of each fit; by default 50 for each parameter, 100 at least."""
    folds: int = FOLDS
    """Most folds; at least 2."""
    sample: int = SAMPLE
    """Most drives of a fit, at most half of them failures if there are enough others."""
    weights: Mapping[str, float] | None = None
    """Name of a term of the loss -> its weight, in place of the usual one."""
    shapes: bool = False
    """Whether only the shapes of speeds are compared, as where a record's clock is not the
    simulation's."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibrated twin with all that was found out about it."""

    recordings: Recordings
    model: Model
    settings: Settings
    profile: Profile
    parameters: tuple[Interval, ...]
    fold: IntArray
    """(drives,) number of the fold in which each drive was held out."""
    folds: tuple[Mapping[str, float], ...]
    """Name -> value of the parameters that each fold found."""
    rows: FloatArray
    """(drives, COLUMNS) of the twins that have not seen them."""
    ranking: FloatArray
    """(drives,) the twins' scores of roads that they have not seen: each the rank of its road among
    all recorded ones, as the twin of its fold scores them. The folds' own scores are not
    comparable: one twin may leave its lane on every road by more than another."""
    rankings: Mapping[str, FloatArray]
    """Name of a baseline -> its scores of the held-out roads, (drives,)."""
    auc_interval: tuple[float, float] | None
    """95 % interval of the twin's AUC."""
    terms: Mapping[str, float]
    """Name of a term of the loss -> its value on the held-out drives."""
    losses: tuple[float, ...]
    """Losses of the final fit's candidates, in the order of driving."""

    @property
    def validation(self) -> Validation:
        """The cross-validated figures."""
        assert self.profile.validation is not None
        return self.profile.validation

    @property
    def answer(self) -> str:
        """Whether the twin is good enough to screen with, and why, and which bounds decide."""
        decided = ", ".join(str(one.parameter) for one in self.parameters if one.at_bound)
        widen = f"; the bounds decide {decided}: widen them, and calibrate again" if decided else ""
        return f"{VERDICTS[self.validation.verdict]}: {self.validation.reason}{widen}"

    def held_out_drive(self, i: int) -> tuple[FloatArray, FloatArray]:
        """Offsets and speeds on the grid of the twin that has not seen drive ``i``."""
        recorded = self.recordings.drives[i]
        values = self.folds[int(self.fold[i])]
        driver, simulator = self.model.make(values, recorded.rules)
        drive = simulator.drive(recorded.road, driver)
        seen = assess(recorded.road, drive)
        n = len(seen.distance)
        return on_grid(seen.distance, seen.lateral_offset, drive.trajectory.speed[:n])

    def by_run(self) -> dict[str, Figures]:
        """Name of a run -> figures of its drives, each held out."""
        found = {}
        for run in self.recordings.runs:
            chosen = [i for i, drive in enumerate(self.recordings.drives) if drive.run == run]
            drives = [self.recordings.drives[i] for i in chosen]
            found[run] = figures_of(scores(self.rows[chosen]), drives, self.rows[chosen])
        return found


def calibrate(
    recordings: Recordings,
    model: Model,
    settings: Settings | None = None,
    *,
    name: str = "twin",
    workers: int = 1,
    drive_limit: float | None = None,
    state: Path | str | None = None,
    on_progress: Callable[[int, int], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
    version: str = "",
) -> Calibration | None:
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
        state: a file that keeps what was driven, so that the same call goes on; it is removed at
            the end, and where going on is of no use, since the driver breaks.
        on_progress: called with the number of candidates driven, and of all.
        should_stop: asked before each batch of candidates.
        version: of frenetic, for the profile.

    Returns:
        None if it was stopped.

    Raises:
        FreneticError: there are too few drives, or nothing to fit to; or the driver breaks whatever
            its parameters; or the state cannot be written.
        ValueError: a setting is out of range.
    """
    settings = settings or Settings()
    drives = recordings.drives
    p = len(model.parameters)
    evaluations = settings.evaluations or max(LEAST_EVALUATIONS, PER_PARAMETER * p)
    for what, value, least in (
        ("evaluations", evaluations, 1),
        ("folds", settings.folds, 2),
        ("sample", settings.sample, LEAST_DRIVES),
    ):
        if value < least:
            raise ValueError(f"{what} is {value}: at least {least} is needed")
    check_weights(settings.weights or {})
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
        if on_progress is not None:
            on_progress(done, total)

    def loss_on(indices: IntArray) -> Loss:
        return Loss(drives, indices, settings.weights, shapes=settings.shapes)

    loss_on(everything)  # refuses drives that say nothing, before any is driven
    digest = _digest(recordings, model, settings, evaluations, version)
    twins = TwinDriver(
        model, drives, shapes=settings.shapes, workers=workers, drive_limit=drive_limit
    )
    rows = np.empty((len(drives), COLUMNS))
    ranking = np.empty(len(drives))
    rankings = {
        UNFITTED: np.empty(len(drives)),
        CURVATURE: np.array([np.abs(drive.road.curvatures).max() for drive in drives]),
        FEATURES: np.empty(len(drives)),
    }
    features = np.stack([road_features(drive.road) for drive in drives])
    severity = severities(drives)
    try:
        with Journal(state, digest) as journal, twins, threadpool_limits(1):
            evaluator = Evaluator(model, twins, journal, notify, should_stop or (lambda: False))
            start = np.array([one.place(one.start) for one in model.parameters])

            def refuse_broken(rows: FloatArray, places: FloatArray, driven: IntArray) -> None:
                """Refuses a twin that broke on a drive."""
                broken = np.flatnonzero(np.isnan(rows[:, SHARE]))
                if len(broken):
                    journal.remove()  # another driver has other results
                    values = model.values(list(places))
                    first = drives[driven[broken[0]]]
                    raise _broken(model, values, first, (len(broken), len(driven)), drive_limit)

            # One that hangs on its first road does not hang on all of them.
            first = evaluator.rows("first", start, everything[:1])
            refuse_broken(first, start, everything[:1])
            unfitted = evaluator.rows("unfitted", start, everything)
            refuse_broken(unfitted, start, everything)
            rankings[UNFITTED] = scores(unfitted)
            places = []
            for k in range(count):
                held_out = np.flatnonzero(fold == k)
                train = np.flatnonzero(fold != k)
                weights = linear_model(features[train], severity[train])
                rankings[FEATURES][held_out] = features[held_out] @ weights
                chosen = _sampled(train, drives, settings.sample, settings.seed + k)
                key = f"fold {k}"
                found = best(
                    fit(
                        evaluator,
                        key,
                        chosen,
                        loss_on(chosen),
                        seed=settings.seed + k,
                        evaluations=evaluations,
                    )
                )
                places.append(found.places)
                driven = evaluator.rows(f"{key} driven", found.places, everything)
                refuse_broken(driven, found.places, everything)
                rows[held_out] = driven[held_out]
                ranking[held_out] = ranks(scores(driven))[held_out]
            chosen = _sampled(everything, drives, settings.sample, settings.seed + count)
            loss = loss_on(chosen)
            others = evaluator.evaluate("folds", np.stack(places), chosen, loss)
            candidates = fit(
                evaluator,
                "final",
                chosen,
                loss,
                seed=settings.seed + count,
                evaluations=evaluations,
                start=best(others).places,
            )
            final = best([*candidates, *others])
            alone = evaluator.evaluate("alone", moved_alone(final.places), chosen, loss)
            final = best([final, *alone])
            notify(total)
            journal.remove()
    except Stopped:
        return None
    labels = cluster_labels([drives[i] for i in chosen])
    found_intervals = intervals(model.parameters, final, candidates, others, alone, labels)
    baselines = {k: figures_of(v, drives) for k, v in rankings.items()}
    twin = figures_of(ranking, drives, rows)
    interval = auc_interval(ranking, drives, seed=settings.seed)
    verdict, reason = verdict_of(twin, interval, baselines)
    failed = np.array([drive.failed for drive in drives], dtype=np.float64)
    link = None
    if 0.0 < failed.mean() < 1.0:
        logistic = Logistic.fitted(-rows[:, MOOBD], failed)
        link = Link(intercept=logistic.intercept, slope=logistic.slope)
    profile = _profile(
        recordings,
        model,
        name,
        found_intervals,
        Validation(
            by="run" if by_run else "road",
            folds=count,
            twin=twin,
            baselines=baselines,
            link=link,
            verdict=verdict,
            reason=reason,
        ),
        Fit(
            seed=settings.seed,
            evaluations=evaluations,
            sample=len(chosen),
            weights=loss.weights,
            loss=final.loss,
        ),
        version,
    )
    return Calibration(
        recordings,
        model,
        settings,
        profile,
        tuple(found_intervals),
        fold,
        tuple(model.values(list(one)) for one in places),
        rows,
        ranking,
        rankings,
        interval,
        _mean_terms(loss_on, fold, rows),
        tuple(one.loss for one in candidates),
    )


def folds_of(drives: tuple[RecordedDrive, ...], folds: int, *, by_run: bool, seed: int) -> IntArray:
    """(drives,) number of the fold of each drive; drives of one run, or road, share it.

    Folds hold about as many drives each.
    """
    names = [drive.run if by_run else drive.road.curvatures.tobytes().hex() for drive in drives]
    sizes: dict[str, int] = {}
    for name in names:
        sizes[name] = sizes.get(name, 0) + 1
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


def _sampled(
    indices: IntArray, drives: tuple[RecordedDrive, ...], most: int, seed: int
) -> IntArray:
    """At most so many of the drives, by chance, in order; up to half of them failures."""
    if len(indices) <= most:
        return indices
    generator = np.random.default_rng(seed)
    failed = np.array([drives[i].failed for i in indices])
    failing = generator.permutation(indices[failed])
    passing = generator.permutation(indices[~failed])
    wanted = min(len(failing), max(most // 2, most - len(passing)))
    return np.sort(np.concatenate((failing[:wanted], passing[: most - wanted])))


def _mean_terms(
    loss_on: Callable[[IntArray], Loss], fold: IntArray, rows: FloatArray
) -> dict[str, float]:
    """Name of a term of the loss -> its mean over the folds that have it, by their drives."""
    found: dict[str, list[FloatArray]] = {}
    for k in np.unique(fold):
        held_out = np.flatnonzero(fold == k)
        try:
            loss = loss_on(held_out)
        except FreneticError:  # nothing can be compared there
            continue
        for name, values in loss.terms(rows[held_out]).items():
            found.setdefault(name, []).append(values)
    return {name: float(np.concatenate(values).mean()) for name, values in found.items()}


def _broken(
    model: Model,
    values: Mapping[str, float],
    first: RecordedDrive,
    number: tuple[int, int],
    drive_limit: float | None,
) -> FreneticError:
    """The error of a twin that broke on so many of so many drives."""
    told = ", ".join(f"{name} {value:.4g}" for name, value in values.items())
    broken, driven = number
    return FreneticError(
        f"the driver {model.driver!r} with {told} broke on {broken} of {driven} recorded roads"
        f" that it drove, first on that of {first.name}:"
        f" {why_broken(model, values, first, drive_limit)}"
    )


def _digest(
    recordings: Recordings, model: Model, settings: Settings, evaluations: int, version: str
) -> str:
    """A digest of all that the candidates and their drives depend on."""
    driver, simulator = model.make({}, _rules(recordings))
    content = {
        "recordings": list(recordings.digests.values()),  # drives are known by their order
        "terms": asdict(recordings.terms),
        "model": asdict(model),
        "parts": [describe(driver), describe(simulator)],
        "settings": asdict(settings),
        "evaluations": evaluations,
        "version": version,
    }
    text = json.dumps(content, sort_keys=True, default=plain)
    return hashlib.sha256(text.encode()).hexdigest()


def _rules(recordings: Recordings) -> Rules:
    return recordings.drives[0].rules


def _profile(
    recordings: Recordings,
    model: Model,
    name: str,
    found: list[Interval],
    validation: Validation,
    settings: Fit,
    version: str,
) -> Profile:
    values = {str(one.parameter): one.value for one in found}
    options, vehicle, layers = model.options(values)
    driver, simulator = model.make(values, _rules(recordings))
    parts: Any = {"driver": describe(driver), "simulator": describe(simulator)}
    terms: Any = recordings.terms  # all known by now
    spec = Spec(
        driver=Part(model.driver, options),
        layers=layers,
        simulator=Part("embedded", {"vehicle": vehicle} if vehicle else {}),
        rules=Rules(speed_limit=terms.speed_limit, oob_tolerance=terms.oob_tolerance),
        map_size=terms.map_size,
        lane_width=terms.lane_width,
    )
    return Profile.of(
        name,
        spec,
        parts=parts,
        fitted=[
            Fitted(
                name=str(one.parameter),
                value=one.value,
                low=one.parameter.low,
                high=one.parameter.high,
                from_=one.low,
                to=one.high,
                is_determined=one.is_determined,
            )
            for one in found
        ],
        recordings=[
            Recording(
                name=place,
                sha256=digest,
                drives=len(own),
                failures=sum(drive.failed for drive in own),
                runs=len({drive.run for drive in own}),
            )
            for place, digest in recordings.digests.items()
            for own in [[drive for drive in recordings.drives if drive.recording == place]]
        ],
        validation=validation,
        fit=settings,
        written_by=version,
    )
