"""A slow check is skipped while its inputs stay the same, and only then."""

from __future__ import annotations

from pathlib import Path

import pytest
from agreements import Agreements


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """The file of the digests, which does not exist yet."""
    return tmp_path / "digests.txt"


def is_agreed_upon(file: Path, *parts: str | bytes, anew: bool = False) -> bool:
    """Return whether a check of these parts passed before; with `anew`, record that it passes."""
    with Agreements(file, anew=anew).upon("a reader", *parts) as is_agreed:
        return is_agreed


def test_a_check_is_skipped_only_for_unchanged_inputs(file: Path) -> None:
    assert not is_agreed_upon(file, "ab", b"c")
    assert not file.exists(), "an ordinary run records nothing"
    assert not is_agreed_upon(file, "ab", b"c", anew=True)
    assert is_agreed_upon(file, b"ab", "c")
    assert not is_agreed_upon(file, "ab", anew=True), "a full run asks again"
    assert is_agreed_upon(file, "ab")
    for changed in ("abc", ""), ("a", "bc"), ("ab", "d"), ("ab",) * 2, ():
        assert not is_agreed_upon(file, *changed)


def test_checks_have_a_line_each_in_the_order_of_names(file: Path) -> None:
    for name in ("the second", "first"):
        with Agreements(file, anew=True).upon(name, name):
            pass
    assert [line.split(" ", 1)[1] for line in file.read_text().splitlines()] == [
        "first",
        "the second",
    ]


def test_a_failed_check_is_not_recorded(file: Path) -> None:
    with pytest.raises(AssertionError), Agreements(file, anew=True).upon("a reader", "x"):
        raise AssertionError
    assert not is_agreed_upon(file, "x")
