from __future__ import annotations

from typing import Any

import pytest

from frenetic._support.words import part_word, read_part


@pytest.mark.parametrize(
    ("text", "value"),
    [("true", True), ("True", True), ("False", False), ("None", None), ("null", None)],
)
def test_truth_is_written_as_in_json_or_as_in_python(text: str, value: bool | None) -> None:
    assert read_part(f"my.py:Mine,clock={text},sight=20") == (
        "my.py:Mine",
        {"clock": value, "sight": 20},
    )


@pytest.mark.parametrize("value", ["True", "None", "true", "yes", "a,b", '"', 1.5, True, None])
def test_options_come_back_as_they_were(value: Any) -> None:
    _, options = read_part(part_word("planner", {"option": value}))
    assert options == {"option": value}
    assert type(options["option"]) is type(value)
