"""Durations and rates: reading and formatting."""

from __future__ import annotations

import pytest

from frenetic._support.words import format_duration, parse_duration, rate_words


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("90", 90),
        ("90s", 90),
        ("10m", 600),
        ("1h30m", 5400),
        ("2h", 7200),
        ("1.5m", 90),
        ("1H 1M 1S", 3661),
        ("0.5", 0.5),
    ],
)
def test_a_duration_is_read_in_seconds(text: str, seconds: float) -> None:
    assert parse_duration(text) == seconds


@pytest.mark.parametrize("text", ["", "abc", "5x", "-3", "0", "0m", "1m1h", "1h30", "nan", "inf"])
def test_a_text_that_is_no_duration_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="time"):
        parse_duration(text)


def test_a_duration_is_written_as_a_clock() -> None:
    assert [format_duration(s) for s in (0, 7.4, 754, 3723)] == ["0:00", "0:07", "12:34", "1:02:03"]


def test_a_rate_is_written_per_second_minute_or_hour() -> None:
    rates = (0.0, 0.0012, 0.2, 4.3, 19.84, 412.3)
    texts = ["0 tests/s", "4.3 tests/h", "12.0 tests/min", "4.3 tests/s", "19.8 tests/s"]
    assert [rate_words(rate) for rate in rates] == [*texts, "412 tests/s"]
