"""Trajectories: their columns, and the lateral acceleration that follows from them."""

from __future__ import annotations

import numpy as np
import pytest

from frenetic.drivers import Planner
from frenetic.oracle.drive import Trajectory
from frenetic.road import Road
from frenetic.simulators import EmbeddedSimulator


def test_a_drive_in_a_circle_has_its_centripetal_acceleration() -> None:
    rows = np.zeros((40, len(Trajectory.names())))
    rows[:, 0] = np.arange(40) / 20.0
    path = Trajectory.from_rows(rows)
    speed, radius = 12.0, 30.0
    columns = {name: getattr(path, name) for name in Trajectory.names()}
    for sign in (1.0, -1.0):
        columns |= {"speed": np.full(40, speed), "yaw_rate": np.full(40, sign * speed / radius)}
        circle = Trajectory(**columns)
        assert circle.lateral_acceleration == pytest.approx(sign * speed**2 / radius)
    slides = Trajectory(**{**columns, "lateral_speed": 0.5 * rows[:, 0]})
    assert slides.lateral_acceleration == pytest.approx(0.5 - speed**2 / radius)


def test_the_acceleration_follows_from_the_positions() -> None:
    road = Road(np.array([0.0, 0.0, 0.0, 0.02, 0.03, 0.0, -0.03, -0.02, 0.0, 0.0]), 10.0)
    with EmbeddedSimulator() as simulator:
        path = simulator.drive(road, Planner()).trajectory
    ax, ay = (np.gradient(np.gradient(place, path.time), path.time) for place in (path.x, path.y))
    across = -ax * np.sin(path.heading) + ay * np.cos(path.heading)
    inner = slice(5, -5)
    assert np.ptp(path.lateral_acceleration) > 5.0
    assert path.lateral_acceleration[inner] == pytest.approx(across[inner], abs=0.4)


@pytest.mark.parametrize("records", [0, 1])
def test_a_drive_of_no_or_one_record_has_an_acceleration(records: int) -> None:
    path = Trajectory.from_rows(np.zeros((records, len(Trajectory.names()))))
    assert path.lateral_acceleration.shape == (records,)


def test_a_trajectory_has_the_same_columns_however_it_is_made() -> None:
    rows = np.random.default_rng(3).normal(size=(7, len(Trajectory.names())))
    of_rows = Trajectory.from_rows(rows)
    of_columns = Trajectory(*rows.T)
    rows_before = rows.copy()
    rows[:] = 0.0  # a trajectory holds copies
    for path in (of_rows, of_columns, Trajectory.of_block(rows_before.T.copy())):
        np.testing.assert_array_equal(path.to_rows(), rows_before)
        np.testing.assert_array_equal(path.block, rows_before.T)
        for name, column in zip(Trajectory.names(), rows_before.T, strict=True):
            np.testing.assert_array_equal(getattr(path, name), column)
            assert not getattr(path, name).flags.writeable
        assert not path.block.flags.writeable
        path.to_rows()[:] = 0.0  # a copy, too
        np.testing.assert_array_equal(path.x, rows_before[:, 1])
