"""Campaigns that start from real roads."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from campaigns import campaign

from frenetic.campaign import Campaign, CampaignStore
from frenetic.drivers import Planner
from frenetic.road import Road
from frenetic.road.classes import RoadClass
from frenetic.road.files import entries_of
from frenetic.road.real_roads import class_of_stretches, resampled, shown_class, stretches_of
from frenetic.search import Frenetic, RandomSearch
from frenetic.search.operator_names import GIVEN
from frenetic.search.random_roads import RandomRoads
from frenetic.simulators import EmbeddedSimulator

if TYPE_CHECKING:
    from command_line import Frenetic as Command

pytest_plugins = ["command_line"]

COUNT = 4
SIMULATIONS = 40


def random_roads(road_class: RoadClass, count: int, seed: int = 1) -> list[Road]:
    """Random roads of a class."""
    rng = np.random.default_rng(seed)
    roads = RandomRoads(map_size=road_class.map_size, road_class=road_class)
    roads_of_class = []
    for _ in range(count):
        values = roads.draw(rng)
        roads_of_class.append(
            Road(
                values,
                road_class.step,
                lane_width=road_class.lane_width,
                **road_class.profiles(values, road_class.step),
                grade=() if (grade := roads.grade(rng, values)) is None else grade,
            )
        )
    return roads_of_class


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Roads of a class as files."""
    roads_folder = tmp_path_factory.mktemp("real") / "roads"
    roads_folder.mkdir()
    for i, road in enumerate(random_roads(RoadClass.of("rural-80", {"length": 800}), COUNT)):
        (roads_folder / f"road{i}.json").write_text(json.dumps(entries_of(road)))
    return roads_folder


def search_from_roads(out: Path, folder: Path, *, simulations: int = SIMULATIONS) -> Campaign:
    shown = shown_class(folder)
    return campaign(
        out,
        simulations,
        strategy=Frenetic(seed=3, road_class=shown),
        driver=Planner(aggression=1.3),
        simulator=EmbeddedSimulator(friction=0.4),
        from_roads=folder,
    )


@pytest.mark.parametrize("name", ["urban-50", "rural-80", "rural-100", "motorway-130"])
def test_the_shown_class_is_no_wider_than_the_roads_class(name: str) -> None:
    road_class = RoadClass.of(name)
    roads = {str(i): road for i, road in enumerate(random_roads(road_class, 30))}
    shown = class_of_stretches(roads, "shown")
    assert all(shown.breach(road) == "" for road in roads.values())
    for rule in ("min_radius", "min_clothoid", "min_crest", "min_sag"):
        assert getattr(shown, rule) >= getattr(road_class, rule) - 0.1
    for rule in ("max_superelevation", "max_grade"):
        assert getattr(shown, rule) <= getattr(road_class, rule) + 1e-4
    # The German guideline allows a motorway sharper bends than the formula.
    assert shown.design_speed >= road_class.design_speed - 10.0
    assert shown.sources["min_radius"].startswith("shown by ")


def test_a_flat_straight_road_shows_a_class_for_any_speed() -> None:
    shown = class_of_stretches({"straight": Road([0.0] * 40, 10.0)}, "straight")
    assert shown.design_speed == 130.0
    assert shown.max_superelevation == shown.max_grade == 0.0
    assert (
        shown.min_radius
        == RoadClass.from_entries(
            {"name": "", "design_speed": 130.0, "max_superelevation": 0.0}
        ).min_radius
    )


def test_a_resampled_road_turns_as_far_and_is_no_sharper() -> None:
    road = Road(0.02 * np.sin(np.arange(300) / 20.0), 0.7, (5.0, 3.0, 1.0))
    other = resampled(road, 10.0)
    assert other is not None
    assert road.length - 10.0 < other.length <= road.length
    turned = np.interp(other.length, np.arange(300) * 0.7, road.headings)
    half = 0.5 * 10.0 * abs(other.curvatures[[0, -1]]).max()
    assert abs(other.headings[-1] - turned) <= half
    assert abs(other.curvatures).max() <= abs(road.curvatures).max() + 1e-12
    assert np.hypot(*(other.points[-1] - road.pose_at(other.length)[:2])) < 0.05 * road.length


def test_long_roads_are_cut_and_short_ones_left_out() -> None:
    roads = {"long": Road([0.0] * 701, 10.0), "short": Road([0.0] * 5, 10.0)}
    stretches = stretches_of(roads, 10.0)
    assert list(stretches) == ["long, part 1", "long, part 2", "long, part 3"]
    assert sum(road.length for road in stretches.values()) == 7000.0
    assert max(road.length for road in stretches.values()) <= 3000.0


def test_the_search_drives_the_real_roads_first_and_keeps_their_class(
    tmp_path: Path, folder: Path
) -> None:
    search_from_roads(tmp_path / "out", folder).run()
    shown = shown_class(folder)
    with CampaignStore.open(tmp_path / "out") as store:
        tests = list(store.tests())
        first = tests[:COUNT]
        assert [test.candidate.origin.operator for test in first] == [GIVEN] * COUNT
        real_roads = random_roads(RoadClass.of("rural-80", {"length": 800}), COUNT)
        for i, (test, road) in enumerate(zip(first, real_roads, strict=True)):
            assert np.array_equal(test.road.curvatures, road.curvatures)
            assert np.array_equal(test.road.grade, road.grade)
            assert np.array_equal(test.road.superelevation, road.superelevation)
            assert test.candidate.notes[GIVEN] == str(folder / f"road{i}.json")
        parents = {parent for test in tests for parent in test.candidate.origin.parents}
        assert parents & set(range(1, COUNT + 1))
        for test in tests:
            assert shown.breach(test.road) == ""


def test_a_resumed_search_is_the_same_without_the_files(tmp_path: Path, folder: Path) -> None:
    copy = tmp_path / "roads"
    copy.mkdir()
    for file in folder.iterdir():
        (copy / file.name).write_bytes(file.read_bytes())
    search_from_roads(tmp_path / "whole", copy).run()
    half = search_from_roads(tmp_path / "half", copy)
    half.run(12)
    resumed = search_from_roads(tmp_path / "half", copy)
    for file in copy.iterdir():
        file.unlink()
    resumed.resume()
    with (
        CampaignStore.open(tmp_path / "whole") as whole,
        CampaignStore.open(resumed.folder) as other,
    ):
        whole_tests, resumed_tests = list(whole.tests()), list(other.tests())
    assert [test.outcome for test in whole_tests] == [test.outcome for test in resumed_tests]
    for test, same in zip(whole_tests, resumed_tests, strict=True):
        assert np.array_equal(test.candidate.curvatures, same.candidate.curvatures)


def test_the_command_and_its_campaign_file_keep_the_class_of_the_roads(
    frenetic: Command, tmp_path: Path, folder: Path
) -> None:
    words = ["run", "--from-roads", str(folder), "--seed", "1", "--simulations", "6"]
    answer = frenetic(*words, "--out", str(tmp_path / "out"))
    assert answer.code == 0, answer.out
    assert f"starts from {folder}: {COUNT} stretches of {COUNT} real roads" in answer.err
    repeated = frenetic(
        "run", str(tmp_path / "out" / "campaign.toml"), "--out", str(tmp_path / "b")
    )
    assert repeated.code == 0, repeated.out
    with CampaignStore.open(tmp_path / "out") as out, CampaignStore.open(tmp_path / "b") as other:
        assert out.setting.road_class == other.setting.road_class == shown_class(folder)
        assert [test.outcome for test in out.tests()] == [test.outcome for test in other.tests()]
    shown = frenetic("show", str(tmp_path / "out"), "1")
    assert f"given, {folder / 'road0.json'}" in shown.out


def test_unreadable_files_are_named_with_their_reason(
    frenetic: Command, tmp_path: Path, folder: Path
) -> None:
    roads = tmp_path / "roads"
    shutil.copytree(folder, roads)
    (roads / "broken.xodr").write_text("<a/>")
    (roads / "empty.json").write_text("{}")
    answer = frenetic(
        *("run", "--from-roads", str(roads), "--seed", "1", "--simulations", "5"),
        *("--out", str(tmp_path / "out")),
    )
    assert answer.code == 0, answer.err
    assert f"{COUNT} real roads, 2 could not be read" in answer.err
    assert f"left out: {roads / 'broken.xodr'} cannot be read as OpenDRIVE: it is XML" in answer.err
    assert f"left out: {roads / 'empty.json'} has neither 'curvatures'" in answer.err
    for i in range(20):
        (roads / f"more{i:02}.json").write_text("{}")
    search = search_from_roads(tmp_path / "many", roads)
    search.run(1)
    assert search.notes[-1] == "left out: 12 more"
    assert len(search.notes) == 12


def test_real_roads_are_fitted_to_a_class_that_is_named(
    frenetic: Command, tmp_path: Path, folder: Path
) -> None:
    words = ["run", "--from-roads", str(folder), "--roads", "rural-100", "--seed", "1"]
    answer = frenetic(*words, "--simulations", "6", "--out", str(tmp_path / "out"))
    assert answer.code == 0, answer.out
    with CampaignStore.open(tmp_path / "out") as store:
        for test in store.tests():
            assert RoadClass.of("rural-100").breach(test.road) == ""


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--from-roads", "nowhere"], "nowhere"),
        (["--from-roads", ".", "--strategy", "random"], "starts from no earlier campaign or real"),
        (["--from-roads", "empty"], "no road in empty"),
        (["--from-roads", "short"], "50 m"),
    ],
)
def test_folders_without_usable_roads_are_refused(
    frenetic: Command,
    words: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("empty").mkdir()
    Path("short").mkdir()
    Path("short/road.json").write_text(json.dumps({"curvatures": [0.0, 0.0]}))
    Path("road.json").write_text(json.dumps({"curvatures": [0.0] * 20}))
    answer = frenetic("run", *words, "--simulations", "3", "--out", "out")
    assert answer.refuses(message), answer.err
    assert not Path("out").exists()


def test_a_strategy_that_takes_no_roads_is_refused() -> None:
    with pytest.raises(ValueError, match="real road"):
        campaign(Path("out"), strategy=RandomSearch(seed=1), from_roads="roads")
