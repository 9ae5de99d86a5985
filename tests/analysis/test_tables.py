"""Comparisons as text: tables and sentences."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from made_campaigns import measures

from frenetic.analysis.comparison import (
    Comparison,
    compare_measured,
    findings,
    p_text,
    verdict,
)
from frenetic.analysis.tables import (
    comparison_table_csv,
    comparison_table_markdown,
    write_table,
)
from frenetic.errors import FreneticError


def groups_of(**groups: list[int]) -> Comparison:
    return compare_measured(
        {
            name: tuple(measures(number, invalid=25) for number in numbers)
            for name, numbers in groups.items()
        }
    )


def rows_of(comparison: Comparison) -> list[dict[str, str]]:
    return list(csv.DictReader(comparison_table_csv(comparison).splitlines()))


LOW, HIGH = [1, 2, 3, 4, 5], [11, 12, 13, 14, 15]


def test_csv_has_a_row_per_group_the_best_first() -> None:
    first, second = rows_of(groups_of(low=LOW, high=HIGH))
    assert (first["group"], second["group"]) == ("high", "low")
    assert first["campaigns"] == "5"
    cells = ("distinct_failures", "distinct_failures_low", "distinct_failures_high")
    assert [first[name] for name in cells] == ["13", "12", "14"]
    assert [row["distinct_failures_mean_rank"] for row in (first, second)] == ["3", "8"]
    assert first["valid_share"] == "0.8"


def test_any_name_is_a_cell_and_no_formula_and_what_never_happened_an_empty_one() -> None:
    odd = {'a, "b"\nc': (measures(2),), "=1+1\x1b": (measures(1),), "a|b\n<i>\x1b": (measures(0),)}
    text = comparison_table_csv(compare_measured(odd))
    rows = list(csv.DictReader(text.splitlines(keepends=True)))
    assert [row["group"] for row in rows] == ['a, "b"\nc', "'=1+1\\x1b", "a|b\n<i>\\x1b"]
    assert rows[2]["simulations_to_failure"] == rows[2]["competition_sparseness"] == ""
    assert rows[2]["failures"] == "0"
    text = comparison_table_markdown(compare_measured(odd))
    assert "| a\\|b \\<i\\>\\\\x1b | 1 |" in text
    assert len(text.splitlines()) == 5


def test_markdown_has_medians_with_quartiles() -> None:
    lines = comparison_table_markdown(groups_of(low=LOW, high=HIGH)).splitlines()
    cells = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]
    assert [len(row) for row in cells] == [len(cells[0])] * 4
    assert cells[0][:3] == ["group", "campaigns", "distinct failures"]
    assert cells[2][:3] == ["high", "5", "13 (12 to 14)"]
    assert cells[3][0] == "low"


@pytest.mark.parametrize("suffix", ["csv", "md"])
def test_a_table_is_written_whole(suffix: str, tmp_path: Path) -> None:
    comparison = groups_of(low=LOW, high=HIGH)
    path = write_table(comparison, tmp_path / f"t.{suffix}")
    made = {"csv": comparison_table_csv, "md": comparison_table_markdown}[suffix]
    assert path.read_bytes().decode() == made(comparison)
    assert list(tmp_path.iterdir()) == [path]


def test_mistakes_are_told(tmp_path: Path) -> None:
    comparison = groups_of(low=LOW, high=HIGH)
    with pytest.raises(FreneticError, match=r"must end with \.csv or \.md"):
        write_table(comparison, tmp_path / "t.txt")
    with pytest.raises(FreneticError, match="cannot be written"):
        write_table(comparison, tmp_path / "nowhere" / "t.csv")


# Sentences


NEAR = [10, 12, 13, 14, 14]
SEVERAL = {f"g{i}": [n + 10 * i for n in LOW] for i in range(6)}


@pytest.mark.parametrize(
    ("groups", "words"),
    [
        ({"a": LOW, "b": LOW}, "No difference in distinct failures is shown."),
        ({"a": LOW[:4], "b": HIGH}, "Too few repeats to tell: at least 5 campaigns a group"),
        (
            {"a": LOW, "b": HIGH, "c": LOW},
            "b finds more distinct failures than a and c, which is shown for each of them.",
        ),
        (
            {"a": LOW, "b": HIGH, "c": NEAR},
            "b comes first in distinct failures, shown to find more than a, not than c.",
        ),
        ({"a": LOW, "b": HIGH, "c": HIGH}, "No group is shown to find the most distinct failures"),
        (SEVERAL, "No difference in distinct failures is shown."),
    ],
)
def test_verdicts(groups: dict[str, list[int]], words: str) -> None:
    assert verdict(groups_of(**groups)).startswith(words)


def test_findings_tell_the_medians_of_the_best_and_the_last() -> None:
    assert findings(groups_of(low=LOW, high=HIGH)) == (
        "high finds more distinct failures than low (A12 1.00, large; p 0.0079)."
        " Median (quartiles) of distinct failures: high 13 (12 to 14); low 3 (2 to 4)."
    )
    assert "2 groups between" in findings(groups_of(**SEVERAL))


def test_p_has_as_many_digits_as_mean_something() -> None:
    assert [p_text(p) for p in (0.0004, 0.00794, 0.0412, 0.31, 1.0)] == [
        "< 0.001",
        "0.0079",
        "0.041",
        "0.31",
        "1.00",
    ]
