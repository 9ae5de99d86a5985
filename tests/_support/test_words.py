"""Texts of parts, options and lane distances."""

from __future__ import annotations

from typing import Any

import pytest

from frenetic._support.option_text import part_word, read_part
from frenetic._support.words import lane_words, oob_unit, oob_words


@pytest.mark.parametrize(
    ("text", "value"),
    [("true", True), ("True", True), ("False", False), ("None", None), ("null", None)],
)
def test_true_false_and_none_are_read_in_json_and_python_form(
    text: str, value: bool | None
) -> None:
    assert read_part(f"my.py:Mine,clock={text},sight=20") == (
        "my.py:Mine",
        {"clock": value, "sight": 20},
    )


@pytest.mark.parametrize("value", ["True", "None", "true", "yes", "a,b", '"', 1.5, True, None])
def test_options_are_written_and_read_unchanged(value: Any) -> None:
    _, options = read_part(part_word("planner", {"option": value}))
    assert options == {"option": value}
    assert type(options["option"]) is type(value)


@pytest.mark.parametrize(
    ("oob", "short", "text"),
    [
        (1.744, "1.74 of 1.75 m", "1.74 of 1.75 m inside its lane"),
        (0.0, "0.00 of 1.75 m", "0.00 of 1.75 m inside its lane"),
        (-0.52, "−0.52 m", "0.52 m outside its lane"),
    ],
)
def test_distances_inside_the_lane_have_their_maximum(oob: float, short: str, text: str) -> None:
    assert (oob_words(oob, 3.5), lane_words(oob, 3.5)) == (short, text)
    assert (oob_words(None, 3.5), oob_unit(3.5)) == ("–", "m, at most 1.75")
