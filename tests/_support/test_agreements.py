"""What slow readers have agreed with is shown to them again when it has changed, and only then."""

from __future__ import annotations

from pathlib import Path

import pytest
from agreements import Agreements


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "kept.txt"


def ask(file: Path, *parts: str | bytes, anew: bool = False) -> bool:
    with Agreements(file, anew=anew).upon("a reader", *parts) as is_agreed:
        return is_agreed


def test_only_unchanged_inputs_count_as_agreed(file: Path) -> None:
    assert not ask(file, "ab", b"c")
    assert not file.exists(), "a usual run keeps nothing"
    assert not ask(file, "ab", b"c", anew=True)
    assert ask(file, b"ab", "c")
    assert not ask(file, "ab", anew=True), "a full run asks again"
    assert ask(file, "ab")
    for changed in ("abc", ""), ("a", "bc"), ("ab", "d"), ("ab",) * 2, ():
        assert not ask(file, *changed)


def test_names_are_kept_apart_and_in_order(file: Path) -> None:
    for name in ("the second", "first"):
        with Agreements(file, anew=True).upon(name, name):
            pass
    assert [line.split(" ", 1)[1] for line in file.read_text().splitlines()] == [
        "first",
        "the second",
    ]


def test_a_disagreement_is_not_stored(file: Path) -> None:
    with pytest.raises(AssertionError), Agreements(file, anew=True).upon("a reader", "x"):
        raise AssertionError
    assert not ask(file, "x")
