"""`Observation.lane`, in drives of the embedded simulator."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from frenetic import Controls, Driver, DriveSetup, EmbeddedSimulator, Observation, Road
from frenetic.drivers import Lane, LimitedView, Noisy, Stanley
from frenetic.errors import FreneticError

FloatArray = npt.NDArray[np.float64]
WINDING = Road([0.0, 0.01, 0.03, 0.0, -0.04, -0.02, 0.0, 0.03, 0.0], pose=(40.0, 60.0, 0.7))


class Recorder:
    """Stanley, which records its observations."""

    def __init__(self) -> None:
        self.stanley = Stanley()
        self.observations: list[Observation] = []

    def reset(self, setup: DriveSetup) -> None:
        self.stanley.reset(setup)
        self.observations = []

    def act(self, observation: Observation) -> Controls:
        self.observations.append(observation)
        return self.stanley.act(observation)


def observations_on(
    road: Road, wrapper: Callable[[Driver], Driver] = lambda driver: driver
) -> list[Observation]:
    driver = Recorder()
    simulator = EmbeddedSimulator(start_offset=0.4, start_heading=-0.1)
    assert simulator.drive(road, wrapper(driver)).trouble is None
    assert len(driver.observations) > 100
    return driver.observations[::20]


def on_the_map(lane: Lane, road: Road, observation: Observation) -> FloatArray:
    """Return the points of a lane on the map, from the car's place on the road."""
    pose = road.pose_at(observation.distance)
    heading = pose.heading + observation.heading_error
    left = observation.lateral_offset - 0.5 * road.lane_width
    x, y = pose.x - left * math.sin(pose.heading), pose.y + left * math.cos(pose.heading)
    c, s = math.cos(heading), math.sin(heading)
    moved: FloatArray = lane.points @ np.array([[c, s], [-s, c]]) + (x, y)
    return moved


def centre_of_lane(road: Road, distances: FloatArray) -> FloatArray:
    """Return points on the centre of the ego lane, at distances along the road."""
    half = 0.5 * road.lane_width
    poses = [road.pose_at(s) for s in distances]
    return np.array(
        [(p.x + half * math.sin(p.heading), p.y - half * math.cos(p.heading)) for p in poses]
    )


def test_a_lane_equals_the_view_ahead_at_its_spacing() -> None:
    for observation in observations_on(WINDING):
        lane = observation.lane(spacing=2.0, ahead=78.0)
        np.testing.assert_allclose(lane.points, observation.ahead, rtol=0.0, atol=2e-3)
        np.testing.assert_allclose(
            lane.curvatures, observation.curvature_ahead, rtol=0.0, atol=1e-9
        )
        np.testing.assert_array_equal(lane.distances, np.arange(0.0, 80.0, 2.0))


def test_a_lane_has_a_point_each_metre_for_100_m_by_default() -> None:
    lane = observations_on(WINDING)[0].lane()
    np.testing.assert_allclose(lane.distances, np.arange(101.0))
    assert len(lane.points) == 101


@pytest.mark.parametrize(("spacing", "ahead", "behind"), [(0.5, 200.0, 30.0), (0.1, 0.3, 0.7)])
def test_a_lane_lies_on_the_road_at_any_spacing_and_beyond_the_ends(
    spacing: float, ahead: float, behind: float
) -> None:
    for observation in observations_on(WINDING):
        lane = observation.lane(spacing, ahead, behind)
        assert lane.distances[0] == pytest.approx(-behind)
        assert lane.distances[-1] == pytest.approx(ahead)
        assert lane.distances[round(behind / spacing)] == 0.0
        np.testing.assert_allclose(np.diff(lane.distances), spacing, rtol=0.0, atol=1e-9)
        places = observation.distance + lane.distances
        expected = centre_of_lane(WINDING, places)
        np.testing.assert_allclose(
            on_the_map(lane, WINDING, observation), expected, rtol=0.0, atol=1e-6
        )
        beyond = (places < 0.0) | (places > WINDING.length)
        assert not lane.curvatures[beyond].any()


def test_headings_and_curvatures_follow_from_the_points() -> None:
    for observation in observations_on(WINDING):
        lane = observation.lane(0.01, 60.0, 20.0)
        abreast = np.flatnonzero(lane.distances == 0.0)[0]
        assert lane.headings[abreast] == pytest.approx(-observation.heading_error)
        steps = np.diff(lane.points, axis=0)
        lengths = np.hypot(*steps.T)
        between = 0.5 * (lane.headings[1:] + lane.headings[:-1])
        np.testing.assert_allclose(
            np.unwrap(np.arctan2(*steps.T[::-1])), between, rtol=0.0, atol=1e-6
        )
        turns = np.diff(lane.headings) / lengths
        curvatures = 0.5 * (lane.curvatures[1:] + lane.curvatures[:-1])
        np.testing.assert_allclose(turns, curvatures, rtol=0.0, atol=1e-4)


def test_noise_moves_lane_and_view_alike() -> None:
    plain = observations_on(WINDING)
    for observation in observations_on(
        WINDING, lambda driver: Noisy(driver, offset=0.5, heading=0.05)
    ):
        lane = observation.lane(2.0, 78.0)
        # The view is moved across the car, the lane across the road.
        np.testing.assert_allclose(lane.points, observation.ahead, rtol=0.0, atol=0.25)
        np.testing.assert_allclose(lane.points[:, 1], observation.ahead[:, 1], rtol=0.0, atol=0.05)
        expected = centre_of_lane(WINDING, observation.distance + lane.distances)
        c, s = math.cos(observation.heading), math.sin(observation.heading)
        believed = lane.points @ np.array([[c, s], [-s, c]]) + (observation.x, observation.y)
        np.testing.assert_allclose(believed, expected, rtol=0.0, atol=1e-6)
        right = replace(observation, lateral_offset=observation.lateral_offset - 1.0).lane(
            2.0, 78.0
        )
        np.testing.assert_allclose(
            np.hypot(*(right.points - lane.points).T), 1.0, rtol=0.0, atol=1e-9
        )
    assert abs(plain[0].lane().points[0, 1] + 0.4) < 0.01  # the car starts left of the centre


@pytest.mark.parametrize(("distance", "end"), [(25.0, 25.0), (200.0, 200.0), (0.5, 2.0)])
def test_a_limited_view_ends_the_lane(distance: float, end: float) -> None:
    for observation in observations_on(
        WINDING, lambda driver: LimitedView(driver, distance=distance)
    ):
        lane = observation.lane(1.0, ahead=math.inf, behind=10.0)
        assert (lane.distances[0], lane.distances[-1]) == (-10.0, end)
        assert observation.lane(1.0, ahead=1.0).distances[-1] == 1.0
        assert len(observation.ahead) <= 40


def test_an_old_observation_keeps_its_lane() -> None:
    first, *others = observations_on(WINDING)
    before = first.lane().points.copy()
    for other in others:
        other.lane()
    np.testing.assert_array_equal(first.lane().points, before)
    with pytest.raises(ValueError, match="read-only"):
        first.lane().points[0] = 0.0


@pytest.mark.parametrize(
    ("lengths", "message"),
    [
        ((0.0, 10.0, 0.0), "spacing above 0"),
        ((1.0, -1.0, 0.0), "at least 0"),
        ((1.0, 1.0, math.nan), "at least 0"),
        ((1.0, math.inf, 0.0), "at most 100000 points"),
        ((1e-9, 1.0, 0.0), "at most 100000 points"),
    ],
)
def test_bad_lengths_are_refused(lengths: tuple[float, float, float], message: str) -> None:
    observation = observations_on(WINDING)[0]
    with pytest.raises(ValueError, match=message):
        observation.lane(*lengths)


def test_an_observation_without_a_road_refuses_a_lane() -> None:
    observation = Observation(0.0, 10.0, 0.0, 0.0, 0.0, 0.0, np.zeros((1, 2)), np.zeros(1))
    with pytest.raises(FreneticError, match="no lane is known"):
        observation.lane()
