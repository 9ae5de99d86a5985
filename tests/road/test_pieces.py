"""Roads of straights, clothoids and arcs: lengths, turns and edges between samples."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from frenetic import Road
from frenetic.road.pieces import RoadPiece, sampled_curvatures, single_bend


@given(
    radius=st.floats(15.0, 500.0),
    lengths=st.tuples(*[st.integers(1, 60)] * 4),
    step=st.sampled_from([0.25, 0.5, 1.0]),
)
def test_a_bend_has_its_lengths_its_radius_and_its_turn(
    radius: float, lengths: tuple[int, int, int, int], step: float
) -> None:
    run_up, transition, arc, run_out = map(float, lengths)
    pieces = single_bend(
        -1.0 / radius, run_up=run_up, transition=transition, arc=arc, run_out=run_out
    )
    road = Road(sampled_curvatures(pieces, step), step)
    assert road.length == pytest.approx(run_up + 2.0 * transition + arc + run_out)
    assert road.curvatures.min() == pytest.approx(-1.0 / radius)
    assert road.curvatures.max() == 0.0
    turn = road.headings[-1] - road.headings[0]
    assert turn == pytest.approx(-(arc + transition) / radius)


def test_the_last_piece_goes_on_to_a_whole_step() -> None:
    pieces = [RoadPiece(10.0, 0.0, 0.0), RoadPiece(5.5, 0.0, 0.011)]
    curvatures = sampled_curvatures(pieces, 1.0)
    assert len(curvatures) == 17
    np.testing.assert_allclose(curvatures[10:], [0.0, 0.002, 0.004, 0.006, 0.008, 0.01, 0.011])
    assert len(sampled_curvatures([RoadPiece(0.3, 0.0, 0.0)], 0.1)) == 4  # in spite of rounding
    assert math.isclose(sampled_curvatures(pieces, 15.5)[-1], 0.011)
