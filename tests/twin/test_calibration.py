"""Calibration: known parameters are found, and what data leave open is said."""

from __future__ import annotations

import math
from multiprocessing import active_children
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from frenetic import Budget, Campaign, EmbeddedSimulator, RandomSearch, Stanley
from frenetic.analysis.statistics import ranks
from frenetic.drive import Rules
from frenetic.errors import FreneticError
from frenetic.oracle import assess
from frenetic.road import Road
from frenetic.spec import Spec
from frenetic.twin.calibration import (
    Calibration,
    Model,
    RecordedDrive,
    Recordings,
    Settings,
    calibrate,
    read_recordings,
)
from frenetic.twin.calibration.calibrate import CURVATURE, FEATURES, folds_of
from frenetic.twin.calibration.driving import (
    COLUMNS,
    COVERED,
    MOOBD,
    OFFSET,
    SHARE,
    SPEED,
    TwinDriver,
    drive_twin,
)
from frenetic.twin.calibration.fitting import difference
from frenetic.twin.calibration.loss import Loss, chances, scores, with_ties
from frenetic.twin.calibration.validation import (
    UNFITTED,
    auc_of,
    found_by,
    linear_model,
    verdict_of,
)
from frenetic.twin.profile import Figures, Profile

KNOWN = 7.3
QUICK = Settings(seed=1, evaluations=26, folds=2)
SHORT = Settings(evaluations=2, folds=2)
OWN = """
import time

class Raises:
    def __init__(self, gain=1.0):
        self.gain = gain

    def reset(self, setup):
        pass

    def act(self, observation):
        raise ValueError("no")

class Hangs(Raises):
    def act(self, observation):
        time.sleep(60)
"""


def recorded(folder: Path, seed: int, drives: int, known: float = KNOWN) -> Path:
    """A campaign of random roads with a driver of known parameters."""
    Campaign(
        strategy=RandomSearch(seed=seed),
        driver=Stanley(lateral_acceleration=known),
        simulator=EmbeddedSimulator(),
        budget=Budget(simulations=drives),
        folder=folder,
    ).run()
    return folder


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> Recordings:
    folder = tmp_path_factory.mktemp("recorded")
    return read_recordings([recorded(folder / f"run-{seed}", seed, 8) for seed in (101, 102)])


@pytest.fixture(scope="module")
def model() -> Model:
    return Model.of("stanley", ["lateral_acceleration", "vehicle.brake_deceleration=7:9"])


@pytest.fixture(scope="module")
def calibration(recordings: Recordings, model: Model) -> Calibration:
    return calibrate(recordings, model, QUICK)


# What is found


def test_a_known_parameter_is_found_and_an_idle_one_is_called_undetermined(
    calibration: Calibration,
) -> None:
    found, idle = calibration.profile.fitted
    assert found.value == pytest.approx(KNOWN, rel=0.02)
    assert found.from_ <= KNOWN <= found.to
    assert found.is_determined
    # No drive brakes so hard.
    assert not idle.is_determined
    assert (idle.from_, idle.to) == pytest.approx((7.0, 9.0))


def test_an_interval_that_ends_at_a_bound_is_a_warning_and_usual_bounds_are_wide(
    tmp_path: Path,
) -> None:
    slow = read_recordings([recorded(tmp_path / "slow", 101, 12, known=2.5)])
    narrow, usual = (
        calibrate(slow, Model.of("stanley", [f"lateral_acceleration{bounds}"]), QUICK)
        for bounds in ("=3:12", "")
    )
    (one,) = narrow.profile.fitted
    assert one.from_ == pytest.approx(3.0)
    assert (one.at_bound, one.is_determined) == (True, False)
    assert narrow.answer.endswith(
        "; the bounds decide driver.lateral_acceleration: widen them, and calibrate again"
    )
    (one,) = usual.profile.fitted
    assert one.value == pytest.approx(2.5, rel=0.03)
    assert one.is_determined
    assert "widen" not in usual.answer


def test_figures_are_those_of_drives_that_a_fold_has_not_seen(
    calibration: Calibration, recordings: Recordings, model: Model
) -> None:
    validation, drives = calibration.validation, recordings.drives
    assert (validation.by, validation.folds) == ("run", 2)
    held = {(d.run, int(k)) for k, d in zip(calibration.fold, drives, strict=True)}
    assert len(held) == len(recordings.runs) == 2
    for k, values in enumerate(calibration.folds):
        driver, simulator = model.make(values, drives[0].rules)
        held_out = calibration.fold == k
        rows = np.array([drive_twin(one, driver, simulator) for one in drives])
        np.testing.assert_array_equal(calibration.rows[held_out], rows[held_out])
        # Folds are compared by ranks, because their twins' scores differ in scale.
        assert (calibration.ranking[held_out] == ranks(scores(rows))[held_out]).all()
    seen = assess(drives[3].road, simulator.drive(drives[3].road, driver))
    assert rows[3, [SHARE, MOOBD]].tolist() == [seen.oob_share.max(), seen.oob_distance.min()]
    failed = np.array([drive.failed for drive in drives], dtype=np.float64)
    assert validation.twin.auc == auc_of(calibration.ranking, failed)
    assert validation.twin.offset_error is not None
    assert validation.twin.offset_error < 0.05
    assert set(validation.baselines) == {UNFITTED, CURVATURE, FEATURES}


def test_the_profile_drives_as_the_fitted_twin(calibration: Calibration, tmp_path: Path) -> None:
    calibration.profile.write(tmp_path / "twin.json")
    read = Profile.read(tmp_path / "twin.json")
    assert read == calibration.profile
    driver, simulator = read.spec().make_parts(isolate=False)
    values = [one.value for one in read.fitted]
    assert [driver.lateral_acceleration, simulator.vehicle.brake_deceleration] == values  # type: ignore[attr-defined]
    assert Spec.read(tmp_path / "twin.json").driver.name == "stanley"


def test_one_run_is_held_out_road_by_road_and_runs_of_a_road_stay_together(
    recordings: Recordings,
) -> None:
    one = tuple(d for d in recordings.drives if d.run == recordings.runs[0])
    fold = folds_of((*one, *one), 5, by_run=False, seed=3)
    assert (fold[: len(one)] == fold[len(one) :]).all()
    assert sorted(set(fold.tolist())) == [0, 1, 2, 3, 4]
    with pytest.raises(FreneticError, match="of one road"):
        folds_of((one[0], one[0]), 5, by_run=False, seed=3)


def test_the_number_of_workers_changes_nothing(recordings: Recordings, model: Model) -> None:
    one, two = (calibrate(recordings, model, SHORT, workers=n) for n in (1, 2))
    assert one.profile == two.profile
    assert one.rows.tobytes() == two.rows.tobytes()


def test_a_worker_that_dies_is_named(recordings: Recordings, model: Model) -> None:
    with TwinDriver(model, recordings.drives, workers=2) as twins:
        assert twins.rows(twins.start[None, :], np.arange(2)).shape == (1, 2, COLUMNS)
        for process in active_children():
            process.kill()
        with pytest.raises(FreneticError, match=r"worker \d was lost: it .*with 1 worker"):
            twins.rows(twins.start[None, :], np.arange(2))
    assert not active_children()


@pytest.mark.parametrize(("name", "why"), [("Raises", "no"), ("Hangs", "more than 0.5 s")])
def test_a_driver_that_raises_or_hangs_is_broken_soon(
    recordings: Recordings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, why: str
) -> None:
    (tmp_path / "mine.py").write_text(OWN, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    broken = Model.of(f"mine.py:{name}", ["gain"])
    with pytest.raises(FreneticError, match=rf"gain 1 broke on 1 of 1 .*{why}"):
        calibrate(recordings, broken, QUICK, drive_limit=0.5)


def test_too_few_drives_are_refused(recordings: Recordings, model: Model) -> None:
    few = Recordings(recordings.drives[:9], recordings.terms, recordings.places, 0)
    with pytest.raises(FreneticError, match="9 recorded drives: at least 10"):
        calibrate(few, model)


# The loss


def test_a_twin_is_ranked_by_moobd_where_it_stays_in_its_lane() -> None:
    recorded = np.array([0.0, 0.4, 0.0, 0.9])
    rows = np.zeros((4, COLUMNS))
    rows[:, MOOBD] = [1.5, 0.9, 1.2, 0.8]
    assert np.argsort(with_ties(scores(rows), recorded), kind="stable").tolist() == [0, 2, 1, 3]
    drives = drives_of(recorded.tolist(), [False, False, False, True])
    loss = Loss(drives, np.arange(4), {"offset": 0.0, "speed": 0.0})
    assert loss.terms(rows)["oob_share"] == pytest.approx(np.zeros(4))


def drives_of(shares: list[float], failed: list[bool]) -> list[RecordedDrive]:
    road = Road([0.0, 0.01, 0.0])
    return [
        RecordedDrive(
            "d", "r", "r", road, Rules(), fails, share,
            offset=np.array([0.1, 0.2 + share]), speed=np.array([1.0, 5.0 + share]),
        )
        for share, fails in zip(shares, failed, strict=True)
    ]  # fmt: skip


def rows_of(shares: list[float], *, covered: float, error: float) -> Any:
    rows = np.zeros((len(shares), COLUMNS))
    rows[:, SHARE], rows[:, MOOBD] = shares, 1.0 - 2.0 * np.array(shares)
    rows[:, COVERED] = covered
    rows[:, OFFSET] = rows[:, SPEED] = error
    return rows


def test_the_loss_is_0_for_the_record_itself_and_1_for_what_says_nothing() -> None:
    shares, failed = [0.0, 0.0, 0.3, 0.6, 0.97, 1.0], [False] * 4 + [True] * 2
    loss = Loss(drives_of(shares, failed), np.arange(6))
    assert set(loss.weights) == {"outcome", "oob_share", "offset", "speed"}
    same = loss.terms(rows_of(shares, covered=1.0, error=0.0))
    assert {name: values.mean() for name, values in same.items()} == pytest.approx(
        dict.fromkeys(loss.weights, 0.0), abs=0.05
    )
    nothing = loss.terms(rows_of([0.5] * 6, covered=0.0, error=math.nan))
    assert {name: values.mean() for name, values in nothing.items()} == pytest.approx(
        dict.fromkeys(loss.weights, 1.0)
    )
    broken = rows_of(shares, covered=1.0, error=0.0)
    broken[2, SHARE] = math.nan
    assert (loss.contributions(broken) == 10.0).all()


def test_weights_choose_the_terms() -> None:
    drives = drives_of([0.0, 0.5, 1.0], [False, False, True])
    loss = Loss(drives, np.arange(3), {"speed": 0.0, "offset": 3.0})
    assert loss.weights == {"outcome": 1.0, "oob_share": 1.0, "offset": 3.0}
    rows = rows_of([0.0, 0.5, 1.0], covered=1.0, error=0.2)
    expected = sum(loss.weights[k] * v.mean() for k, v in loss.terms(rows).items()) / 5.0
    assert loss.contributions(rows).mean() == pytest.approx(expected)
    with pytest.raises(FreneticError, match="nothing to fit to"):
        Loss(drives, np.arange(3), {"outcome": 0.0, "oob_share": 0.0, "offset": 0.0, "speed": 0.0})


def test_the_logistic_is_the_most_likely_one() -> None:
    from scipy.optimize import minimize

    score = np.array([0.0, 0.1, 0.2, 0.3, 0.5, 0.6, 0.8, 1.0])
    failed = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0])

    def likelihood(values: Any) -> float:
        p = 1.0 / (1.0 + np.exp(-(values[0] + values[1] * score)))
        return -float((failed * np.log(p) + (1.0 - failed) * np.log(1.0 - p)).sum())

    a, b = minimize(likelihood, [0.0, 1.0]).x
    best = 1.0 / (1.0 + np.exp(-(a + b * score)))
    assert chances(score, failed) == pytest.approx(best, abs=0.005)  # there is a slight ridge
    # More share outside is never taken for less chance of failing.
    assert chances(score, 1.0 - failed) == pytest.approx(np.full(8, 0.5))


# Figures


def test_figures_of_a_ranking_agree_with_counting() -> None:
    score = np.array([0.9, 0.5, 0.5, 0.5, 0.1, 0.8])
    failed = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    pairs = [(a > b) + 0.5 * (a == b) for a in score[:2] for b in score[2:]]
    assert auc_of(score, failed) == pytest.approx(np.mean(pairs))
    assert auc_of(score, np.ones(6)) is None
    roads, found = found_by(score, failed)
    assert roads == pytest.approx(np.arange(7) / 6)
    # One of the three equal ones fails: a third of a failure each.
    assert found == pytest.approx(np.array([0, 1, 1, 4 / 3, 5 / 3, 2, 2]) / 2)


def test_the_linear_baseline_finds_a_line() -> None:
    x = np.random.default_rng(1).normal(size=(200, 2))
    features = np.column_stack((x, np.ones(200)))
    assert linear_model(features, 3.0 * x[:, 0] + 1.0) == pytest.approx([3.0, 0.0, 1.0], abs=0.05)


def test_a_difference_has_the_error_of_its_independent_groups() -> None:
    d = np.array([1.0, 1.0, -1.0, -1.0])
    mean, error = difference(d, np.zeros(4), np.arange(4))
    assert (mean, error) == pytest.approx((0.0, math.sqrt(4 / 3) / 2))
    _, in_pairs = difference(d, np.zeros(4), np.array([0, 0, 1, 1]))
    assert in_pairs == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("failures", "auc", "low", "lift", "baseline", "verdict"),
    [
        (30, 0.8, 0.7, 3.0, 0.6, "good"),
        (30, 0.8, 0.7, 3.0, 0.8, "poor"),  # no better than a baseline
        (30, 0.8, 0.7, 1.5, 0.6, "fair"),
        (30, 0.7, 0.6, 3.0, 0.6, "fair"),
        (30, 0.6, 0.45, 3.0, 0.5, "poor"),
        (30, 0.8, 0.7, 1.0, 0.6, "poor"),
        (160, 0.8, 0.7, 1.2, 0.6, "good"),  # of 1.25 that are possible
        (9, 0.9, 0.8, 9.0, 0.6, "unknown"),
        (195, 0.9, 0.8, 1.0, 0.6, "unknown"),
    ],
)
def test_the_verdict(
    failures: int, auc: float, low: float, lift: float, baseline: float, verdict: str
) -> None:
    twin = Figures(drives=200, failures=failures, auc=auc, top_tenth=lift)
    other = Figures(drives=200, failures=failures, auc=baseline)
    found, reason = verdict_of(twin, (low, 0.95), {"length": other})
    assert found == verdict
    assert ("length ranks no worse" in reason) == (baseline >= auc)


def test_a_twin_no_better_than_before_its_fit_is_fair() -> None:
    twin = Figures(drives=200, failures=30, auc=0.8, top_tenth=3.0)
    found, reason = verdict_of(twin, (0.7, 0.9), {UNFITTED: twin})
    assert found == "fair"
    assert "the driver as it was ranks no worse" in reason
    found, reason = verdict_of(twin, (0.7, 0.9), {UNFITTED: twin, "length": twin})
    assert found == "poor"
    assert "the driver as it was and length rank no worse" in reason


def test_a_twin_that_fails_more_or_less_often_is_told() -> None:
    for ours, is_told in ((0, True), (29, False), (46, True)):
        twin = Figures(drives=200, failures=30, auc=0.8, top_tenth=3.0, twin_failures=ours)
        _, reason = verdict_of(twin, (0.7, 0.9), {})
        assert ("trust its order, not its outcomes" in reason) == is_told


# The model


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (["brakng"], r"no parameter 'brakng' to fit; did you mean 'braking'\? stanley has:"),
        (["braking", "driver.braking"], "driver.braking is to be fitted twice"),
        (["braking=4:1"], "bounds of driver.braking are 4:1: LOW:HIGH"),
        (["braking=1:x"], "bounds of driver.braking are 1:x: LOW:HIGH"),
        (["braking=1"], "bounds of driver.braking are 1: LOW:HIGH"),
        (["braking=-1:1"], "driver.braking cannot be -1: .*braking is -1"),
        (["friction=0.5:9"], "vehicle.friction cannot be 9: .*lifts an axle"),
        (["delay"], "layer.delay is 0, so it has no usual bounds"),
        ([], "nothing is to be fitted"),
    ],
)
def test_parameters_that_cannot_be_fitted(asked: list[str], message: str) -> None:
    with pytest.raises(FreneticError, match=message):
        Model.of("stanley", asked)


def test_usual_bounds_end_where_no_car_can_be_made() -> None:
    model = Model.of("planner", ["friction"])
    (friction,) = model.parameters
    assert friction.low == 0.25
    assert 1.0 < friction.high < 2.0
    _, simulator = model.make({"vehicle.friction": friction.high}, Rules())
    assert simulator.friction == friction.high
