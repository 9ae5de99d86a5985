"""Recorded drives: what is read from campaigns, exports and tables, and what is refused."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from frenetic import Budget, Campaign, EmbeddedSimulator, RandomSearch, Stanley
from frenetic.errors import FreneticError
from frenetic.export import export_campaign
from frenetic.twin.calibration import read_recordings

HUGE = int("9" * 320)
"""A number that JSON holds and a float does not."""
MOVES = {"time": [0, 1], "x": [0, 5], "y": [0, 0]}


def drive_record(time: float, speed: float = 5.0) -> list[Any]:
    """A record of the competition's."""
    vectors = [[5.0 * time, 0.0, 0.0], [1.0, 0.0, 0.0], [speed, 0.0, 0.0]]
    return [time, *vectors, *[0.0] * 11, 1.5, 0.0]


@pytest.fixture(scope="module")
def campaigns(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("recorded")
    for seed in (101, 102):
        Campaign(
            strategy=RandomSearch(seed=seed),
            driver=Stanley(lateral_acceleration=7.3),
            simulator=EmbeddedSimulator(),
            budget=Budget(simulations=8),
            folder=folder / f"run-{seed}",
        ).run()
    return sorted(folder.iterdir())


def test_an_export_is_read_as_its_campaign(campaigns: list[Path], tmp_path: Path) -> None:
    export_campaign(campaigns[0], "competition", tmp_path / "out", trajectories="all")
    found = read_recordings([tmp_path / "out"]).drives
    own = read_recordings([campaigns[0]]).drives
    assert [one.failed for one in found] == [one.failed for one in own]
    for theirs, ours in zip(found, own, strict=True):
        assert theirs.max_oob_share == pytest.approx(ours.max_oob_share, abs=1e-4)
        assert theirs.road.pose == pytest.approx(ours.road.pose, abs=1e-3)
        m = min(len(theirs.offset), len(ours.offset))
        assert abs(len(theirs.offset) - len(ours.offset)) <= 1
        assert theirs.offset[:m] == pytest.approx(ours.offset[:m], abs=1e-3)
        assert theirs.speed[:m] == pytest.approx(ours.speed[:m], abs=0.2)


def row_of(**more: Any) -> str:
    return json.dumps({"curvatures": [0.0, 0.01], "outcome": "PASS"} | more)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (row_of(outcome=None), "row 1 has no outcome"),
        (row_of(outcome="MAYBE"), r"'MAYBE' - at `\$.outcome`"),
        (row_of(outcome=["PASS"]), r"got `array` - at `\$.outcome`"),
        (row_of(curvatures=None), "neither 'curvatures' nor 'road_points'"),
        (row_of(curvatures="x"), r"got `str` - at `\$.curvatures`"),
        (row_of(max_oob_share="much"), r"`\$.max_oob_share`"),
        (row_of(max_oob_share=HUGE), r"`\$.max_oob_share`"),
        (row_of(max_oob_share=math.nan), "row 1 holds no object of JSON: .*byte"),
        (row_of(trajectory={"time": [0, 1]}), r"missing required field `x` - at `\$.trajectory`"),
        (row_of(trajectory=3), r"got `int` - at `\$.trajectory`"),
        (row_of(trajectory=MOVES | {"speed": 5}), r"`\$.trajectory.speed`"),
        (row_of(trajectory=MOVES | {"x": [HUGE] * 2}), r"`\$.trajectory.x\[0\]`"),
        (row_of(trajectory=MOVES | {"x": [1]}), "as many times as places"),
        (row_of(trajectory=MOVES | {"time": [1, 0]}), "in the order of time"),
        (row_of(trajectory=MOVES | {"time": [1, 1]}), "of one time"),
        (row_of(execution_data=[[1, 2]]), r"`\$.execution_data\[0\].pos`"),
        (row_of(execution_data=3), r"`\$.execution_data`"),
        (
            row_of(execution_data=[drive_record(0), drive_record(1, HUGE)]),
            r"`\$.execution_data\[1\].vel\[0\]`",
        ),
        ("[{}]", "row 1 holds no object of JSON"),
        ("[" * 10**5, "row 1 holds no object of JSON"),
    ],
)
def test_a_damaged_table_names_its_row_and_the_place_in_it(
    tmp_path: Path, line: str, message: str
) -> None:
    table = tmp_path / "tests.jsonl"
    table.write_text(line + "\n", encoding="utf-8")
    with pytest.raises(FreneticError, match=message) as caught:
        read_recordings([table])
    assert str(caught.value).startswith(f"{table}, row 1")


def test_recordings_under_different_terms_are_not_mixed(
    campaigns: list[Path], tmp_path: Path
) -> None:
    table = tmp_path / "tests.jsonl"
    table.write_text(row_of(), encoding="utf-8")
    (tmp_path / "empty").mkdir()
    for place, message in (("nowhere", "no file or folder"), ("empty", "holds no recording")):
        with pytest.raises(FreneticError, match=message):
            read_recordings([tmp_path / place])
    with pytest.raises(FreneticError, match="given twice"):
        read_recordings([campaigns[0], campaigns[0]])
    assert len(read_recordings([campaigns[0], table]).drives) == 9
    (faster := tmp_path / "faster").mkdir()
    (faster / "test.0001.json").write_text(
        json.dumps({"road_points": [[0, 0], [0, 50]], "test_outcome": "PASS"}), encoding="utf-8"
    )
    described = faster / "experiment_description.csv"
    described.write_text("speed_limit,oob_tolerance\n90,0.85\n", encoding="utf-8")
    with pytest.raises(FreneticError, match=r"speed_limit 70 and 90 and oob_tol"):
        read_recordings([campaigns[0], faster])
    described.write_text(f"speed_limit\n{'9' * 2_000}\n", encoding="utf-8")
    with pytest.raises(FreneticError, match=r"description.csv: .* `\$.speed_limit`"):
        read_recordings([faster])


def test_a_line_of_json_ends_with_a_line_feed_alone(tmp_path: Path) -> None:
    row = {"curvatures": [0.0, 0.01], "outcome": "PASS", "run": "a\u2028b\x85c"}
    table = tmp_path / "tests.jsonl"
    table.write_text(json.dumps(row, ensure_ascii=False) + "\n", encoding="utf-8")
    (drive,) = read_recordings([table]).drives
    assert drive.run.endswith("a\u2028b\x85c")


def test_a_speed_that_is_not_told_is_that_of_the_places(tmp_path: Path) -> None:
    path = {
        "time": [0.5 * i for i in range(9)],
        "x": [60.0 + 5.0 * i for i in range(9)],
        "y": [100.0] * 9,
    }
    line = row_of(road_points=[[60, 100], [110, 100]], curvatures=None, trajectory=path)
    (table := tmp_path / "tests.jsonl").write_text(line, encoding="utf-8")
    (drive,) = read_recordings([table]).drives
    assert drive.speed == pytest.approx([10.0] * 21)
