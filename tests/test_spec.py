from __future__ import annotations

import json
import math
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from specs import plain, positive, specs, texts

from frenetic.campaign import Campaign
from frenetic.description import describe
from frenetic.drivers import LimitedView, Noisy, Planner
from frenetic.drivers.loading import load_driver
from frenetic.errors import CampaignError, FreneticError, UnknownNameError
from frenetic.road import MAP_SIZE, MARGIN
from frenetic.search import RandomSearch
from frenetic.simulators import CarBody, EmbeddedSimulator, Rules
from frenetic.spec import Budget, Part, Spec, fault_of

SOURCE = "c/campaign.sqlite"

values = st.recursive(
    plain,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=3),
    max_leaves=6,
)
recorded_specs = specs(
    values,
    made=st.fixed_dictionaries(
        {"class": texts}, optional={"options": st.dictionaries(texts, values, max_size=2)}
    ),
    rules=st.builds(
        Rules, speed_limit=positive, oob_tolerance=st.floats(0.01, 1.0), stuck_time=positive
    ),
    wall_limit=positive,
    cluster=st.none() | texts.filter(bool),
    car=st.builds(CarBody, length=positive, width=positive),
    versions=st.dictionaries(texts, texts, max_size=3),
)


def unnamed(spec: Spec) -> Spec:
    """The same from Python: objects without names, of which no command line speaks."""
    return replace(
        spec,
        strategy=Part(made=spec.strategy.made),
        driver=Part(made=spec.driver.made),
        simulator=Part(made=spec.simulator.made),
        layers={},
        wall_limit=None,
    )


@given(recorded_specs, st.booleans())
def test_a_record_gives_the_spec_that_was_recorded(spec: Spec, is_named: bool) -> None:
    spec = spec if is_named else unnamed(spec)
    config = json.loads(json.dumps(spec.to_json()))
    assert ("run" in config) is is_named
    assert fault_of(config) == ""
    assert Spec.from_json(config, source=SOURCE) == spec


def test_what_is_usual_is_what_the_parts_have() -> None:
    spec = Spec()
    assert (spec.map_size, spec.margin, spec.rules) == (MAP_SIZE, MARGIN, Rules())
    campaign = Campaign(
        strategy=RandomSearch(seed=1),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(simulations=1),
    )
    assert campaign.tester.lane_width == spec.lane_width


# Objects


def test_it_makes_what_it_says(tmp_path: Path) -> None:
    spec = Spec(
        strategy=Part("random"),
        driver=Part("planner", {"aggression": 1.2}),
        layers={"view": 20.0, "noise": 0.1},
        simulator=Part("embedded", {"friction": 0.7}),
        rules=Rules(speed_limit=50.0),
        seed=7,
        lookahead=3,
        budget=Budget(simulations=5),
    )
    campaign = Campaign.of(spec, folder=tmp_path / "c", workers=2)
    driver = campaign.tester.driver
    assert isinstance(driver, Noisy)
    assert isinstance(driver.driver, LimitedView)
    assert campaign.seed == 7
    assert campaign.tester.simulator.rules.speed_limit == 50.0
    made = campaign.spec()
    assert made.driver.made == describe(driver)
    assert (made.lookahead, made.workers) == (3, 2)
    assert Spec.from_json(made.to_json(), source=SOURCE) == made
    assert campaign.configuration() == made.to_json()


def test_what_cannot_be_made_is_refused() -> None:
    spec = Spec(strategy=Part("random", {"seed": 5}))
    with pytest.raises(FreneticError, match="the option seed of the strategy is not allowed"):
        spec.make_strategy()
    with pytest.raises(UnknownNameError, match="unknown quantity 'smoke'"):
        load_driver("planner", smoke=1.0)


# Something replaced


RECORDED = Spec(
    strategy=Part("random", {}, {"class": "a:R"}),
    driver=Part("planner", {"aggression": 1.2}, {"class": "a:D"}),
    layers={"delay": 0.1, "view": 30.0},
    simulator=Part("embedded", {"friction": 0.7}, {"class": "a:S"}),
    rules=Rules(speed_limit=50.0, stuck_time=5.0),
    wall_limit=90.0,
)


BARE = Part("planner", {"aggression": 1.2})  # of which nothing is made


@pytest.mark.parametrize(
    ("options", "changes"),
    [
        ({"driver": None, "driver_options": (), "layers": (), "wall_limit": None}, {}),
        (
            {"driver": "stanley", "driver_options": (("gain", 2),)},
            {"driver": Part("stanley", {"gain": 2})},
        ),
        ({"driver_options": {"b": 1}}, {"driver": Part("planner", {"aggression": 1.2, "b": 1})}),
        (
            {"layers": {"delay": 0.0, "noise": 0.2, "view": math.inf}},
            {"layers": {"noise": 0.2}, "driver": BARE},
        ),
        ({"layers": {"view": 10.0}}, {"layers": {"delay": 0.1, "view": 10.0}, "driver": BARE}),
        (
            {"speed_limit": 60.0},
            {"rules": Rules(speed_limit=60.0, stuck_time=5.0, road_limits="ignored")},
        ),
        (
            {"layers": {"speed": 60.0}},
            {"rules": RECORDED.rules.with_speed(60.0)},
        ),
    ],
)
def test_what_is_given_takes_the_place_of_what_was_recorded(
    options: dict[str, Any], changes: dict[str, Any]
) -> None:
    assert RECORDED.replaced(options) == replace(RECORDED, **changes)


def test_the_limit_of_another_simulator_says_nothing_about_this_one() -> None:
    assert RECORDED.replaced({"simulator_options": {"friction": 0.6}}).wall_limit == 90.0
    assert RECORDED.replaced({"simulator": "beamng"}).with_limit().wall_limit == 600.0
    assert RECORDED.replaced({"simulator": "beamng", "wall_limit": 5.0}).wall_limit == 5.0
    with pytest.raises(FreneticError, match="oob_tolerance is 2"):
        RECORDED.replaced({"oob_tolerance": 2.0})


# Damage


def recorded() -> dict[str, Any]:
    spec = replace(RECORDED, budget=Budget(simulations=5), car=CarBody(), seed=1)
    config: dict[str, Any] = json.loads(json.dumps(spec.to_json()))
    return config


MISSING = object()


@pytest.mark.parametrize(
    ("place", "value", "fault"),
    [
        ("map_size", 1e999, "Expected `float` <= "),
        ("margin", -2.0, "Expected `float` >= 0.0 - at `$.margin`"),
        ("lookahead", 0, "Expected `int` >= 1 - at `$.lookahead`"),
        ("workers", 1.5, "Expected `int`, got `float` - at `$.workers`"),
        ("car", MISSING, "missing required field `car`"),
        ("car.length", -1.0, "length is -1.0: a positive number is needed - at `$.car`"),
        ("rules.oob_tolerance", 2.0, "a share above 0 and up to 1 is needed - at `$.rules`"),
        ("run.simulator", MISSING, "missing required field `simulator` - at `$.run`"),
        ("run.simulator", "embedded,friction", "'friction' is not OPTION=VALUE"),
        ("run.with.delay", "long", "got `str` - at `$.run.with[...]`"),
        ("run.wall_limit", -1.0, "Expected `float` > 0.0 - at `$.run.wall_limit`"),
        ("driver.class", MISSING, "missing required field `class` - at `$.driver`"),
        ("strategy", [], "Expected `object`, got `array` - at `$.strategy`"),
        ("start_from", [{}], "missing required field `folder` - at `$.start_from[0]`"),
        ("budget", {}, "the budget limits nothing: "),
        ("budget.simulations", -1, "simulations is -1: a whole number of at least 1 is needed"),
        ("versions.numpy", 2, "Expected `str`, got `int` - at `$.versions[...]`"),
    ],
)
def test_a_wrong_value_in_a_record_is_one_line_with_its_place(
    place: str, value: Any, fault: str
) -> None:
    config = recorded()
    *path, name = place.split(".")
    inner = config
    for step in path:
        inner = inner[step]
    inner[name] = value
    if value is MISSING:
        del inner[name]
    with pytest.raises(CampaignError) as caught:
        Spec.from_json(config, source=SOURCE)
    message = str(caught.value)
    assert message.startswith(f"{SOURCE} is damaged: it does not say with what it was driven: ")
    assert message.endswith("; restore it from a copy")
    assert fault in message
    assert fault in fault_of(config)
    assert "\n" not in message


@given(st.dictionaries(st.sampled_from([*recorded(), "run"]), values))
def test_decoding_never_raises_anything_else(damage: dict[str, Any]) -> None:
    with suppress(CampaignError):
        Spec.from_json(recorded() | damage, source=SOURCE)
