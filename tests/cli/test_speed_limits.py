"""Speed limits of the command line, of a road's file, of a class, and the default."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from frenetic.campaign import CampaignStore
from frenetic.road import Road
from frenetic.road.files import entries_of

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

MAPS = Path(__file__).parents[1] / "cases" / "maps"
TOWN = MAPS / "01-town-30.xodr"


def limit_of(out: str) -> str:
    (line,) = re.findall(r"^limit +(.*)$", out, re.MULTILINE)
    return str(line)


def test_a_map_of_a_town_is_driven_at_its_speed_limit(frenetic: Frenetic) -> None:
    driver = f"{MAPS / '01-keeps_limit.py'}:Limit"
    answer = frenetic("drive", TOWN, "--road", "1", "--driver", driver)
    assert answer.code == 0
    assert answer.out.startswith("PASS")
    assert "MOOBD      1.290 m" in answer.out
    assert limit_of(answer.out) == "30 km/h, of the road"


@pytest.mark.parametrize(
    ("options", "limit"),
    [
        ((), "30 km/h, of the road"),
        (("--roads", "rural-100"), "30 km/h, of the road"),
        (("--criteria", "competition,speed_limit=60"), "60 km/h, as given"),
        (("--with", "speed=45"), "45 km/h, as given"),
        (("--roads", "rural-100", "--with", "speed=45"), "45 km/h, as given"),
    ],
)
def test_the_command_line_wins_over_the_file_and_the_file_over_the_class(
    frenetic: Frenetic, tmp_path: Path, options: tuple[str, ...], limit: str
) -> None:
    path = tmp_path / "road.json"
    road = Road(np.zeros(20), lane_width=3.75, speed_limits=[(0, 30)])
    path.write_text(json.dumps(entries_of(road)))
    answer = frenetic("drive", path, *options, "--json")
    assert limit_of(frenetic("drive", path, *options).out) == limit
    fastest = float(limit.split()[0])
    assert answer.json["duration"] >= 180.0 / (fastest / 3.6)


@pytest.mark.parametrize(
    ("options", "limit"),
    [
        ((), "70 km/h, assumed"),
        (("--roads", "rural-100"), "100 km/h, of rural-100"),
        (("--roads", "rural-100", "--criteria", "competition,speed_limit=80"), "80 km/h, as given"),
    ],
)
def test_a_road_without_a_limit_has_the_limit_of_its_class_or_70_km_h(
    frenetic: Frenetic, tmp_path: Path, options: tuple[str, ...], limit: str
) -> None:
    path = tmp_path / "road.json"
    path.write_text(json.dumps({"curvatures": [0.0] * 20, "lane_width": 3.5}))
    assert limit_of(frenetic("drive", path, *options).out) == limit


def test_exports_of_a_map_keep_its_speed_limit(frenetic: Frenetic, tmp_path: Path) -> None:
    out = tmp_path / "o.xodr"
    answer = frenetic("export", TOWN, "--road", "1", "--format", "opendrive", "--out", out)
    assert answer.code == 0
    assert (
        re.findall(r'<speed [^>]*max="([^"]*)" unit="([^"]*)"', out.read_text())
        == [("30.0", "km/h")] * 3
    )
    assert 'AbsoluteTargetSpeed value="8.333333"' in out.with_suffix(".xosc").read_text()
    frenetic("export", TOWN, "--road", "1", "--format", "json", "--out", tmp_path / "o.json")
    assert json.loads((tmp_path / "o.json").read_text())["speed_limits"] == [[0.0, 30.0]]
    for file in ("o.xodr", "o.json"):
        assert limit_of(frenetic("drive", tmp_path / file).out) == "30 km/h, of the road"


def test_an_exported_test_has_the_speed_limit_of_its_class(
    frenetic: Frenetic, tmp_path: Path
) -> None:
    folder = tmp_path / "c"
    run = ("run", "--roads", "rural-100", "--simulations", 3, "--seed", 1, "--out", folder)
    assert "speed limit 100 km/h, of rural-100" in frenetic(*run).err
    frenetic("export", folder, 1, "--format", "opendrive", "--out", tmp_path / "o.xodr")
    answer = frenetic("drive", tmp_path / "o.xodr", "--road", "1")
    assert limit_of(answer.out) == "100 km/h, of the road"


def test_a_scenario_changes_its_target_speed_with_the_limit(
    frenetic: Frenetic, tmp_path: Path
) -> None:
    road = Road(np.zeros(31), speed_limits=[(0, 72), (200, 36), (250, 54)])
    (tmp_path / "road.json").write_text(json.dumps(entries_of(road)))
    out = tmp_path / "o.xodr"
    frenetic("export", tmp_path / "road.json", "--format", "opendrive", "--out", out)
    scenario = out.with_suffix(".xosc").read_text()
    assert re.findall(r'AbsoluteTargetSpeed value="([^"]*)"', scenario) == [
        "0.0",
        "20.0",
        "10.0",
        "15.0",
    ]
    # From 20 to 10 m/s by 3 m/s² takes 50 m; the car starts 2.5 m behind the road's start.
    assert re.findall(r'TraveledDistanceCondition value="([^"]*)"', scenario) == ["147.5", "247.5"]


@pytest.mark.parametrize(
    ("limits", "speeds", "places"),
    [
        # From 20 m/s the car cannot brake to 8 1/3 m/s in 10 m, so it never drives 100 km/h.
        ([(0, 70), (50, 100), (60, 30)], ["19.444444", "11.377365", "8.333333"], ["7.124", "47.5"]),
        ([(0, 70), (2, 30)], ["8.333333"], []),
    ],
)
def test_a_scenario_brakes_in_time_for_a_lower_limit(
    frenetic: Frenetic,
    tmp_path: Path,
    limits: list[tuple[float, float]],
    speeds: list[str],
    places: list[str],
) -> None:
    (tmp_path / "road.json").write_text(
        json.dumps(entries_of(Road(np.zeros(15), speed_limits=limits)))
    )
    out = tmp_path / "o.xodr"
    frenetic("export", tmp_path / "road.json", "--format", "opendrive", "--out", out)
    scenario = out.with_suffix(".xosc").read_text()
    assert re.findall(r'AbsoluteTargetSpeed value="([^"]*)"', scenario) == ["0.0", *speeds]
    distances = [
        float(s) for s in re.findall(r'TraveledDistanceCondition value="([^"]*)"', scenario)
    ]
    assert distances == sorted(distances)
    assert len(distances) == len(places)


def test_minimising_keeps_a_limit_that_begins_between_two_samples(
    frenetic: Frenetic, tmp_path: Path
) -> None:
    road = Road([0, 0, 0.03, 0.03], 40.0, speed_limits=[(0, 20), (41, 100)])
    (tmp_path / "q.json").write_text(json.dumps(entries_of(road)))
    slippery = ("--simulator", "embedded,friction=0.25")
    assert frenetic("drive", tmp_path / "q.json", *slippery).out.startswith("FAIL")
    assert frenetic("minimise", tmp_path / "q.json", *slippery, "--max-drives", 20).code == 0


def test_speed_varies_around_the_highest_limit_of_the_drive(
    frenetic: Frenetic, tmp_path: Path
) -> None:
    """Where the road has no limit, the default limit is scaled as well."""
    (tmp_path / "roads").mkdir()
    road = Road(0.01 * np.sin(np.arange(12)), speed_limits=[(0, 30), (30, 0)])
    (tmp_path / "roads" / "a.json").write_text(json.dumps(entries_of(road)))
    run = ("run", "--from-roads", tmp_path / "roads", "--roads", "competition", "--seed", 1)
    assert frenetic(*run, "--simulations", 1, "--out", tmp_path / "f").code == 0
    answer = frenetic("rerun", tmp_path / "f", 1, "--times", 4, "--vary", "speed", "--json")
    drawn = [drive["conditions"]["speed"] for drive in answer.json["tests"][0]["drives"]]
    assert all(63.0 <= speed <= 77.0 for speed in drawn)


def test_a_search_from_real_roads_drives_each_road_at_its_own_limit(
    frenetic: Frenetic, tmp_path: Path
) -> None:
    folder = tmp_path / "f"
    answer = frenetic(
        "run",
        "--from-roads",
        MAPS / "02-from-roads",
        "--simulations",
        20,
        "--seed",
        1,
        "--out",
        folder,
    )
    assert "speed limits of the files: 40 to 120 km/h" in answer.err
    with CampaignStore.open(folder) as store:
        tests = list(store.tests(with_trajectory=True))
        limits = {
            test.candidate.notes["given"]: test.road.speed_limits.tolist()
            for test in tests
            if test.candidate.origin.operator == "given"
        }
        assert sorted(limits.values()) == [[[0.0, 40.0]], [[0.0, 120.0]]]
        for test in tests:
            assert test.drive is not None
            most = float(test.drive.rules.speed_limits_on(test.road)[:, 1].max())
            assert 3.6 * float(test.drive.trajectory.speed.max()) <= most + 2.0
            parents = [other for other in tests if other.id in test.candidate.origin.parents]
            if parents:
                assert np.array_equal(test.road.speed_limits, parents[0].road.speed_limits)
        fastest = max(float(test.drive.trajectory.speed.max()) for test in tests if test.drive)
    assert 3.6 * fastest > 100.0
    # The record says the same when the campaign is driven again.
    number = next(test.id for test in tests if test.road.speed_limits.tolist() == [[0.0, 120.0]])
    repeated = frenetic("drive", folder, number)
    assert "as in the campaign" in repeated.out
    assert limit_of(repeated.out) == "120 km/h, of the road"
    scaled = frenetic("rerun", folder, number, "--times", 3, "--vary", "speed", "--json")
    drawn = [drive["conditions"]["speed"] for drive in scaled.json["tests"][0]["drives"]]
    assert all(108.0 <= speed <= 132.0 for speed in drawn)


def test_a_search_from_real_roads_keeps_the_limit_of_the_command_line(
    frenetic: Frenetic, tmp_path: Path
) -> None:
    folder = tmp_path / "f"
    answer = frenetic(
        *("run", "--from-roads", MAPS / "02-from-roads", "--simulations", 3, "--seed", 1),
        *("--criteria", "competition,speed_limit=60", "--out", folder),
    )
    assert "speed limit 60 km/h, as given" in answer.err
    with CampaignStore.open(folder) as store:
        for test in store.tests(with_trajectory=True):
            assert test.drive is not None
            assert test.drive.rules.speed_limits_on(test.road).tolist() == [[0.0, 60.0]]
            assert 3.6 * float(test.drive.trajectory.speed.max()) <= 61.0


def test_a_search_says_which_limit_it_assumes_for_files_without_limit(
    frenetic: Frenetic, tmp_path: Path
) -> None:
    (tmp_path / "roads").mkdir()
    road = Road(0.01 * np.sin(np.arange(40)))
    (tmp_path / "roads" / "a.json").write_text(json.dumps(entries_of(road)))
    run = ("run", "--from-roads", tmp_path / "roads", "--simulations", 2, "--seed", 1)
    answer = frenetic(*run, "--out", tmp_path / "f")
    assert re.search(r"no file says a speed limit: \d+ km/h, of roads", answer.err)
