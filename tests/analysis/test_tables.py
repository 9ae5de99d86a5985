"""Comparisons as text: tables and sentences."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
import pytest

from frenetic.analysis.comparison import Comparison, compare_measured
from frenetic.analysis.conclusions import findings, in_short, p_text, verdict
from frenetic.analysis.metrics import CampaignMeasures
from frenetic.analysis.tables import (
    comparison_table_csv,
    comparison_table_markdown,
    write_table,
)
from frenetic.errors import FreneticError


def campaign(distinct: int, sparseness: float = -math.inf) -> CampaignMeasures:
    """With 100 simulations and so many failures, each unlike the others."""
    curve = np.minimum(np.arange(101), distinct)
    return CampaignMeasures(
        folder=Path("made-up"),
        seed=None,
        invalid=25,
        failures_after=curve,
        distinct_after=curve,
        cells_after=curve,
        seconds_to_failure=0.5 if distinct else math.inf,
        is_finished=True,
        competition_sparseness=sparseness,
    )


def groups_of(**groups: list[int]) -> Comparison:
    return compare_measured(
        {name: tuple(campaign(number) for number in numbers) for name, numbers in groups.items()}
    )


def rows_of(comparison: Comparison) -> list[dict[str, str]]:
    return list(csv.DictReader(comparison_table_csv(comparison).splitlines()))


LOW, HIGH = [1, 2, 3, 4, 5], [11, 12, 13, 14, 15]


def test_csv_has_a_row_per_group_the_best_first() -> None:
    first, second = rows_of(groups_of(low=LOW, high=HIGH))
    assert (first["group"], second["group"]) == ("high", "low")
    assert first["campaigns"] == "5"
    cells = ("distinct_per_100", "distinct_per_100_low", "distinct_per_100_high")
    assert [first[name] for name in cells] == ["13", "12", "14"]
    assert (first["distinct_per_100_mean_rank"], second["distinct_per_100_mean_rank"]) == ("3", "8")
    assert first["invalid_share"] == "0.2"
    assert (first["tests"], first["tests_low"]) == ("125", "125")
    assert "tests_mean_rank" not in first


def test_csv_is_empty_where_something_never_happened() -> None:
    _, never = rows_of(groups_of(never=[0] * 5, high=HIGH))
    assert never["simulations_to_failure"] == never["competition_sparseness"] == ""
    assert never["failures"] == "0"


def test_csv_keeps_any_name() -> None:
    name = 'a, "b"\nc'
    comparison = compare_measured({name: (campaign(1),), "d": (campaign(0),)})
    read = csv.DictReader(comparison_table_csv(comparison).splitlines(keepends=True))
    assert next(iter(read))["group"] == name


def test_no_name_is_a_formula() -> None:
    comparison = compare_measured({"=1+1\x1b": (campaign(1),), "d": (campaign(0),)})
    assert rows_of(comparison)[0]["group"] == "'=1+1\\x1b"


def test_markdown_has_medians_with_quartiles() -> None:
    lines = comparison_table_markdown(groups_of(low=LOW, high=HIGH)).splitlines()
    cells = [[cell.strip() for cell in line.strip("|").split(" | ")] for line in lines]
    assert [len(row) for row in cells] == [len(cells[0])] * 4
    assert cells[0][:3] == ["group", "campaigns", "distinct failures per 100 simulations"]
    assert cells[2][:3] == ["high", "5", "13.0 (12.0 to 14.0)"]
    assert cells[3][0] == "low"


def test_markdown_lets_no_name_end_a_cell() -> None:
    comparison = compare_measured({"a|b\n<i>\x1b": (campaign(2),), "c": (campaign(1),)})
    text = comparison_table_markdown(comparison)
    assert "| a\\|b \\<i\\>\\\\x1b | 1 |" in text
    assert len(text.splitlines()) == 4


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


def test_two_that_differ() -> None:
    assert findings(groups_of(low=LOW, high=HIGH)) == (
        "high finds more distinct failures per 100 simulations than low (A12 1.00, large; p"
        " 0.0079). Median (quartiles) of distinct failures per 100 simulations: high 13.0 (12.0 to"
        " 14.0); low 3.0 (2.0 to 4.0)."
    )


def test_two_that_are_alike() -> None:
    assert verdict(groups_of(a=LOW, b=LOW)) == (
        "No difference in distinct failures per 100 simulations is shown."
    )


def test_few_repeats() -> None:
    assert verdict(groups_of(a=LOW[:4], b=HIGH)).startswith("Too few repeats to tell")


def test_one_of_three_that_is_better_than_all() -> None:
    assert verdict(groups_of(a=LOW, b=HIGH, c=LOW)) == (
        "b finds more distinct failures per 100 simulations than a and c, which is shown for each"
        " of them."
    )


def test_one_of_three_that_is_level_with_another() -> None:
    near = [10, 12, 13, 14, 14]
    assert verdict(groups_of(a=LOW, b=HIGH, c=near)) == (
        "b comes first in distinct failures per 100 simulations, shown to find more than a, not"
        " than c."
    )


def test_nobody_is_best_where_the_first_place_is_shared() -> None:
    assert verdict(groups_of(a=LOW, b=HIGH, c=HIGH)).startswith(
        "No group is shown to find the most"
    )


def test_groups_of_which_none_but_all_together_differ() -> None:
    several = {f"g{i}": [n + 10 * i for n in LOW] for i in range(6)}
    assert verdict(groups_of(**several)).startswith("No two groups are shown to differ")
    assert "2 groups between" in findings(groups_of(**several))


def test_many_names_are_counted() -> None:
    assert in_short(["a"]) == "a"
    assert in_short(["a", "b", "c"]) == "a, b and c"
    assert in_short(["a", "b", "c", "d", "e"]) == "a, b and 3 others"


def test_p_has_as_many_digits_as_mean_something() -> None:
    assert [p_text(p) for p in (0.0004, 0.00794, 0.0412, 0.31, 1.0)] == [
        "< 0.001",
        "0.0079",
        "0.041",
        "0.31",
        "1.00",
    ]
