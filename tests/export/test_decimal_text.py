"""Decimal numbers as text, against `repr` and the encoder of JSON."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from msgspec.json import encode

from frenetic.export.decimal_text import MISSING, NEGATIVE_ZERO, TRUTH, decimal_rows

DECIMALS = st.integers(1, 6)
MULTIPLES = st.one_of(st.integers(-(2**51), 2**51), st.integers(-200, 200))


@given(DECIMALS, st.lists(MULTIPLES, min_size=1, max_size=20))
def test_numbers_are_as_repr_writes_them(decimals: int, multiples: list[int]) -> None:
    column = np.array([multiples])
    numbers = [multiple / 10**decimals for multiple in multiples]
    text = decimal_rows(column, np.array([decimals]), [b"<", b">"], has_exponents=True)
    assert text.decode() == "".join(f"<{number!r}>" for number in numbers)


@given(st.integers(1, 5), st.lists(MULTIPLES, min_size=1, max_size=20))
def test_without_exponents_numbers_are_as_json_has_them(
    decimals: int, multiples: list[int]
) -> None:
    column = np.array([multiples])
    text = decimal_rows(column, np.array([decimals]), [b"", b"\n"], has_exponents=False)
    assert text == b"".join(encode(multiple / 10**decimals) + b"\n" for multiple in multiples)


def test_rows_have_their_separators_whole_numbers_truths_and_negative_zeros() -> None:
    columns = np.array([[12, -3], [0, 1], [NEGATIVE_ZERO, 5]])
    text = decimal_rows(
        columns, np.array([0, TRUTH, 2]), [b"[", b", ", b", ", b"], "], has_exponents=True
    )
    assert text == b"[12, false, -0.0], [-3, true, 0.05], "


def test_missing_numbers_are_empty_or_null() -> None:
    columns, decimals = np.array([[12, MISSING], [MISSING, -5]]), np.array([1, 4])
    separators = [b"", b",", b"\n"]
    rows = decimal_rows(columns, decimals, separators, has_exponents=True)
    assert rows == b"1.2,\n,-0.0005\n"
    rows = decimal_rows(columns, decimals, separators, has_exponents=False, missing=b"null")
    assert rows == b"1.2,null\nnull,-0.0005\n"


def test_no_rows_are_no_text() -> None:
    assert decimal_rows(np.empty((2, 0), np.int64), np.array([1, 1]), [b"", b",", b"\n"],
                        has_exponents=True) == b""  # fmt: skip
