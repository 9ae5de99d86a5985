"""Ten questions of an engineer about a campaign, each answered by one line on its tables."""

from __future__ import annotations

from collections import Counter, defaultdict
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from frenetic.analysis.clusters import Clusters, distinct_failures
from frenetic.campaign import Budget, Campaign, CampaignStore, RoadTester, Test
from frenetic.drivers import Planner
from frenetic.export import data_frame, trace_of_test, versions_frame
from frenetic.oracle.outcome import Outcome
from frenetic.rerun.back_to_back import BackToBack, back_to_back
from frenetic.rerun.disturbances import QualityPlan
from frenetic.search import Frenetic
from frenetic.segments.causes import as_text, cause_of
from frenetic.segments.segment import REACH
from frenetic.simulators import EmbeddedSimulator

pytestmark = pytest.mark.heavy


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("questions") / "searched"
    Campaign(
        strategy=Frenetic(seed=1),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(simulations=100),
        folder=folder,
    ).run()
    return folder


@pytest.fixture(scope="module")
def tests(folder: Path) -> pd.DataFrame:
    return data_frame(folder)


@pytest.fixture(scope="module")
def failures(tests: pd.DataFrame) -> pd.DataFrame:
    return tests[tests["outcome"] == "FAIL"]


@pytest.fixture(scope="module")
def records(folder: Path) -> list[Test]:
    """All tests of the campaign, with their trajectories, in the order of their results."""
    with CampaignStore.open(folder) as store:
        return list(store.tests(with_trajectory=True))


@pytest.fixture(scope="module")
def failed(records: list[Test]) -> list[Test]:
    return [test for test in records if test.outcome is Outcome.FAIL]


@pytest.fixture(scope="module")
def clusters(folder: Path) -> Clusters:
    with CampaignStore.open(folder) as store:
        return distinct_failures(store)


def cause_words(test: Test) -> str:
    """Return the cause of a failure in words, from its drive."""
    assert test.segment is not None
    return as_text(cause_of(test.segment).kind)


def place_of(test: Test) -> float:
    """Return where a car left its lane, in m along the road."""
    assert test.departure is not None
    return test.departure.distance


def test_which_causes(failures: pd.DataFrame, clusters: Clusters, failed: list[Test]) -> None:
    answer = failures.groupby("cause")["distinct_failure"].nunique()
    words = {test.id: cause_words(test) for test in failed}
    numbers = defaultdict(set)
    for number, cluster in enumerate(clusters):
        for i in cluster.ids:
            numbers[words[i]].add(number)
    assert answer.to_dict() == {cause: len(distinct) for cause, distinct in numbers.items()}


def test_how_often(failures: pd.DataFrame, failed: list[Test]) -> None:
    answer = failures["cause"].value_counts()
    assert answer.to_dict() == Counter(map(cause_words, failed))


def test_at_which_least_radius(failures: pd.DataFrame, failed: list[Test]) -> None:
    answer = failures.groupby("cause")["segment_least_radius"].min()
    radii = defaultdict(list)
    for test in failed:
        along = np.arange(max(place_of(test) - REACH, 0.0), place_of(test) + REACH, 0.01)
        along = along[along <= test.road.length]
        radii[cause_words(test)].append(1.0 / np.abs(test.road.curvature_at(along)).max())
    assert answer.to_dict() == pytest.approx({k: min(v) for k, v in radii.items()}, rel=1e-3)


def test_at_which_speed(failures: pd.DataFrame, failed: list[Test]) -> None:
    answer = failures.groupby("cause")["place_speed"].median()
    speeds = defaultdict(list)
    for test in failed:
        assert test.trajectory is not None
        assert test.departure is not None
        moment = np.searchsorted(test.trajectory.time, test.departure.time - 1e-6)
        speeds[cause_words(test)].append(test.trajectory.speed[moment])
    expected = {cause: np.median(values) for cause, values in speeds.items()}
    assert answer.to_dict() == pytest.approx(expected, abs=0.3)


def test_left_or_right(failures: pd.DataFrame, failed: list[Test]) -> None:
    answer = failures["departure_side"].value_counts()
    sides = [test.departure.side for test in failed if test.departure is not None]
    assert answer.to_dict() == {side: sides.count(side) for side in ("left", "right")}


def test_first_failure_after_how_many_drives(folder: Path, records: list[Test]) -> None:
    answer = data_frame(folder, "measures")["simulations_to_failure"].item()
    driven = [test.outcome for test in records if test.outcome.is_driven]
    assert answer == driven.index(Outcome.FAIL) + 1


def test_share_failing_by_a_feature(tests: pd.DataFrame, records: list[Test]) -> None:
    answer = (
        (tests["outcome"] == "FAIL")
        .groupby(pd.cut(tests["max_curvature"], [0.0, 0.06, 0.1]))
        .mean()
    )
    shares = []
    for low, high in ((0.0, 0.06), (0.06, 0.1)):
        inside = [t for t in records if low < abs(t.candidate.curvatures).max() <= high]
        shares.append(sum(t.outcome is Outcome.FAIL for t in inside) / len(inside))
    assert answer.tolist() == pytest.approx(shares)


@pytest.fixture(scope="module")
def comparison(folder: Path) -> BackToBack:
    new = Planner(lateral_acceleration=4.0)
    undisturbed = QualityPlan(disturbances=())
    return back_to_back(folder, EmbeddedSimulator(), Planner(), new, fresh=30, quality=undisturbed)


def test_what_changed_between_two_versions(comparison: BackToBack, failed: list[Test]) -> None:
    answer = versions_frame(comparison).query("roads == 'known'")["change"].value_counts()
    setting = failed[0].setting
    assert setting is not None
    tester = RoadTester(EmbeddedSimulator(), Planner(lateral_acceleration=4.0), setting)
    outcomes = Counter(tester.test(test.candidate).result.outcome for test in failed)
    changes = {"passes now": outcomes[Outcome.PASS], "fails again": outcomes[Outcome.FAIL]}
    assert answer[answer > 0].to_dict() == {name: n for name, n in changes.items() if n}


def test_which_roads_to_drive_again(
    failures: pd.DataFrame, failed: list[Test], clusters: Clusters
) -> None:
    answer = failures.sort_values(["length", "id"]).groupby("distinct_failure")["id"].first()
    lengths = {test.id: test.road.length for test in failed}
    shortest = [min(cluster.ids, key=lambda i: (lengths[i], i)) for cluster in clusters]
    assert answer.tolist() == shortest


def test_one_drives_signals(folder: Path, failed: list[Test]) -> None:
    test = failed[0]
    answer = data_frame(folder, "trajectories", tests=test.id).set_index("time")["lateral_jerk"]
    trace = trace_of_test(test)
    assert answer.index.to_numpy() == pytest.approx(trace.column("time"))
    assert answer.to_numpy() == pytest.approx(trace.column("lateral_jerk"), abs=1e-4, nan_ok=True)


def test_versions_have_both_drives_of_each_road(comparison: BackToBack) -> None:
    frame = versions_frame(comparison)
    pairs = [*comparison.fresh.pairs, *comparison.known.pairs]
    assert frame["old_outcome"].tolist() == [str(pair.old.outcome) for pair in pairs]
    assert frame["new_moobd"].tolist() == [pair.new.moobd for pair in pairs]
    counts: Counter[str] = Counter()
    for version in ("old", "new"):
        has_failed = frame[f"{version}_outcome"] == "FAIL"
        assert (frame[f"{version}_cause"].notna() == has_failed).all()
        counts.update(frame[f"{version}_cause"].dropna())
    assert counts == {cause: sum(both) for cause, both in comparison.causes.items()}
    assert frame.attrs["units"]["old_moobd"] == "m"
    assert frame.attrs["definitions"].keys() == {*frame}
