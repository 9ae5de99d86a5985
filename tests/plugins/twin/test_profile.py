"""Profiles of twins: reading, writing, errors in them, and driving with `--as`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from frenetic import EmbeddedSimulator, Road, Rules, Stanley, Vehicle
from frenetic._support.files import MAX_BYTES
from frenetic.campaign import RoadTester
from frenetic.cli.command_options import CommandOptions
from frenetic.drivers import Delayed
from frenetic.errors import FreneticError
from frenetic.plugins.twin.profile import TwinProfile
from frenetic.spec import Spec

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

TWIN = TwinProfile.of(
    "twin",
    Spec(
        driver="stanley,aggression=1.2",
        conditions={"delay": 0.05},
        simulator='embedded,vehicle={"name":"metadrive","mass":1300.0}',
        speed_limit=80.0,
        oob_tolerance=0.85,
        map_size=210.0,
        lane_width=4.5,
    ),
)
ROAD = [0.0, 0.01, 0.03, 0.05, 0.02, -0.02, -0.04, -0.01, 0.0]


def write_changed(path: Path, driven: dict[str, Any], **entries: Any) -> Path:
    """Write `TWIN` with other entries, also in ``driven``; the value None removes an entry."""
    TWIN.write(path)
    document = json.loads(path.read_text(encoding="utf-8")) | entries
    driven_entries = document["driven"] | driven
    document["driven"] = {
        name: value for name, value in driven_entries.items() if value is not None
    }
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


def test_a_profile_reads_as_written_and_drives_like_parts_made_by_hand(tmp_path: Path) -> None:
    TWIN.write(tmp_path / "new" / "twin.json")
    profile = TwinProfile.read(tmp_path / "new" / "twin.json")
    assert profile == TWIN
    tester = RoadTester.of(profile.spec())
    by_hand = EmbeddedSimulator(
        vehicle=Vehicle.of({"name": "metadrive", "mass": 1300.0}),
        rules=Rules(speed_limit=80.0, oob_tolerance=0.85, road_limits="ignored"),
    )
    road = Road(ROAD, lane_width=4.5)
    drive = tester.drive(road)
    expected = by_hand.drive(road, Delayed(Stanley(aggression=1.2), seconds=0.05))
    assert (drive.trajectory.to_rows() == expected.trajectory.to_rows()).all()
    assert drive.rules == expected.rules


@pytest.mark.parametrize(
    ("driven", "entries", "message"),
    [
        ({"driver": None}, {}, r"it has no driver"),
        ({"driver": 3}, {}, r"driver is 3: a text is needed"),
        ({}, {"versoin": 1}, r"unknown field `versoin`"),
        ({}, {"version": 99}, r"at `\$.version`"),
        ({"haze": 0.1}, {}, r"there is no entry .haze."),
        ({"with": {"haze": 0.1}}, {}, r"unknown condition 'haze'"),
        ({"roads": "urban-51"}, {}, r"there is no road class 'urban-51'"),
        ({"speed_limit": 0.0}, {}, r"speed_limit is 0.0: a number > 0 is needed"),
    ],
)
def test_an_error_in_a_profile_names_the_entry(
    tmp_path: Path, driven: dict[str, Any], entries: dict[str, Any], message: str
) -> None:
    path = write_changed(tmp_path / "twin.json", driven, **entries)
    with pytest.raises(FreneticError, match=message) as caught:
        TwinProfile.read(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"[]", b"\xff\xfe", b"[" * 10**5, b" " * (MAX_BYTES + 1)])
def test_a_file_that_is_no_profile_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "twin.json"
    path.write_bytes(content)
    with pytest.raises(FreneticError, match=r"does not say how roads are driven|too large"):
        TwinProfile.read(path)


def test_options_override_the_profile(tmp_path: Path) -> None:
    TWIN.write(tmp_path / "twin.json")
    campaign = Spec(conditions={"noise": 0.2}, map_size=300.0, lane_width=5.0)

    def over(roads_are_given: bool = True, **entries: Any) -> Spec:
        options = CommandOptions(Spec(**entries), tmp_path / "twin.json")
        return options.over(campaign, roads_are_given=roads_are_given)

    spec = over(driver="braking=3.0", speed_limit=60.0)
    assert spec.driver == "stanley,aggression=1.2,braking=3.0"
    assert spec.conditions == {"delay": 0.05}
    assert (spec.rules.speed_limit, spec.rules.oob_tolerance) == (60.0, 0.85)
    # The roads are the campaign's.
    assert (spec.map_size, spec.lane_width) == (300.0, 5.0)
    anew = over(roads_are_given=False)
    assert (anew.map_size, anew.lane_width) == (210.0, 4.5)
    assert over(driver="planner").driver == "planner"
    assert over(driver="stanley").driver == TWIN.spec().driver


def test_a_profile_loads_code_only_if_trusted(tmp_path: Path) -> None:
    path = write_changed(tmp_path / "twin.json", {"driver": "elsewhere.py:Bold,aggression=1.2"})
    with pytest.raises(FreneticError, match=r"'elsewhere\.py:Bold', code that you have not trust"):
        TwinProfile.read(path).spec()


def test_a_campaign_stores_the_profile_with_which_it_was_driven(
    frenetic: Frenetic,
) -> None:
    TWIN.write(Path("twin.json"))
    budget = ("--failures", "1", "--seed", "1", "--workers", "1", "--out", "c")
    assert frenetic("run", "--as", "twin.json", *budget).code == 0
    Path("twin.json").rename("moved.json")  # the campaign's record holds the whole profile
    (road,) = Path("c/failures").glob("test-*.json")
    recorded = json.loads(road.read_text(encoding="utf-8"))
    assert recorded["lane_width"] == 4.5
    answer = frenetic("drive", str(road), "--json").json
    assert answer["moobd"] == recorded["moobd"]
    assert answer["driver"]["options"]["aggression"] == 1.2
    assert answer["conditions"] == {"delay": 0.05}
    assert answer["simulator"]["options"]["vehicle"]["mass"] == 1300.0
    answer = frenetic("rerun", "c", "--as", "moved.json", "--driver", "aggression=1.1", "--json")
    assert "'aggression': 1.1" in str(answer.json)
    assert frenetic("rerun", "c", "--as", "twin.json").refuses("there is no file twin.json")
    # A failing road's file holds the profile, too.
    as_road = ("--as", str(road), "--simulations", "2", "--seed", "1", "--workers", "1")
    assert frenetic("run", *as_road, "--out", "r", "--json").json["simulations"] == 2
    shown = frenetic("show", "r", "--json").json["config"]
    assert (shown["lane_width"], shown["spec"]["driver"]) == (4.5, "stanley,aggression=1.2")
