"""Profiles: written and read, refused where they are wrong, and driven with by `--profile`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from frenetic import EmbeddedSimulator, Road, Rules, Stanley, Vehicle
from frenetic.drivers import Delayed
from frenetic.errors import FreneticError
from frenetic.spec import Part, Spec
from frenetic.twin.profile import MAX_BYTES, Profile, Terms

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

TWIN = Profile(
    name="twin",
    driver="stanley",
    driver_options={"aggression": 1.2},
    layers={"delay": 0.05},
    vehicle={"name": "metadrive", "mass": 1300.0},
    terms=Terms(speed_limit=80.0, oob_tolerance=0.85, map_size=210.0, lane_width=4.5),
)
ROAD = [0.0, 0.01, 0.03, 0.05, 0.02, -0.02, -0.04, -0.01, 0.0]


def changed(path: Path, **entries: Any) -> Path:
    """The file of `TWIN` with other entries; None for no such entry."""
    TWIN.write(path)
    document = json.loads(path.read_text(encoding="utf-8")) | entries
    document = {name: value for name, value in document.items() if value is not None}
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


def test_a_profile_is_read_as_it_was_written(tmp_path: Path) -> None:
    TWIN.write(tmp_path / "new" / "twin.json")
    assert Profile.read(tmp_path / "new" / "twin.json") == TWIN


def test_it_drives_as_its_parts_made_by_hand(tmp_path: Path) -> None:
    driver, simulator = TWIN.spec().make_parts(isolate=False)
    by_hand = EmbeddedSimulator(
        vehicle=Vehicle.of({"name": "metadrive", "mass": 1300.0}),
        rules=Rules(speed_limit=80.0, oob_tolerance=0.85),
    )
    road = Road(ROAD, lane_width=4.5)
    found = simulator.drive(road, driver).trajectory.to_rows()
    expected = by_hand.drive(road, Delayed(Stanley(aggression=1.2), seconds=0.05))
    assert (found == expected.trajectory.to_rows()).all()


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"driver": None}, r"missing required field `driver`"),
        ({"driver": 3}, r"Expected `str`, got `int` - at `\$.driver`"),
        ({"versoin": 1}, r"unknown field `versoin`"),
        ({"version": 0}, r"version is 0"),
        ({"version": 99}, r"written by a newer version of frenetic: upgrade"),
        ({"layers": {"haze": 0.1}}, r"there is no layer haze; known: "),
        ({"vehicle": {"frictoin": 0.9}}, r"vehicle has no 'frictoin'; it has: mass, "),
        ({"vehicle": {"mass": "1e3"}}, r"mass of the vehicle is '1e3': a number is needed"),
        ({"vehicle": {"mass": -1.0}}, r"mass is -1.0"),
        ({"terms": {"speed_limit": 0.0, "oob_tolerance": 0.9}}, r"at `\$.terms.speed_limit`"),
    ],
)
def test_what_is_wrong_in_a_profile_is_named(
    tmp_path: Path, entries: dict[str, Any], message: str
) -> None:
    path = changed(tmp_path / "twin.json", **entries)
    with pytest.raises(FreneticError, match=message) as caught:
        Profile.read(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"[]", b"\xff\xfe", b"[" * 10**5, b" " * (MAX_BYTES + 1)])
def test_what_is_no_profile_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "twin.json"
    path.write_bytes(content)
    with pytest.raises(FreneticError, match="is no profile"):
        Profile.read(path)


def test_given_options_lie_over_those_of_the_profile() -> None:
    campaign = Spec(layers={"noise": 0.2}, map_size=300.0, lane_width=5.0)
    over = TWIN.over(campaign, {"driver_options": (("braking", 3.0),), "speed_limit": 60.0})
    assert over.driver == Part("stanley", {"aggression": 1.2, "braking": 3.0})
    assert over.layers == {"delay": 0.05}
    assert (over.rules.speed_limit, over.rules.oob_tolerance) == (60.0, 0.85)
    # The roads are the campaign's.
    assert (over.map_size, over.lane_width) == (300.0, 5.0)
    assert (TWIN.spec().map_size, TWIN.spec().lane_width) == (210.0, 4.5)
    assert TWIN.over(campaign, {"driver": "planner"}).driver == Part("planner")
    assert TWIN.over(campaign, {"driver": "stanley"}).driver == TWIN.spec().driver


def test_a_profile_loads_nobodys_code_unasked(tmp_path: Path) -> None:
    theirs = Profile.read(changed(tmp_path / "twin.json", driver="elsewhere.py:Bold"))
    with pytest.raises(FreneticError, match=r"if you trust it, name it yourself: --driver els"):
        theirs.spec()
    assert theirs.over(Spec(), {"driver": "elsewhere.py:Bold"}).driver.options == {
        "aggression": 1.2
    }


def test_commands_drive_with_a_profile_and_its_campaign_keeps_what_it_says(
    frenetic: Frenetic,
) -> None:
    TWIN.write(Path("twin.json"))
    budget = ("--failures", "1", "--seed", "1", "--workers", "1", "--out", "c")
    assert frenetic("run", "--profile", "twin.json", *budget).code == 0
    Path("twin.json").rename("moved.json")  # the record holds all of it
    (road,) = Path("c/failures").glob("test-*.json")
    recorded = json.loads(road.read_text(encoding="utf-8"))
    assert recorded["lane_width"] == 4.5
    again = frenetic("drive", str(road), "--json").json
    assert again["moobd"] == recorded["moobd"]
    assert again["driver"]["driver"]["options"]["aggression"] == 1.2
    assert again["simulator"]["options"]["vehicle"]["mass"] == 1300.0
    # A plain campaign's failures, by the twin.
    plain = ("--speed-limit", "80", "--failures", "1", "--seed", "1", "--workers", "1")
    assert frenetic("run", *plain, "--out", "p").code == 0
    again = frenetic("rerun", "p", "--profile", "moved.json", "--json").json
    assert "'aggression': 1.2" in str(again)
    wrong = frenetic("rerun", "p", "--profile", "twin.json")
    assert wrong.code == 2
    assert wrong.err.endswith("there is no profile twin.json: 'frenetic calibrate' writes one\n")
