"""Screened campaigns: a twin drives many roads, the simulator those that promise most."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from contents import contents
from events import on_result

from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.campaign.asking import FACTS
from frenetic.campaign.check import check_campaign
from frenetic.errors import CampaignError, FreneticError
from frenetic.outcome import Outcome
from frenetic.spec import Part, Spec
from frenetic.twin.profile import Profile
from frenetic.twin.screened import DRAWN, NOTE

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

TWIN = Profile.of(
    "twin", Spec(driver=Part("planner", {"lateral_acceleration": 7.8, "lookahead_time": 0.33}))
)
SIMULATIONS = 20


def spec_of(folder: Path, strategy: str = "frenetic") -> Spec:
    TWIN.write(folder / "twin.json")
    budget = Budget(simulations=SIMULATIONS)
    options = {"profile": str(folder / "twin.json"), "strategy": strategy}
    return Spec(strategy=Part("screened", options), seed=3, lookahead=16, budget=budget)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    summary = Campaign.of(spec_of(folder), folder=folder / "found", workers=1).run()
    assert summary.tests == summary.simulations == SIMULATIONS  # screened roads are no tests
    return folder / "found"


def test_roads_that_fail_in_the_twin_are_handed_on_and_mostly_fail(whole: Path) -> None:
    with CampaignStore.open(whole) as store:
        facts: Any = store.fact(FACTS)
        candidates = [candidate for candidate, _ in store.candidates()]
    assert facts["screened by"].startswith("twin, planner, from ")
    assert facts["handed on"] + facts["controls"] == SIMULATIONS
    assert facts["roads screened"] >= DRAWN * facts["handed on"]
    assert facts["failed as promised"] > 0.6 * facts["handed on"]
    # A random road fails in one case of ten.
    assert facts["controls"] == 2
    for candidate in candidates:
        note = candidate.notes[NOTE]
        is_control = note["role"] == "control"
        assert (note["drawn"] == 0) == is_control
        assert is_control or note["outcome"] == Outcome.FAIL
        assert (candidate.origin.operator == "screened") != is_control


def test_a_screened_campaign_goes_on_with_the_same_roads(tmp_path: Path, whole: Path) -> None:
    def stop(progress: Any) -> None:
        if progress.simulations == 3:
            raise KeyboardInterrupt

    spec = spec_of(tmp_path)
    first = Campaign.of(spec, folder=tmp_path / "found", workers=1)
    assert first.run(on_event=on_result(stop)).interrupted
    with CampaignStore.open(tmp_path / "found") as store:
        recorded = Spec.from_json(store.config, source="campaign")
    msgspec.structs.replace(TWIN, name="another").write(tmp_path / "twin.json")
    with pytest.raises(CampaignError, match="made with another strategy"):
        Campaign.of(recorded, folder=tmp_path / "found", workers=1).resume()
    TWIN.write(tmp_path / "twin.json")
    # It does not depend on the number of workers either.
    Campaign.of(recorded, folder=tmp_path / "found", workers=2).resume()
    assert contents(tmp_path / "found") == contents(whole)
    assert check_campaign(tmp_path / "found").findings == ()


def test_run_show_and_report_say_what_screening_came_to(frenetic: Frenetic) -> None:
    TWIN.write(Path("twin.json"))
    screened = ("--strategy", "screened,profile=twin.json")
    run = ("run", *screened, "--seed", "3", "--workers", "1", "--out", "found")
    facts = frenetic(*run, "--simulations", "3", "--json").json["facts"]
    assert facts["handed on"] + facts["controls"] == 3
    shown = " ".join(frenetic("show", "found").out.split())
    said = f"roads screened {facts['roads screened']}; handed on {facts['handed on']}"
    assert f"screened by twin, planner, from twin.json; {said}" in shown
    assert frenetic("show", "found", "--json").json["facts"]["search"] == facts
    report = Path("found/report.html").read_text(encoding="utf-8")
    assert said in report
    assert "twin.json" in Path("found/campaign.toml").read_text(encoding="utf-8")
    more = frenetic("resume", "found", "--simulations", "2", "--workers", "1", "--json")
    found = more.json["facts"]
    assert found["handed on"] + found["controls"] == 5


@pytest.mark.parametrize(
    ("options", "entries", "message"),
    [
        (("--speed-limit", "60"), {}, "speed limit 70, not 60"),
        (("--map-size", "150"), {}, "map size 200, not 150"),
        (("--oob-tolerance", "0.5"), {}, "oob tolerance 0.95, not 0.5"),
        (
            ("--strategy", "screened,profile=twin.json,strategy=frenetic-2021"),
            {},
            "frenetic-2021 has no method 'replace'",
        ),
        (("--from", "."), {}, "starts from no earlier campaign"),
        ((), {"driver": "nobody"}, "nobody"),
        ((), {"driver": "metadrive-idm", "driver_options": {}}, "metadrive"),
        ((), {"driver_options": {"courage": 3}}, "courage"),
        ((), {"oob_tolerance": 2}, "oob_tolerance"),
    ],
)
def test_a_twin_that_does_not_suit_is_refused_in_a_line(
    frenetic: Frenetic, options: tuple[str, ...], entries: dict[str, Any], message: str
) -> None:
    TWIN.write(Path("twin.json"))
    document = json.loads(Path("twin.json").read_text(encoding="utf-8"))
    document["driven"] |= entries
    Path("twin.json").write_text(json.dumps(document), encoding="utf-8")
    screened = ("--strategy", "screened,profile=twin.json")
    answer = frenetic("run", *screened, *options, "--out", "found")
    assert answer.refuses(message)
    assert not Path("found").exists()


def test_a_twin_in_python_needs_the_same_lane(tmp_path: Path) -> None:
    with pytest.raises(FreneticError, match="lane width 4, not 5"):
        replace(spec_of(tmp_path), lane_width=5.0).make_strategy()
