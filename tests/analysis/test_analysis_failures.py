"""Distinct failures, their descriptions, and near misses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sample_campaigns import search
from sample_drives import departing

from frenetic.analysis import (
    Clusters,
    Failure,
    cluster_failures,
    linkage,
    nearest_misses,
    segments_of,
)
from frenetic.analysis import clusters as module
from frenetic.analysis.clusters import Cluster, distinct_failures, representative_failures
from frenetic.analysis.failures import describe
from frenetic.campaign import Campaign, CampaignStore
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Result, Side
from frenetic.road import Pose, Road
from frenetic.search import RandomSearch
from frenetic.segments.causes import Cause, Kind
from frenetic.spec import Spec
from frenetic.testing.dummies import DummyDriver, DummySimulator

PLACE = 70.0  # [m], of the departures
STRAIGHT = [0.0] * 13
LEFT = [0.0] * 5 + [0.05, 0.05, 0.05] + [0.0] * 5  # a left-hand bend around 60 m
RIGHT = [-kappa for kappa in LEFT]


def failure(
    curvatures: npt.ArrayLike,
    side: Side = "right",
    *,
    id: int = 1,  # noqa: A002
    moobd: float = -2.0,
    speeds: tuple[float, float] = (15.0, 10.0),
    swing: float = 0.0,
    pose: Pose | None = None,
) -> Failure:
    road = Road(curvatures) if pose is None else Road(curvatures, pose=pose)
    segment = departing(road, PLACE, side, speeds=speeds, swing=swing)
    result = Result(Outcome.FAIL, "Car drove out of the lane", moobd)
    judged = Failure.of_judged(result, segment, id)
    assert judged is not None
    return judged


def family(curvatures: Sequence[float], side: Side, first: int, number: int = 8) -> list[Failure]:
    """Return failures on one shape of road, with jitter in road, speed and path."""
    rng = np.random.default_rng(first)
    return [
        failure(
            np.array(curvatures) + rng.normal(0.0, 0.001, len(curvatures)),
            side,
            id=first + k,
            moobd=-2.0 - 0.01 * k,
            speeds=(15.0 + rng.normal(0.0, 0.3), 10.0 + rng.normal(0.0, 0.3)),
            swing=rng.normal(0.0, 0.1),
        )
        for k in range(number)
    ]


def three_families() -> list[Failure]:
    return family(STRAIGHT, "left", 1) + family(LEFT, "right", 101) + family(RIGHT, "left", 201)


def members(clusters: Clusters) -> set[tuple[int, ...]]:
    return {cluster.ids for cluster in clusters}


def difference(first: Failure, second: Failure) -> float:
    return float(np.linalg.norm(first.vector() - second.vector()))


# Differences


def test_difference_of_speeds_and_offsets_worked_out_by_hand() -> None:
    base = failure(STRAIGHT)
    assert difference(base, base) == 0.0
    faster = replace(base, speeds=base.speeds + 1.5)
    assert difference(base, faster) == pytest.approx(1.5)  # m/s for a second
    beside = replace(base, offsets=base.offsets - 0.8)
    assert difference(base, beside) == pytest.approx(0.8)
    assert difference(faster, beside) == pytest.approx(math.hypot(1.5, 0.8))


def test_difference_of_roads_is_the_distance_of_their_points() -> None:
    base, bend = failure(STRAIGHT), failure([0.02] * 13)
    # s m ahead, the point on a circle of 50 m radius is 50 (sin(s/50), 1 - cos(s/50)), the point on
    # the straight (s, 0).
    s = np.arange(-30.0, 15.1, 2.5)
    away = np.hypot(50.0 * np.sin(s / 50.0) - s, 50.0 * (1.0 - np.cos(s / 50.0)))
    expected = math.sqrt((away**2).mean())
    bent = replace(bend, offsets=base.offsets, speeds=base.speeds)
    assert difference(base, bent) == pytest.approx(expected, abs=1e-6)


@settings(max_examples=30)
@given(st.floats(-300.0, 300.0), st.floats(-300.0, 300.0), st.floats(-math.pi, math.pi))
def test_moving_and_turning_a_road_makes_no_difference(x: float, y: float, heading: float) -> None:
    here, there = failure(LEFT), failure(LEFT, pose=Pose(x, y, heading))
    assert difference(here, there) == pytest.approx(0.0, abs=1e-6)


# Clusters


def test_three_clearly_different_shapes_with_jitter_are_three_clusters() -> None:
    clusters = cluster_failures(three_families())
    assert members(clusters) == {tuple(range(k, k + 8)) for k in (1, 101, 201)}
    assert clusters.failures == 24


@pytest.mark.parametrize("batch", [3000, 1])
def test_failures_of_one_cluster_differ_by_up_to_two_metres(
    batch: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(linkage, "BATCH", batch)
    base = failure(STRAIGHT)
    for metres, number in ((1.9, 1), (2.1, 2)):
        faster = replace(base, id=2, speeds=base.speeds + metres)
        assert len(cluster_failures([base, faster])) == number


def test_a_failure_without_departure_has_its_own_cluster() -> None:
    stuck = replace(failure(STRAIGHT, "left"), side=None, id=2)
    clusters = cluster_failures([failure(STRAIGHT, "left", id=1), stuck])
    assert len(clusters) == 2
    assert clusters.of(2).side is None
    assert clusters.of(2).description.startswith("fails in its lane")


def test_clusters_depend_neither_on_order_nor_on_doubles() -> None:
    failures = three_families() + family([0.04] * 13, "right", 301, 5)
    expected = cluster_failures(failures)
    rng = np.random.default_rng(0)
    for _ in range(5):
        shuffled = [failures[i] for i in rng.permutation(len(failures))]
        assert cluster_failures(shuffled) == expected
    doubles = [
        replace(failure, id=10 * failure.id + 1000 + k)
        for failure in failures[:9]
        for k in range(4)
    ]
    with_doubles = cluster_failures(failures + doubles)
    assert len(with_doubles) == len(expected)
    for failure in failures[:9]:
        for k in range(4):
            assert with_doubles.of(10 * failure.id + 1000 + k) is with_doubles.of(failure.id)


def test_clusters_do_not_depend_on_the_size_of_a_batch(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    failures = three_families()
    expected = members(cluster_failures(failures))
    for size in (1, 3, 5):
        monkeypatch.setattr(linkage, "BATCH", size)
        assert members(cluster_failures(failures)) == expected
        assert cluster_failures(failures[::-1]) == cluster_failures(failures)


@pytest.mark.parametrize("threshold", [0.0, -1.0, math.inf, math.nan])
def test_threshold_has_to_be_a_length(threshold: float) -> None:
    with pytest.raises(ValueError, match="a positive number of metres"):
        cluster_failures([], threshold=threshold)


def test_two_failures_with_the_same_id_are_refused() -> None:
    with pytest.raises(ValueError, match="failure 3 is there twice"):
        cluster_failures([failure(LEFT, id=3), failure(RIGHT, id=3)])
    clusters = cluster_failures([failure(LEFT, id=3)])
    assert clusters.of(3) == clusters[0]
    with pytest.raises(KeyError, match="no failure has the id 4"):
        clusters.of(4)


# Descriptions


def test_clusters_are_sorted_by_severity_and_name_their_worst_and_typical_failure() -> None:
    clusters = cluster_failures(
        [
            failure(LEFT, id=1, moobd=-1.0, speeds=(15.0, 10.0)),
            failure(LEFT, id=2, moobd=-1.6, speeds=(15.4, 10.4)),  # between failures 1 and 3
            failure(LEFT, id=3, moobd=-1.8, speeds=(16.0, 11.0)),
            failure(STRAIGHT, id=4, moobd=-2.5),
        ]
    )
    assert [cluster.most_severe for cluster in clusters] == [4, 3]
    assert [cluster.moobd for cluster in clusters] == [-2.5, -1.8]
    assert clusters[1].typical == 2
    assert clusters[1].ids == (1, 2, 3)
    # Differences from the mean in speed: sqrt(mean of 0.4667^2, 0.0667^2, 0.5333^2) m.
    assert clusters[1].spread == pytest.approx(
        math.sqrt((0.4667**2 + 0.0667**2 + 0.5333**2) / 3), rel=0.01
    )
    assert str(clusters[1]).endswith("km/h: 3 failures, at worst 1.80 m outside its lane")
    assert str(clusters[0]).endswith("km/h: 1 failure, at worst 2.50 m outside its lane")


def test_the_example_of_a_cause_has_that_cause(tmp_path: Path) -> None:
    spec = Spec(strategy="frenetic", seed=3, simulations=120)
    Campaign.of(spec, folder=tmp_path / "night", workers=1).run()
    with CampaignStore.open(tmp_path / "night") as store:
        clusters = distinct_failures(store)
        assert len(clusters) > 5
        for cluster in clusters:
            typical = Failure.of_test(store.test(cluster.typical))
            assert typical is not None
            assert typical.cause == cluster.cause


@pytest.mark.parametrize(
    ("left", "right", "text"),
    [
        (20, 0, "brakes too late into left-hand bends"),
        (19, 1, "brakes too late into bends, mostly left-hand"),
        (15, 5, "brakes too late into bends, mostly left-hand"),
        (14, 6, "brakes too late into bends"),
    ],
)
def test_a_cause_names_the_side_of_most_of_its_bends(left: int, right: int, text: str) -> None:
    numbers: dict[Side, int] = {"left": left, "right": right}
    clusters = tuple(
        Cluster(
            ids=tuple(range(number)),
            most_severe=0,
            typical=0,
            moobd=-2.0,
            side=None,
            spread=0.0,
            description="leaves",
            cause=Cause(Kind.BRAKES_LATE, side),
        )
        for side, number in numbers.items()
        if number
    )
    (cause,) = Clusters(clusters, module.THRESHOLD).causes
    assert cause.words == text


def test_an_unknown_id_has_no_cluster() -> None:
    with pytest.raises(KeyError, match="no failure has the id 5"):
        cluster_failures([failure(LEFT, id=3)]).of(5)


@pytest.mark.parametrize(
    ("curvatures", "side", "speeds", "phrase"),
    [
        # The place is at 70 m, the bend from 41 m to 79 m.
        (
            [0.0] * 5 + [0.05, 0.05, 0.05] + [0.0] * 5,
            "right",
            (11.0, 11.0),
            "leaves to the right at the end of a left-hand bend of 20 m radius, at 40 km/h",
        ),
        (
            [0.0] * 7 + [-0.04] * 6,
            "left",
            (11.0, 11.0),
            "leaves to the left entering a right-hand bend of 25 m radius after a straight,"
            " at 40 km/h",
        ),
        (
            [0.05] * 13,
            "left",
            (20.0, 10.0),
            "leaves to the left in a left-hand bend of 20 m radius, slowing from 51 to 36 km/h",
        ),
        (
            [0.0, 0.0, 0.0, 0.05, 0.05] + [0.0] * 8,
            "right",
            (10.0, 10.0),
            "leaves to the right on a straight, at 36 km/h",
        ),
        (
            [0.0, 0.0, 0.0, 0.0, 0.05, 0.05] + [0.0] * 7,
            "right",
            (10.0, 10.0),
            "leaves to the right 11 m past a left-hand bend of 20 m radius, at 36 km/h",
        ),
        (
            [0.0, 0.0, 0.0, 0.0, 0.0, 0.05, 0.05] + [0.0] * 6,
            "right",
            (10.0, 10.0),
            "leaves to the right 1 m past a left-hand bend of 20 m radius, at 36 km/h",
        ),
        (
            [0.0, 0.0, 0.0, 0.0, 0.05, 0.05, -0.05, -0.05, 0.0] + [0.0] * 4,
            "right",
            (10.0, 10.0),
            "leaves to the right at the end of a right-hand bend of 20 m radius"
            " after a left-hand bend, at 36 km/h",
        ),
        (
            [0.0] * 8 + [0.03] * 5,
            "right",
            (10.0, 10.0),
            "leaves to the right 2 m before a left-hand bend of 33 m radius after a straight,"
            " at 36 km/h",
        ),
    ],
)
def test_a_description_names_side_bend_and_speed(
    curvatures: list[float], side: Side, speeds: tuple[float, float], phrase: str
) -> None:
    assert describe(failure(curvatures, side, speeds=speeds)) == phrase


# Near misses


@pytest.fixture(scope="module")
def unfailing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign in which the car drifts more on some roads than on others, and never fails."""

    return search(
        tmp_path_factory.mktemp("unfailing") / "c",
        RandomSearch(seed=1),
        simulations=60,
        simulator=DummySimulator(lambda road: np.clip(60.0 * road.curvatures.mean(), -2.3, 2.3)),
        driver=DummyDriver(),
    )


def test_nearest_misses_are_distinct_passing_tests_of_lowest_moobd(
    unfailing: Path,
) -> None:
    with CampaignStore.open(unfailing) as store:
        near, all_misses = nearest_misses(store), nearest_misses(store, number=1000)
        passed = list(store.tests(Outcome.PASS, order_by="moobd"))
        assert store.counts().by_outcome[Outcome.FAIL] == 0
        assert len(near) == 5
        assert near[0].most_severe == passed[0].id
        assert list(near) == list(all_misses)[:5]
        assert all_misses.failures == len(passed)
        moobds = {test.id: test.moobd or 0.0 for test in passed}
        for cluster in near:
            assert (
                cluster.moobd
                == moobds[cluster.most_severe]
                == min(moobds[test] for test in cluster.ids)
            )
            # It is nearer than every test that resembles none of the five.
            unlike = set(moobds) - {test for cluster in near for test in cluster.ids}
            assert all(cluster.moobd <= moobds[test] for test in unlike)
        listed = representative_failures(store, clusters=near)
        assert [test.id for test in listed] == [cluster.most_severe for cluster in near]


def test_a_near_miss_is_described_by_its_nearest_edge(unfailing: Path) -> None:
    with CampaignStore.open(unfailing) as store:
        for cluster in nearest_misses(store, number=1000):
            _, segment = next(
                (test, segment)
                for test, segment in segments_of(store, Outcome.PASS)
                if test.id == cluster.most_severe
            )
            offset = segment.assessment.lateral_offset
            side = "left" if offset[int(np.abs(offset).argmax())] > 0.0 else "right"
            verb = "crosses" if cluster.moobd < 0.0 else "comes nearest to"
            assert cluster.side == side
            assert cluster.description.startswith(f"{verb} the {side} edge ")


def test_more_passing_tests_are_read_until_there_are_enough_distinct_near_misses(
    unfailing: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with CampaignStore.open(unfailing) as store:
        expected = nearest_misses(store)
        monkeypatch.setattr(module, "_PASSES_COMPARED", (3, 10_000))
        assert list(nearest_misses(store)) == list(expected)


def test_failures_join_a_cluster_by_their_mean_difference() -> None:
    base = failure(STRAIGHT)
    # The mean square difference between the third failure and the first two is 3.8 m2, then 9 m2.
    # The largest and the least difference would give the opposite clusters.
    for second, third, number in ((0.8, 2.3, 1), (1.9, 3.8, 2)):
        faster = [replace(base, id=i, speeds=base.speeds + v) for i, v in ((2, second), (3, third))]
        assert len(cluster_failures([base, *faster])) == number
