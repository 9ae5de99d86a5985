"""The kernels' own functions, against the mathematics library."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from frenetic._support import trigonometry as own

ANGLES = np.concatenate(
    [
        np.random.default_rng(0).uniform(-math.pi, math.pi, 20_000),
        np.arange(-8, 9) * (math.pi / 8.0),
        [0.0, 1e-300, -1e-300, 1e-9, -1e-9],
    ]
)
NUMBERS = np.concatenate(
    [
        np.random.default_rng(1).uniform(-3.0, 3.0, 20_000),
        np.random.default_rng(2).uniform(-1e6, 1e6, 1_000),
        [0.0, 1e-300, 1e300, -1e300, math.inf, -math.inf, math.sqrt(2.0) - 1.0, math.sqrt(2.0) + 1],
    ]
)


@pytest.mark.parametrize(
    ("function", "reference", "values"),
    [
        (own.sine_within_turn, math.sin, ANGLES),
        (own.cosine_within_turn, math.cos, ANGLES),
        (own.sine, math.sin, 40.0 * ANGLES),
        (own.cosine, math.cos, 40.0 * ANGLES),
        (own.arctangent, math.atan, NUMBERS),
    ],
)
def test_functions_agree_with_the_library_to_5e_16(
    function: Callable[[float], float], reference: Callable[[float], float], values: np.ndarray
) -> None:
    errors = [abs(function(value) - reference(value)) for value in values.tolist()]
    assert max(errors) < 5e-16


def test_sine_and_arctangent_are_odd_and_cosine_is_even() -> None:
    for angle in ANGLES.tolist():
        assert own.sine(-angle) == -own.sine(angle)
        assert own.cosine(-angle) == own.cosine(angle)
        assert own.arctangent(-angle) == -own.arctangent(angle)
    assert [own.sine(0.0), own.cosine(0.0), own.arctangent(0.0)] == [0.0, 1.0, 0.0]


def test_wrapped_removes_whole_turns() -> None:
    for angle in ANGLES.tolist():
        for turns in (-3, 0, 5):
            rest = own.wrapped(angle + turns * 2.0 * math.pi)
            assert abs(rest) <= math.pi + 5e-15
            assert math.sin(rest) == pytest.approx(math.sin(angle), abs=1e-14)
            assert math.cos(rest) == pytest.approx(math.cos(angle), abs=1e-14)


def test_the_hypotenuse_is_the_length_of_the_vector() -> None:
    assert own.hypotenuse(3.0, -4.0) == 5.0
    assert own.hypotenuse(0.0, 0.0) == 0.0
