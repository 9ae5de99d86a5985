"""Functions accept paths as `Path` or text, and lists of paths where they need lists."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from frenetic import (
    Campaign,
    CampaignStore,
    EmbeddedSimulator,
    Frenetic,
    Planner,
    RandomSearch,
    Road,
)
from frenetic.analysis import compare, find_campaigns, measure_campaign
from frenetic.analysis.groups import group_campaigns
from frenetic.campaign import RoadTester, new_folder
from frenetic.errors import FreneticError
from frenetic.export import ExportedRoad, format_of, write_road
from frenetic.plugins.bench import Bench, Entrant, RunTerms, open_bench
from frenetic.plugins.twin.profile import TwinProfile
from frenetic.plugins.twin.recordings import read_recordings
from frenetic.report import draw_road
from frenetic.rerun.junit import write_junit
from frenetic.rerun.rerun import rerun
from frenetic.road.folders import find_roads
from frenetic.spec import Spec
from frenetic.testing import DummyDriver, DummySimulator

ROAD = Road([0.0, 0.01, 0.02, 0.0])


def test_texts_are_paths(tmp_path: Path) -> None:
    folder = str(tmp_path / "one")
    parts = {"simulator": DummySimulator(), "driver": DummyDriver()}
    Campaign(strategy=RandomSearch(seed=1), folder=folder, **parts).run(2)  # type: ignore[arg-type]
    assert find_campaigns(str(tmp_path)) == find_campaigns(folder) == [tmp_path / "one"]
    assert list(group_campaigns([folder]).values()) == [[tmp_path / "one"]]
    assert measure_campaign(folder).folder == tmp_path / "one"
    assert new_folder(str(tmp_path)).parent == tmp_path
    empty_rerun = rerun(folder, DummySimulator(), DummyDriver(), tests=[])
    write_junit(empty_rerun, str(tmp_path / "a.xml"))
    assert len(read_recordings([folder]).drives) == 2
    entrant = Entrant(name="one", spec="m:C", path=folder, copy=folder, python=sys.executable)  # type: ignore[arg-type]
    terms = RunTerms(RoadTester(EmbeddedSimulator(), Planner()), simulations=1)
    bench = Bench(entrants=(entrant,), terms=terms, folder=folder)  # type: ignore[arg-type]
    assert bench.folder == entrant.path == entrant.copy == tmp_path / "one"
    with pytest.raises(FreneticError, match="holds no bench"):
        open_bench(str(tmp_path))
    road = str(tmp_path / "road.xodr")
    write_road(ExportedRoad(ROAD, "road"), format_of(road).name, road)
    assert list(find_roads([road]).roads) == [road]
    draw_road(ROAD, str(tmp_path / "road.png"))
    TwinProfile.of("twin", Spec(driver="stanley", simulator="embedded")).write(
        str(tmp_path / "twin.json")
    )
    assert TwinProfile.read(str(tmp_path / "twin.json")).name == "twin"


def campaign_from(campaigns: Any) -> Campaign:
    return Campaign(
        strategy=Frenetic(seed=1),
        simulator=DummySimulator(),
        driver=DummyDriver(),
        start_from=campaigns,
    )


@pytest.mark.parametrize("single", ["v1", Path("v1"), 3, None])
@pytest.mark.parametrize(
    ("name", "take"),
    [
        ("start_from", campaign_from),
        ("group a", lambda folders: compare({"b": ["v2"], "a": folders})),
        ("folders", group_campaigns),
        ("places", find_roads),
        ("places", read_recordings),
    ],
)
def test_a_single_path_in_place_of_a_list_is_refused(
    name: str, take: Callable[[Any], object], single: object
) -> None:
    shown = {None: "None", 3: "3"}.get(single, "'v1'")  # type: ignore[call-overload]
    example = "" if single is None else rf", such as \[{shown}\]"
    things = "(folders|files and folders)"
    with pytest.raises(
        FreneticError, match=f"^{name} is {shown}: a list of {things} is needed{example}$"
    ):
        take(single)


def test_a_generator_is_accepted_as_a_list(tmp_path: Path) -> None:
    for name in ("one", "two"):
        CampaignStore.create(tmp_path / name, {"seed": 1}).close()
    groups: dict[str, Iterator[Path | str]] = {
        "a": tmp_path.glob("one"),
        "b": (str(path) for path in tmp_path.glob("two")),
    }
    assert compare(groups).groups.keys() == {"a", "b"}
    assert [source.folder for source in campaign_from(iter(["v1", "v2"])).start_from] == [
        "v1",
        "v2",
    ]
