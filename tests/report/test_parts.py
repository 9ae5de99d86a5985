from __future__ import annotations

import pytest

from frenetic.drivers import Delayed, LimitedView, Planner
from frenetic.search import RandomSearch
from frenetic.simulators import EmbeddedSimulator
from frenetic.spec import describe, part_text


def test_the_driver_is_that_under_its_layers() -> None:
    driver = LimitedView(Delayed(Planner(), seconds=0.05), distance=20.0)
    text = "planner, limitedview (distance 20), delayed (seconds 0.05)"
    assert part_text(describe(driver)) == text
    assert part_text(describe(Planner())) == "planner"


def test_options_that_differ_are_named() -> None:
    usual, slippery = (describe(EmbeddedSimulator(friction=value)) for value in (1.0, 0.8))
    assert part_text(slippery, usual) == "embedded, friction 0.8"
    assert part_text(usual, usual) == "embedded"
    assert part_text(slippery, {"class": "m:Other"}) == "embedded"
    calm = Delayed(Planner(aggression=0.8), seconds=0.1)
    text = "planner, aggression 0.8, delayed (seconds 0.1)"
    assert part_text(describe(calm), describe(Planner())) == text


def test_parts_of_ours_have_the_names_of_the_command_line() -> None:
    assert part_text(describe(RandomSearch(seed=1))) == "random"
    assert part_text({"class": "mine:RandomSearch"}) == "RandomSearch"


@pytest.mark.parametrize("model", ["calm.onnx", "nets/calm.onnx", "C:\\nets\\calm.onnx"])
def test_a_network_has_the_name_of_its_file(model: str) -> None:
    network = {"class": "frenetic.vision.neural:Network", "options": {"model": model}}
    other = {**network, "options": {"model": "bold.onnx"}}
    assert part_text({"class": "Noisy", "driver": network}, other) == "calm.onnx, noisy"


def test_of_many_options_some_are_named() -> None:
    part = {"class": "m:Part", "options": {"a": 1, "b": 2, "c": {"d": 3, "e": 4}}}
    assert part_text(part, {"class": "m:Part"}) == "Part, a 1, b 2, d 3, …"


@pytest.mark.parametrize("part", [None, 3, {}, {"class": None}, {"driver": {"driver": 3}}])
def test_what_is_no_description_is_unknown(part: object) -> None:
    assert part_text(part).startswith(("unknown", "None"))
    assert part_text(part, part).startswith(("unknown", "None"))
