"""Screened campaigns: a twin drives many roads, the simulator those that promise most."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from checksums import execute
from contents import contents
from scipy.stats import spearmanr

from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.campaign.check import check_campaign
from frenetic.campaign.screening import Screening, ScreeningSummary, with_screen
from frenetic.errors import CampaignError, FreneticError
from frenetic.outcome import Outcome
from frenetic.profile import Profile, Terms
from frenetic.search.screened import DRAWN, NOTE
from frenetic.spec import EarlierCampaign, Part, Spec

if TYPE_CHECKING:
    from command_line import Frenetic

pytest_plugins = ["command_line"]

TWIN = Profile(
    name="twin",
    driver="planner",
    driver_options={"lateral_acceleration": 7.8, "lookahead_time": 0.33},
    terms=Terms(speed_limit=70.0, oob_tolerance=0.95),
)
SIMULATIONS = 20


def spec_of(folder: Path, strategy: str = "frenetic") -> Spec:
    TWIN.write(folder / "twin.json")
    budget = Budget(simulations=SIMULATIONS)
    spec = Spec(strategy=Part(strategy), seed=3, lookahead=16, budget=budget)
    return with_screen(spec, folder / "twin.json")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    summary = Campaign.of(spec_of(folder), folder=folder / "found", workers=1).run()
    assert summary.tests == summary.simulations == SIMULATIONS  # screened roads are no tests
    return folder / "found"


def test_roads_that_fail_in_the_twin_are_handed_on_and_mostly_fail(whole: Path) -> None:
    with CampaignStore.open(whole) as store:
        summary = ScreeningSummary.of_store(store)
        candidates = [candidate for candidate, _ in store.candidates()]
    assert summary is not None
    asked = summary.handed_on + summary.controls
    assert asked == SIMULATIONS
    assert summary.screened >= DRAWN * summary.handed_on
    assert summary.kept > 0.6 * summary.handed_on
    # A random road fails in one case of ten.
    assert summary.controls == 2
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
    assert Campaign.of(spec, folder=tmp_path / "found", workers=1).run(stop).interrupted
    (tmp_path / "twin.json").unlink()  # the campaign holds it
    with CampaignStore.open(tmp_path / "found") as store:
        recorded = Spec.from_json(store.config, source="campaign")
    assert recorded.screen == spec.screen
    Campaign.of(recorded, folder=tmp_path / "found", workers=1).resume()
    assert contents(tmp_path / "found") == contents(whole)
    assert check_campaign(tmp_path / "found").findings == ()


def test_a_screened_campaign_does_not_depend_on_its_workers(tmp_path: Path, whole: Path) -> None:
    Campaign.of(spec_of(tmp_path), folder=tmp_path / "found", workers=2).run()
    assert contents(tmp_path / "found") == contents(whole)


@pytest.mark.parametrize("notes", ['{"screening": {"role": "boss"}}', "[", "{}"])
def test_a_damaged_screening_is_one_line(tmp_path: Path, whole: Path, notes: str) -> None:
    shutil.copy(whole / "campaign.sqlite", tmp_path)
    execute(tmp_path, "UPDATE test SET notes = ? WHERE id = 2", notes)
    with CampaignStore.open(tmp_path) as store:
        if notes == "{}":
            summary = ScreeningSummary.of_store(store)
            assert summary is not None
            assert summary.unscreened == 1
        else:
            with pytest.raises(CampaignError, match="is damaged: a screening"):
                ScreeningSummary.of_store(store)


def test_the_summary_compares_the_twin_with_the_simulator_on_controls_alone() -> None:
    def driven(role: Any, twin: float, moobd: float | None) -> tuple[Any, Any, Any]:
        outcome = None if moobd is None else Outcome.FAIL if moobd < -1.0 else Outcome.PASS
        screening = Screening(role, 20 if role == "screened" else 0, Outcome.PASS, twin)
        return screening, outcome, moobd

    controls = [driven("control", m, m - 1.0) for m in (-1.5, 1.0, 0.5, -0.5, 0.2)]
    handed_on = [driven("screened", -2.0, m) for m in (1.0, -2.0, None)]
    summary = ScreeningSummary.of([*controls, *handed_on])
    assert (summary.screened, summary.handed_on, summary.kept) == (60, 2, 1)
    assert (summary.controls, summary.controls_failed) == (5, 2)
    assert summary.auc == 1.0
    assert summary.rank_correlation == pytest.approx(1.0)
    doubtful = [*controls, driven("control", 1.0, -3.0), driven("control", 0.2, 0.5)]
    mixed = ScreeningSummary.of(doubtful)
    assert mixed.auc == pytest.approx(8.5 / 12)  # pairs in order, ties by half
    twin, slow = zip(*[(one.moobd, moobd) for one, _, moobd in doubtful], strict=True)
    assert mixed.rank_correlation == pytest.approx(spearmanr(twin, slow).statistic)
    assert not summary.stopped
    misled = ScreeningSummary.of([*controls[:4], (None, Outcome.FAIL, -2.0)])
    assert (misled.auc, misled.rank_correlation) == (None, None)
    assert "1 road came without it" in misled.stopped
    assert misled.in_words().endswith("; stopped")


def test_run_show_and_report_say_what_screening_came_to(frenetic: Frenetic) -> None:
    TWIN.write(Path("twin.json"))
    run = ("run", "--screen", "twin.json", "--seed", "3", "--workers", "1", "--out", "found")
    answer = frenetic(*run, "--simulations", "3", "--json")
    screening = answer.json["screening"]
    assert screening["handed_on"] + screening["controls"] == 3
    shown = frenetic("show", "found")
    said = f"{screening['screened']} roads screened, {screening['handed_on']} handed on"
    assert said in " ".join(shown.out.split())
    assert "twin twin, planner, from twin.json" in shown.out
    assert frenetic("show", "found", "--json").json["screening"] == screening
    assert said in Path("found/report.html").read_text(encoding="utf-8")
    assert "--screen twin.json" in Path("found/report.html").read_text(encoding="utf-8")
    more = frenetic("resume", "found", "--simulations", "2", "--workers", "1", "--json")
    found = more.json["screening"]
    assert found["handed_on"] + found["controls"] == 5


@pytest.mark.parametrize(
    ("options", "entries", "message"),
    [
        (("--speed-limit", "60"), {}, "speed limit 70, not 60"),
        (("--map-size", "150"), {}, "map size 200, not 150"),
        (("--oob-tolerance", "0.5"), {}, "oob tolerance 0.95, not 0.5"),
        (("--strategy", "frenetic-2021"), {}, "frenetic-2021 has no method 'replace'"),
        (("--from", "."), {}, "--screen and --from exclude each other"),
        ((), {"driver": "nobody"}, "nobody"),
        ((), {"driver": "metadrive-idm", "driver_options": {}}, "metadrive"),
        ((), {"driver_options": {"courage": 3}}, "courage"),
        ((), {"terms": {"speed_limit": 70}}, "oob_tolerance"),
    ],
)
def test_a_twin_that_does_not_suit_is_refused_in_a_line(
    frenetic: Frenetic, options: tuple[str, ...], entries: dict[str, Any], message: str
) -> None:
    TWIN.write(Path("twin.json"))
    document = json.loads(Path("twin.json").read_text(encoding="utf-8")) | entries
    Path("twin.json").write_text(json.dumps(document), encoding="utf-8")
    answer = frenetic("run", "--screen", "twin.json", *options, "--out", "found")
    assert answer.refuses(message)
    assert not Path("found").exists()


def test_a_twin_in_python_needs_the_same_lane(tmp_path: Path) -> None:
    replace_terms = replace(spec_of(tmp_path), lane_width=5.0)
    with pytest.raises(Exception, match="lane width 4, not 5"):
        with_screen(replace_terms, tmp_path / "twin.json")


def test_a_screen_and_earlier_campaigns_exclude_each_other(tmp_path: Path) -> None:
    spec = replace(spec_of(tmp_path), start_from=(EarlierCampaign("v1"),))
    with pytest.raises(FreneticError, match="--screen and --from exclude each other"):
        Campaign.of(spec, folder=tmp_path / "found")
