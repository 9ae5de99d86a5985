"""All pictures turn a road by the same angle and have the same colours of a path."""

from __future__ import annotations

import math
import re
from importlib.resources import files

import numpy as np
import pytest

from frenetic.report.html.tests import road_data
from frenetic.report.orientation import turn_of, turned
from frenetic.report.scene import OOB_COLOURS
from frenetic.road import Pose, Road

S_BEND = (0.0, 0.03, 0.05, 0.02, -0.03, -0.05, -0.02, 0.0)


def edges_in_picture(road: Road) -> np.ndarray:
    """Return points of the road's edges, turned as in a picture."""
    line = np.vstack([road.sample(1.0, side * road.lane_width) for side in (1.0, -1.0)])
    return turned(line, turn_of(road))


@pytest.mark.parametrize("seed", range(5))
def test_a_road_lies_as_flat_as_it_can_and_is_driven_to_the_right(seed: int) -> None:
    rng = np.random.default_rng(seed)
    road = Road(rng.uniform(-0.04, 0.04, 20), 10.0)
    shown = edges_in_picture(road)
    height = np.ptp(shown[:, 1])
    for turn in np.radians(np.arange(0.0, 180.0, 7.0)):
        assert height <= np.ptp(turned(shown, float(turn))[:, 1]) + 0.2
    start, end = turned(road.sample(road.length), turn_of(road))[[0, -1]]
    assert start[0] <= end[0]


@pytest.mark.parametrize("angle", [0.3, 1.0, 2.5, -2.0])
def test_the_pose_of_a_road_does_not_change_its_picture(angle: float) -> None:
    shown = edges_in_picture(Road(S_BEND, 10.0))
    moved = edges_in_picture(Road(S_BEND, 10.0, pose=Pose(70.0, -20.0, angle)))
    # The angle is found in steps of a degree.
    ahead = [math.atan2(*(edges[-1] - edges[0])[::-1]) for edges in (shown, moved)]
    assert abs(ahead[0] - ahead[1]) < math.radians(1.01)


def test_page_and_pictures_turn_a_road_by_the_same_angle() -> None:
    road = Road(S_BEND, 10.0)
    assert road_data(road)["turn"] == pytest.approx(turn_of(road), abs=1e-3)


def test_page_and_pictures_have_one_colour_scale() -> None:
    style = files("frenetic.report.html").joinpath("static", "report.css").read_text("utf-8")
    colours = re.findall(r"--oob-(\d): light-dark\((#\w+), (#\w+)\)", style)
    assert [int(number) for number, _, _ in colours] == list(range(len(OOB_COLOURS)))
    assert [light for _, light, _ in colours] == list(OOB_COLOURS)
    assert len({dark for _, _, dark in colours}) == len(OOB_COLOURS)


def test_the_lane_edge_is_a_jump_of_the_colour_scale() -> None:
    rgb = np.array([[int(colour[i : i + 2], 16) for i in (1, 3, 5)] for colour in OOB_COLOURS])
    jumps = np.linalg.norm(np.diff(rgb, axis=0), axis=1)
    assert int(np.argmax(jumps)) == len(OOB_COLOURS) // 2 - 1
    luminance = rgb @ (0.2126, 0.7152, 0.0722)
    assert (np.diff(luminance) < 0.0).all()  # the scale can be read in grey
