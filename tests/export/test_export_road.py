"""`frenetic export` of roads, and drives of the exported files."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import pytest

from frenetic.cli import main
from frenetic.cli.export import ROADS, TABLES
from frenetic.export import FORMATS
from frenetic.export.campaigns import Format


@dataclass
class Answer:
    code: int
    out: str
    err: str


Frenetic = Callable[..., Answer]


@pytest.fixture
def frenetic(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfdbinary: pytest.CaptureFixture[bytes]
) -> Frenetic:
    """Function that runs a command line in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str) -> Answer:
        capfdbinary.readouterr()
        with pytest.raises(SystemExit) as stop:
            main(list(arguments))
        out, err = capfdbinary.readouterr()
        assert isinstance(stop.value.code, int)
        return Answer(stop.value.code, out.decode(), err.decode())

    return call


@pytest.fixture(scope="module")
def searched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("roads") / "c"
    with pytest.raises(SystemExit) as stop:
        main(["run", "--simulations", "40", "--seed", "3", "--out", str(folder)])
    assert stop.value.code == 0
    return folder


@pytest.fixture
def campaign(frenetic: Frenetic, searched: Path) -> Frenetic:
    """Function that runs a command line in a folder with a campaign, c."""
    shutil.copytree(searched, "c")
    return frenetic


def failing_id() -> str:
    document = json.loads(min(Path("c/failures").glob("*.json")).read_text())
    return str(document["id"])


def refused(answer: Answer, *words: str) -> None:
    assert answer.code == 2
    assert answer.out == ""
    (line,) = answer.err.splitlines()
    for word in words:
        assert word in line


def write(name: str, content: object) -> str:
    Path(name).write_text(json.dumps(content))
    return name


def test_the_command_offers_all_formats() -> None:
    assert set(ROADS) == set(FORMATS)
    assert set(TABLES) == set(get_args(Format))


def test_a_failing_road_fails_in_the_same_way_from_every_format(campaign: Frenetic) -> None:
    test_id = failing_id()
    stored = json.loads(Path(f"c/failures/test-{int(test_id):05d}.json").read_text())
    for name in ("opendrive", "json", "competition"):
        answer = campaign("export", "c", test_id, "--format", name)
        assert answer.code == 0
        path = Path(answer.out.strip())
        assert path.parent == Path("c/exports")
        assert path.name == f"test-{int(test_id):05d}{FORMATS[name].suffix}"
        driven = json.loads(campaign("drive", str(path), "--json").out)
        # A competition file holds points, from which the curvatures are recovered.
        tolerance = 1e-3 if name == "competition" else 1e-6
        assert driven["outcome"] == "FAIL"
        assert driven["moobd"] == pytest.approx(stored["moobd"], abs=tolerance)
        assert campaign("drive", str(path), "--dry").code == 0
    document = json.loads(path.read_text())  # the competition's
    assert (document["id"], document["test_outcome"]) == (int(test_id), "FAIL")
    assert document["description"].startswith("Car drove out of the lane ")
    assert document["execution_data"][-1][12] is True  # is_oob


def test_a_road_file_is_written_beside_itself(frenetic: Frenetic) -> None:
    road = write("bend.json", {"curvatures": [0, 0.03, 0]})
    for name, item in FORMATS.items():
        if name != "json":
            answer = frenetic("export", road, "--format", name)
            assert (answer.code, answer.out) == (0, f"bend{item.suffix}\n")
            assert Path(f"bend{item.suffix}").is_file()
    assert frenetic("export", "bend.xodr", "--format", "json", "--out", "b/c.json").code == 0
    assert json.loads(Path("b/c.json").read_text())["curvatures"] == [0.0, 0.03, 0.0]


def test_an_ambiguous_suffix_is_refused(frenetic: Frenetic) -> None:
    road = write("bend.json", {"curvatures": [0, 0.03, 0]})
    answer = frenetic("export", road, "--out", "r.json")
    refused(answer, "r.json does not say", "a format from competition, json, beamng")
    every = "a format from opendrive, competition, csv, json, beamng"
    for name in ("r", "r.txt", "xodr"):
        refused(frenetic("export", road, "--out", name), f"{name} does not say", every)
        assert not Path(name).exists()


def test_the_option_origin_sets_the_place_on_the_globe(frenetic: Frenetic) -> None:
    road = write("bend.json", {"curvatures": [0, 0.03, 0]})
    out = ("--out", "r.xodr")
    assert frenetic("export", road, "--format", "origin=[-33.5,151.25]", *out).code == 0
    assert "+lat_0=-33.5 +lon_0=151.25 " in Path("r.xodr").read_text()
    for origin, message in (("[91,0]", "latitude of -80 to 84"), ("7", "[latitude, longitude]")):
        refused(frenetic("export", road, "--format", f"opendrive,origin={origin}", *out), message)
    refused(frenetic("export", road, "--format", "csv,origin=[1,2]"), "csv has no option 'origin'")


def test_stdout_gets_the_file_and_nothing_else(frenetic: Frenetic) -> None:
    road = write("bend.json", {"curvatures": [0, 0.03, 0]})
    frenetic("export", road, "--format", "opendrive")
    answer = frenetic("export", road, "--format", "opendrive", "--out", "-")
    assert answer.code == 0
    assert answer.out == Path("bend.xodr").read_bytes().decode()
    assert not Path("-").exists()


def test_a_road_is_not_written_over_itself(frenetic: Frenetic) -> None:
    road = write("bend.json", {"curvatures": [0, 0.03, 0], "note": "keep me"})
    before = Path(road).read_bytes()
    refused(frenetic("export", road, "--format", "json"), "bend.json is the road itself")
    refused(
        frenetic("export", road, "--format", "csv", "--out", "./bend.json"),
        "bend.json is the road itself",
    )
    assert Path(road).read_bytes() == before


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("c --format opendrive", "'opendrive' is no format of a camp"),
        ("c 1 --format parquet", "'parquet' is no format of a road"),
        ("c 1 2 --format csv --out r.csv", "--out is for one road"),
        ("c 1 --format csv --outcome FAIL", "--outcome is for a whole"),
        ("c --format csv --out -", "name the ID"),
        ("c 100000 --format csv", "no test of candidate 100000"),
        ("bend.json 1 --format csv", "bend.json is not a folder"),
        ("nowhere.json --format csv", "there is no file nowhere.json"),
        ("nowhere 1 --format csv", "nowhere does not exist"),
        ("bend.json", "Missing option '--format'"),
        ("bend.json --format fbx", "'fbx'"),
        ("bend.json --format csv,a", "'a' is not OPTION=VALUE"),
        ("bend.json --format csv --out c", "c cannot be written"),
    ],
)
def test_mistakes_are_refused(campaign: Frenetic, words: str, message: str) -> None:
    write("bend.json", {"curvatures": [0, 0.03, 0]})
    refused(campaign("export", *words.split()), message)
    assert not Path("c/exports").exists()


def test_the_option_lane_chooses_a_lane_of_an_opendrive_file(frenetic: Frenetic) -> None:
    lanes = "".join(
        f'<lane id="-{i}" type="driving"><width sOffset="0" a="3.5"/></lane>' for i in (1, 2)
    )
    Path("lanes.xodr").write_text(
        '<OpenDRIVE><header revMajor="1" revMinor="6"/><road length="60" id="1" junction="-1">'
        '<planView><geometry s="0" x="0" y="0" hdg="0" length="60"><line/></geometry></planView>'
        f'<lanes><laneSection s="0"><right>{lanes}</right></laneSection></lanes></road></OpenDRIVE>'
    )
    exported = ("export", "lanes.xodr", "--format", "json", "--out", "-")
    assert json.loads(frenetic(*exported, "--lane", "-2").out)["pose"][1] == pytest.approx(-3.5)
    assert frenetic("drive", "lanes.xodr", "--lane", "-2", "--dry").code == 0
    refused(frenetic("drive", "lanes.xodr", "--lane", "-3"), "lane -3", "is missing", "-1, -2")
