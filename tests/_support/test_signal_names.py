"""Names and units of signals that come from other tools."""

from __future__ import annotations

import math

import pytest

from frenetic._support.signal_links import SignalLink, known_unit, units_in
from frenetic._support.signal_names import recognised, unit_in_name
from frenetic._support.units import unit_named, unit_spellings

NAMES = {"speed": ("v", "vx"), "lateral_offset": ("ey", "lateraldeviation")}


@pytest.mark.parametrize(
    ("name", "signal"),
    [
        ("speed", "speed"),
        ("vehicle_speed", "speed"),
        ("EgoSpeed", "speed"),
        ("speed_kmh", "speed"),
        ("Bus.Lateral deviation", "lateral_offset"),
        ("lka/LateralDeviation", "lateral_offset"),
        ("lateralOffset", "lateral_offset"),
        ("e_y", "lateral_offset"),
        ("controller.e_y[1]", "lateral_offset"),
        ("in_v", "speed"),
        ("speed_limit", None),
        ("", None),
        ("[1]", None),
    ],
)
def test_a_signal_is_recognised_by_its_usual_names(name: str, signal: str | None) -> None:
    assert recognised(name, NAMES) == signal


@pytest.mark.parametrize(
    ("name", "factor"),
    [
        ("km/h", 1 / 3.6),
        ("kmh", 1 / 3.6),
        ("m/s", 1.0),
        ("m.s^-1", 1.0),
        ("deg", math.radians(1.0)),
        ("°", math.radians(1.0)),
        ("degrees", math.radians(1.0)),
        ("°/s", math.radians(1.0)),
        ("rad/s", 1.0),
        ("m/s²", 1.0),
        ("m/s^2", 1.0),
        ("1/m", 1.0),
        ("m-1", 1.0),
        ("%", 0.01),
        ("-", 1.0),
        ("MM", 1e-3),
    ],
)
def test_units_have_their_factor(name: str, factor: float) -> None:
    unit = unit_named(name)
    assert unit is not None
    assert unit.factor == pytest.approx(factor)


def test_other_units_are_not_known() -> None:
    assert unit_named("furlong") is None
    assert unit_named("kg") is None


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("speed_kmh", "km/h"),
        ("speed_km_h", "km/h"),
        ("delta_deg", "deg"),
        ("kappa_per_m", "1/m"),
        ("kappa_per_km", "1/km"),
        ("ax_m_per_s_per_s", "m/s2"),
        ("speed", None),
        ("deg", None),
        ("e_1", None),
    ],
)
def test_a_name_may_end_with_its_unit(name: str, unit: str | None) -> None:
    text = unit_in_name(name)
    if unit is None:
        assert text is None
    else:
        assert text is not None
        assert unit_named(text) == unit_named(unit)


@pytest.mark.parametrize("spelling", [name for name in unit_spellings() if name.isalpha()])
def test_a_name_may_end_with_any_unit_of_letters(spelling: str) -> None:
    assert unit_in_name(f"speed_{spelling}") == spelling
    assert recognised(f"speed_{spelling}", NAMES) == "speed"


def test_a_wrong_unit_in_a_name_is_named() -> None:
    with pytest.raises(ValueError, match="speed_ms has the unit 'ms', which is none of speed"):
        units_in(SignalLink(signal="speed"), "speed_ms", None, None, known_unit("m/s"))
