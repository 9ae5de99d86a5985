"""Reading JSON and TOML from outside: limits and errors."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec import Struct

from frenetic._support.option_text import read_part, read_setting
from frenetic._support.outside_text import (
    MAX_DEPTH,
    BeyondLimitsError,
    read_json,
    read_toml,
)

DEEP = 100_000  # levels


class Entry(Struct):
    number: float
    others: object = None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * DEEP + "]" * DEEP, "nested more than 100 levels deep"),
        ("[" * DEEP, "nested more than 100 levels deep"),
        ('{"a":' * DEEP + "1" + "}" * DEEP, "nested more than 100 levels deep"),
        ("(" * 10_000, "line 1 column 1"),
        ("1" * 5_000, "thousands of digits"),
        ("\x00", "line 1 column 1"),
        ("", "line 1 column 1"),
        (b"\xff\xfe[\x00", "no UTF-8 text: invalid start byte at byte 0"),
    ],
)
def test_unusable_json_is_a_one_line_error(text: str | bytes, message: str) -> None:
    with pytest.raises(ValueError, match=message) as refused:
        read_json(text)
    assert len(str(refused.value).splitlines()) == 1
    with pytest.raises(ValueError, match=r"."):
        read_json(text, Entry)


def test_values_of_an_untyped_field_are_checked_too() -> None:
    nested = "[" * 200 + "]" * 200
    with pytest.raises(BeyondLimitsError, match="nested"):
        read_json(f'{{"number": 1, "others": {nested}}}', Entry)
    assert read_json('\ufeff{"number": 1}'.encode(), Entry).number == 1.0


@pytest.mark.parametrize(
    "text",
    [
        "a = " + "[" * DEEP,
        "a." * DEEP + "a = 1",
        "[" + "a." * DEEP + "a]",
        '"a" . ' * DEEP + "a = 1",
        "a = {b = " * DEEP,
        f"a = {'1' * 5_000}",
        "a = \x00",
    ],
)
def test_unusable_toml_is_a_one_line_error(text: str) -> None:
    with pytest.raises(ValueError, match=r".") as refused:
        read_toml(text.encode())
    assert len(str(refused.value).splitlines()) == 1


def test_toml_within_the_limits_is_read() -> None:
    text = f"about = '{'A word. ' * 500}'\nlist = [{'0.5, ' * 500}]\n"
    assert len(read_toml(b"\xef\xbb\xbf" + text.encode())["list"]) == 500


@given(st.recursive(st.none() | st.booleans() | st.integers(0, 9), st.lists, max_leaves=20))
def test_json_within_the_limits_is_read(value: object) -> None:
    assert read_json(json.dumps(value)) == value


@pytest.mark.parametrize("core", ["", "1", '{"a": 1}'])
def test_the_deepest_allowed_level_is_read_and_one_more_is_refused(core: str) -> None:
    levels = MAX_DEPTH - core.count("{")
    text = "[" * levels + core + "]" * levels
    read_json(text)
    with pytest.raises(BeyondLimitsError):
        read_json(f"[{text}]")


@pytest.mark.parametrize("value", ["[" * DEEP, '{"a":' * DEEP, "1" * 400, "1" * 5_000])
def test_an_option_beyond_the_limits_is_refused_with_a_short_text(value: str) -> None:
    with pytest.raises(
        ValueError, match=r"\.\.\.: (it is nested|a number|int too large)"
    ) as refused:
        read_setting(value)
    assert len(str(refused.value)) < 100
    with pytest.raises(ValueError, match=r"."):
        read_part(f"planner,aggression={value}")
    assert read_part("(" * 10_000) == ("(" * 10_000, {})
