"""Texts that name the parts of a campaign."""

from __future__ import annotations

from typing import Any

import pytest

from frenetic.drivers import Delayed, LimitedView, Planner
from frenetic.search import RandomSearch
from frenetic.simulators import EmbeddedSimulator
from frenetic.spec.part_record import describe
from frenetic.spec.part_text import part_text, recorded_part

DRY, SLIPPERY = (describe(EmbeddedSimulator(friction=value)) for value in (1.0, 0.8))
NETWORK = {"class": "frenetic.plugins.vision.neural:Network"}
MANY = {
    "class": "m:Part",
    "options": {"a": 1, "b": 2, "c": {"d": 3, "e": 4, "f": 5, "g": 6, "h": 7}},
}


def network(model: str) -> dict[str, Any]:
    """Return the record of a network with noise."""
    return {"class": "Noisy", "driver": {**NETWORK, "options": {"model": model}}}


@pytest.mark.parametrize(
    ("part", "recorded", "text"),
    [
        (
            describe(LimitedView(Delayed(Planner(), seconds=0.05), distance=20.0)),
            None,
            "planner, limitedview (distance 20), delayed (seconds 0.05)",
        ),
        (describe(Planner()), None, "planner"),
        (SLIPPERY, DRY, "embedded,friction=0.8"),
        (DRY, DRY, "embedded"),
        (SLIPPERY, {"class": "m:Other"}, "embedded,friction=0.8"),
        (DRY, SLIPPERY, "embedded,friction=1.0"),
        (
            describe(Delayed(Planner(aggression=0.8), seconds=0.1)),
            describe(Planner()),
            "planner,aggression=0.8, delayed (seconds 0.1)",
        ),
        (describe(RandomSearch(seed=1)), None, "random"),
        ({"class": "mine:RandomSearch"}, None, "RandomSearch"),
        (network("calm.onnx"), {**NETWORK, "options": {"model": "bold.onnx"}}, "calm.onnx, noisy"),
        (network("nets/calm.onnx"), NETWORK, "calm.onnx, noisy"),
        (network("C:\\nets\\calm.onnx"), NETWORK, "calm.onnx, noisy"),
        (MANY, {"class": "m:Part"}, "Part,a=1,b=2,d=3,e=4,f=5,g=6,…"),
        (describe(Planner(aggression=1.2)), None, "planner,aggression=1.2"),
    ],
)
def test_a_part_has_its_name_and_the_options_that_differ(
    part: object, recorded: object, text: str
) -> None:
    assert part_text(part, recorded) == text


@pytest.mark.parametrize("part", [None, 3, {}, {"class": None}, {"driver": {"driver": 3}}])
def test_a_value_that_is_no_record_is_unknown(part: object) -> None:
    assert part_text(part).startswith(("unknown", "None"))
    assert part_text(part, part).startswith(("unknown", "None"))


def test_a_campaigns_part_has_the_text_of_its_command_line() -> None:
    config = {"driver": describe(Planner(aggression=1.2)), "spec": {"driver": "mine.py:Bold,a=1"}}
    assert recorded_part(config, "driver") == "mine.py:Bold,a=1"
    assert recorded_part({**config, "spec": None}, "driver") == "planner,aggression=1.2"
    assert recorded_part({}, "driver") == "unknown"
