"""Contents of the HTML report of a campaign; `test_html_browser` tests how it looks."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import shlex
import shutil
import sqlite3
from collections.abc import Mapping
from contextlib import closing
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from html_campaigns import HOSTILE, make_empty, make_hostile, make_refused

from frenetic.analysis.clusters import Cluster, Clusters, distinct_failures, nearest_misses
from frenetic.analysis.segments import segments_of
from frenetic.analysis.statistics import proportion_interval
from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.campaign.counts import Counts
from frenetic.campaign.database import DATABASE
from frenetic.cli import cli
from frenetic.drivers import Planner
from frenetic.errors import CampaignError, FreneticError
from frenetic.oracle.assessment import assess
from frenetic.oracle.outcome import Outcome
from frenetic.report.html import (
    Chart,
    DataBlock,
    Facts,
    Paragraph,
    Report,
    Section,
    Series,
    campaign_report,
    render,
    write_report,
)
from frenetic.report.html.configuration import configuration_section
from frenetic.report.html.headline import headline
from frenetic.report.html.reading import Reading
from frenetic.report.html.tests import COLUMNS, TestSummary, drive_columns
from frenetic.report.html.timeline import POINTS, timeline_of
from frenetic.rerun.rerun import rerun
from frenetic.rerun.variations import Variation
from frenetic.road import Road, profile
from frenetic.search import RandomSearch
from frenetic.segments.bends import place_text
from frenetic.segments.features import FEATURES, features_of
from frenetic.simulators import EmbeddedSimulator
from frenetic.spec.terms import Terms

pytest_plugins = ["reported_campaign"]


class Page(HTMLParser):
    """A parsed page: its scripts, its content security policy and all its addresses."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.texts: dict[str, list[str]] = {"script": [], "title": [], "style": [], "": []}
        self.addresses: list[str] = []
        self.policy = ""
        self._open = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        values = dict(attributes)
        self.addresses += [
            str(values[name]) for name in ("src", "href", "action") if name in values
        ]
        if values.get("http-equiv") == "Content-Security-Policy":
            self.policy = values["content"] or ""
        self._open = tag

    def handle_data(self, data: str) -> None:
        self.texts[self._open if self._open in self.texts else ""].append(data)

    def handle_endtag(self, tag: str) -> None:
        self._open = ""

    @property
    def data(self) -> Any:
        return json.loads(self.texts["script"][0])


def page_of(path: Path) -> Page:
    return Page(path.read_text(encoding="utf-8"))


def block_of(data: Any, kind: str) -> Any:
    """Return the only block of a kind in a page's data."""
    (only_block,) = (block for block in data["blocks"] if block["kind"] == kind)
    return only_block


def report_of(folder: Path, **known: Clusters) -> tuple[Report, dict[str, Section]]:
    """Return a campaign's report, and its sections by id."""
    with CampaignStore.open(folder) as store:
        reading = replace(Reading.of(store), **known)  # type: ignore[arg-type]
        report = campaign_report(store, reading=reading)
    return report, {section.id: section for section in report.sections}


def summary_of(number: int, outcome: Outcome, is_random: bool = True) -> TestSummary:
    moobd = {Outcome.PASS: 1.0, Outcome.FAIL: -number / 10.0}.get(outcome)
    return TestSummary(number, outcome, moobd, is_random, {})


def cluster_of(*ids: int) -> Cluster:
    return Cluster(ids, ids[0], ids[0], -1.0, "left", 0.1, "leaves to the left")


# The page


def test_a_page_needs_no_other_file_and_is_the_same_each_time(
    searched: Path, tmp_path: Path
) -> None:
    path = write_report(searched, tmp_path / "r.html")
    page = page_of(path)
    assert all(address.startswith("#") for address in page.addresses)
    assert page.policy.startswith("default-src 'none'; ")
    assert "unsafe-inline" not in page.policy
    allowed = re.findall(r"'sha256-([^']+)'", page.policy)
    for text in (page.texts["script"][1], *page.texts["style"]):
        assert base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() in allowed
    assert path.stat().st_size < 2e6
    second_path = write_report(str(searched), tmp_path / "2.html")
    assert second_path.read_bytes() == path.read_bytes()


def test_no_text_from_outside_becomes_markup(searched: Path, tmp_path: Path) -> None:
    folder = make_hostile(tmp_path, searched)
    page = page_of(write_report(folder))
    assert len(page.texts["script"]) == 2
    assert page.data["drives"][0]["reason"] == HOSTILE
    assert page.data["drives"][0]["origin"].startswith(HOSTILE)
    assert shlex.split(page.data["campaign"]) == [str(folder)]
    text = (folder / "report.html").read_text(encoding="utf-8")
    assert "window.hacked" in text
    assert "<script>window.hacked" not in text
    assert not any("\u2028" in script for script in page.texts["script"])
    page = Page(render(Report(HOSTILE, (Section("a", HOSTILE, ()),))))
    assert (page.texts["title"], len(page.texts["script"])) == ([HOSTILE], 2)


@pytest.mark.parametrize("name", ["", "a b", "x'y", "map", "<b>"])
def test_a_section_id_that_cannot_be_used_is_refused(name: str) -> None:
    sections = (Section("map", "Map", ()), Section(name, "Mine", ()))
    with pytest.raises(ValueError, match="a section's id is"):
        render(Report("x", sections))


def test_a_section_of_the_caller_is_shown(searched: Path, tmp_path: Path) -> None:
    blocks = (
        Paragraph("Two tools."),
        Facts({"tools": "2"}),
        Chart((Series("ours", (1.0, 2.0), (float("nan"), 4.0)),), "runs", "failures"),
    )
    section = Section("bench", "The bench", blocks)
    page = page_of(write_report(searched, tmp_path / "r.html", sections=[section]))
    assert {"The bench", "Two tools.", "tools"} <= set(page.texts[""])
    assert page.data["blocks"][-1]["series"][0]["y"] == [None, 4.0]


# Sections


def test_the_headline_has_the_counts_of_the_campaign(searched: Path) -> None:
    with CampaignStore.open(searched) as store:
        counts = store.counts()
        clusters, worst_clusters = (distinct_failures(store, limit) for limit in (None, 3))
    report, sections = report_of(searched)
    (block,) = sections["summary"].blocks
    assert isinstance(block, DataBlock)
    tiles = {label: (value, note) for label, value, note, _ in block.data["tiles"]}
    assert tiles["simulations"][0] == str(counts.simulations) == "150"
    share = f"{100.0 * counts.failures / counts.simulations:.1f}\u00a0% of simulations"
    assert counts.failing_repeats > 1
    note = f"{share}, and {counts.failing_repeats} repeats"
    assert tiles["failures"] == (str(counts.failed - counts.failing_repeats), note)
    late = sum(cluster.ids[0] > 0.8 * counts.tests for cluster in clusters)
    note = f"{late} of them first seen in the last fifth"
    assert tiles["distinct failures"] == (str(len(clusters)), note)
    assert tiles["causes"][0] == str(len(clusters.causes))
    assert ("invalid roads" in tiles) is (counts.invalid > 0)
    assert report.title.endswith(f" of {len(clusters)} distinct failures in 150 simulations")
    assert block.data["warning"] == ""
    some, _ = report_of(searched, clusters=worst_clusters)
    assert f" of at least {len(worst_clusters)} distinct failure" in some.title


def test_dropped_candidates_count_where_the_headline_names_late_failures(searched: Path) -> None:
    with CampaignStore.open(searched) as store:
        first = distinct_failures(store)[0]
        clusters = Clusters((replace(first, ids=(90,)),), threshold=1.0)
        counts = Counts(passed=99, failed=1, dropped=100)
        tiles = headline(store, clusters, counts).data["tiles"]
    (note,) = (tile.note for tile in tiles if tile.name == "distinct failures")
    assert note == "0 of them first seen in the last fifth"  # test 90 of 200 candidates


def test_the_headline_says_the_conditions_of_all_drives(tmp_path: Path) -> None:
    Campaign(
        strategy=RandomSearch(seed=1),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        terms=Terms(conditions={"noise": 0.2}),
        budget=Budget(simulations=2),
        folder=tmp_path,
    ).run()
    (block,) = report_of(tmp_path)[1]["summary"].blocks
    assert isinstance(block, DataBlock)
    assert block.data["facts"]["conditions"] == "noise 0.2 m"


def test_campaigns_without_results_have_a_report(searched: Path, tmp_path: Path) -> None:
    for make in (make_empty, make_refused):
        folder = make(tmp_path / make.__name__, searched)
        assert page_of(write_report(folder)).data["drives"] == []
        report, sections = report_of(folder)
        assert report.title == "No failure in 0 simulations"
        (block,) = sections["summary"].blocks
        assert isinstance(block, DataBlock)
        assert block.data["warning"].startswith("Not finished")
        assert {role for *_, role in block.data["tiles"]} == {""}  # 0 is no alarm


def test_a_campaign_without_failures_shows_its_nearest_misses(tmp_path: Path) -> None:
    Campaign(
        strategy=RandomSearch(seed=1),
        simulator=EmbeddedSimulator(),
        driver=Planner(aggression=0.2),
        budget=Budget(simulations=40),
        folder=tmp_path / "calm",
    ).run()
    section = report_of(tmp_path / "calm")[1]["failures"]
    assert section.title == "Nearest misses"
    assert section.lead.startswith("No failure was found. ")
    with CampaignStore.open(tmp_path / "calm") as store:
        misses = nearest_misses(store)
    few = Clusters(misses.clusters[:2], misses.threshold)
    for number, known in ((5, {}), (2, {"misses": few})):
        report, sections = report_of(tmp_path / "calm", **known)
        (gallery,) = sections["failures"].blocks
        shown = [item["most_severe"] for item in gallery.data["clusters"]]  # type: ignore[union-attr]
        assert shown == [miss.most_severe for miss in misses][:number]
        outcomes = {drive["id"]: drive["outcome"] for drive in report.data["drives"]}
        assert {outcomes[i] for i in shown} == {"PASS"}


def test_drives_of_the_page_equal_the_stored_drives(searched: Path) -> None:
    data = page_of(searched / "report.html").data
    assert data["resolutions"] == COLUMNS
    close = {"heading": 0.02, "steering": 0.02, "lateral_acceleration": 0.5, "speed": 0.1}
    close |= {"x": 0.25, "y": 0.25, "distance": 0.25, "throttle": 0.1, "brake": 0.1}
    with CampaignStore.open(searched) as store:
        for drive in data["drives"][:20]:
            test = store.test(drive["id"])
            assert test.drive is not None
            path, assessment = test.drive.trajectory, assess(test.road, test.drive)
            n = len(assessment.distance)
            shown = {
                name: step * np.cumsum(np.cumsum(column))
                for (name, step), column in zip(COLUMNS.items(), drive["columns"], strict=True)
            }
            time = shown["time"]
            assert len(time) < n
            assert time[-1] == pytest.approx(path.time[n - 1], abs=0.006)
            assert shown["oob_distance"].min() == pytest.approx(test.moobd, abs=0.006)
            for name, by in close.items():
                stored = assessment.distance if name == "distance" else getattr(path, name)[:n]
                wanted = np.interp(time, path.time[:n], stored)
                assert shown[name] == pytest.approx(wanted, abs=by)
            road = drive["road"]
            read_road = Road(road["curvatures"], road["step"], road["pose"], lane_width=4.0)
            assert np.abs(read_road.points - test.road.points).max() < 0.05


def test_roads_of_a_class_have_their_slopes(sloping: Path, searched: Path) -> None:
    page = page_of(sloping / "report.html")
    with CampaignStore.open(sloping) as store:
        for drive in page.data["drives"]:
            road, shown = store.test(drive["id"]).road, drive["road"]
            assert shown["words"] == road.as_text()
            for name in profile.SHAPES:
                assert shown[name] == pytest.approx(getattr(road, name), abs=1e-5)
    assert "urban-50, 50 km/h" in (sloping / "report.html").read_text(encoding="utf-8")
    for drive in page_of(searched / "report.html").data["drives"]:
        assert not drive["road"].keys() & {*profile.SHAPES}


def test_the_worst_record_of_a_drive_is_kept() -> None:
    road = Road([0.0] * 12)
    drive = EmbeddedSimulator().drive(road, Planner())
    assessment = assess(road, drive)
    for worst in (31, 32, 33):
        oob = np.where(np.arange(len(assessment.distance)) == worst, -1.0, assessment.oob_distance)
        columns = drive_columns(drive.trajectory, replace(assessment, oob_distance=oob))
        shown = dict(zip(COLUMNS, columns, strict=True))["oob_distance"]
        assert 0.01 * np.cumsum(np.cumsum(shown)).min() == pytest.approx(-1.0)


def test_every_cluster_can_be_opened_or_the_page_counts_the_others(
    searched: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with CampaignStore.open(searched) as store:
        clusters = distinct_failures(store)
    report, sections = report_of(searched)
    assert {cluster.most_severe for cluster in clusters} <= {
        drive["id"] for drive in report.data["drives"]
    }
    _, gallery = sections["failures"].blocks
    moobds = {drive["id"]: drive["moobd"] for drive in report.data["drives"]}
    examples = [cause.example for cause in clusters.causes]
    first = [item["shown"][0] for item in gallery.data["clusters"]]  # type: ignore[union-attr]
    assert first[: len(examples)] == examples
    for item in gallery.data["clusters"]:  # type: ignore[union-attr]
        assert item["shown"] == sorted(item["shown"], key=lambda i: (i not in examples, moobds[i]))
    assert any(len(item["shown"]) > 1 for item in gallery.data["clusters"])  # type: ignore[union-attr]
    monkeypatch.setattr("frenetic.report.html.campaign.DRIVES_SIZE", 20_000)
    report, sections = report_of(searched)
    drives = report.data["drives"]
    assert 2 <= len(drives) < 10
    heads = [i for cluster in clusters for i in (cluster.most_severe, cluster.typical)]
    assert [drive["id"] for drive in drives] == list(dict.fromkeys([*examples, *heads]))[
        : len(drives)
    ]
    assert re.search(r"\d+ of \d+ failures can be opened here", sections["failures"].lead)


def test_timeline_ends_with_the_counts_and_continues_the_random_share() -> None:
    tests = [summary_of(i, Outcome.FAIL if i % 4 == 0 else Outcome.PASS) for i in range(1, 21)]
    tests += [summary_of(i, Outcome.INVALID) for i in range(21, 26)]
    tests += [summary_of(i, Outcome.FAIL, False) for i in range(26, 31)]
    tests += [summary_of(31, Outcome.DROPPED, False)]
    clusters = Clusters(
        (cluster_of(4, 8, 26), cluster_of(12, 16, 20, 27), cluster_of(28, 29, 30)), 2.0
    )
    chart = timeline_of(tests, clusters)
    assert chart is not None
    failures, distinct, expected = chart.series
    assert failures.x[-1] == 25
    assert [failures.y[i] for i in (24, -1)] == [5, 10]
    assert [distinct.y[i] for i in (2, 3, 11, 26, 27, -1)] == [0, 1, 2, 2, 3, 3]
    assert (chart.tests[:5], chart.tests[-1]) == ((None, None, None, 4, 4), 30)
    shares = np.array([5 / 20, *proportion_interval(5, 20)])
    last = [expected.y[-1], expected.low[-1], expected.high[-1]]
    assert last == pytest.approx(25 * shares, abs=0.006)
    assert "5 of the 20 random roads" in chart.caption


def test_a_long_timeline_is_thinned_and_one_without_random_roads_expects_nothing() -> None:
    tests = [
        summary_of(i, Outcome.FAIL if i % 10 else Outcome.PASS, False) for i in range(1, 10_001)
    ]
    chart = timeline_of(tests, Clusters((), 2.0))
    assert chart is not None
    failures, _ = chart.series
    assert len(failures.y) == POINTS
    assert (failures.x[0], failures.x[-1], failures.y[-1]) == (1, 10_000, 9000)
    assert "andom" not in chart.caption


def test_map_has_every_test_in_the_cell_of_its_features(searched: Path) -> None:
    block = block_of(page_of(searched / "report.html").data, "featureMap")
    axes = {axis["name"]: axis for axis in block["axes"]}
    assert axes.keys() == FEATURES.keys() - {"length"}
    assert axes["mean_speed"]["unit"] == "km/h"
    with CampaignStore.open(searched) as store:
        segments = segments_of(store, with_repeats=False)
        measured = {record.id: segment for record, segment in segments}
    assert sorted(block["tests"]) == sorted(measured)
    for row, i in enumerate(block["tests"]):
        features = features_of(measured[i])
        for name, axis in axes.items():
            value = features[name] * (3.6 if "speed" in name else 1.0)
            cell = int(axis["bins"][row], 36)
            assert axis["edges"][cell] - 1e-6 <= value <= axis["edges"][cell + 1] + 1e-6


def test_table_has_every_test(searched: Path) -> None:
    table = page_of(searched / "report.html").data["tests"]
    with CampaignStore.open(searched) as store:
        for row, test in enumerate(store.tests()):
            assert table["id"][row] == test.id
            side = test.departure and test.departure.side
            assert (table["outcome"][row], table["side"][row]) == (test.outcome, side)
            if test.outcome.is_driven:
                assert table["length"][row] == pytest.approx(test.road.length, abs=0.5)
                assert table["duration"][row] == pytest.approx(test.result.duration, abs=0.051)


# Reruns and minimised roads in the campaign's folder


@pytest.fixture
def copied(searched: Path, tmp_path: Path) -> tuple[Path, list[int]]:
    """A copy of a campaign, and three of its failures."""
    folder = shutil.copytree(searched, tmp_path / "copied")
    with CampaignStore.open(folder) as store:
        return folder, [test.id for test in store.tests(Outcome.FAIL, limit=3)]


def test_the_most_informative_rerun_of_a_failure_is_shown(copied: tuple[Path, list[int]]) -> None:
    folder, (first, *_) = copied
    slow, grip = [Variation("speed", 30.0, 30.0)], [Variation("friction", 1.0, 1.0)]
    for aggression, variations in ((1.0, slow), (0.9, grip), (1.0, ())):
        driver = Planner(aggression=aggression)
        rerun(folder, EmbeddedSimulator(), driver, tests=[first], times=5, vary=variations)
    (repeats,) = block_of(page_of(write_report(folder)).data, "gallery")["repeats"]
    assert (repeats["test"], repeats["stability"], repeats["share"]) == (first, "fragile", 0.0)
    assert "speed 30 km/h" in repeats["text"]
    for path in folder.glob(f"rerun/*/{DATABASE}"):
        with closing(sqlite3.connect(path)) as database, database:
            database.execute("UPDATE test SET outcome = 'MAYBE'")
    (block,) = report_of(folder)[1]["summary"].blocks
    assert isinstance(block, DataBlock)
    assert "is damaged" in block.data["warning"]


def test_minimised_roads_are_shown(copied: tuple[Path, list[int]]) -> None:
    folder, (first, second, third) = copied
    parts = ("--driver", "planner", "--simulator", "embedded", "--max-drives", "20")
    answer = CliRunner().invoke(cli, ["minimise", str(folder), str(first), *parts])
    assert answer.exit_code == 0
    (folder / "failures").mkdir()
    small, broken, foreign = (f"minimised/test-{i:05d}.json" for i in (first, second, third))
    (folder / broken).write_text("no road")
    (folder / small.replace(".json", "-other.json")).rename(folder / small)
    document = json.loads((folder / small).read_text())
    document["minimised"]["campaign"] = "../../elsewhere"
    (folder / foreign).write_text(json.dumps(document))
    road = f"failures/test-{second:05d}.json"
    (folder / road).write_text("{}")
    drives = {drive["id"]: drive for drive in page_of(write_report(folder)).data["drives"]}
    short = drives[first]["minimised"]
    assert short["file"] == small
    assert len(short["drive"]["road"]["curvatures"]) < len(drives[first]["road"]["curvatures"])
    assert short["drive"]["outcome"] == "FAIL"
    for drive in (drives[first], short["drive"]):
        line, place = drive["road"], drive["departure"]["distance"]
        where = place_text(np.array(line["curvatures"]), line["step"], place)
        assert f" {where}, " in drive["happens"], "the text is about the road in the picture"
    assert (drives[second]["minimised"], drives[third]["minimised"]) == (None, None)
    assert (drives[first]["road_file"], drives[second]["road_file"]) == (None, road)
    document = json.loads((folder / small).read_text())
    document["minimised"]["test"] = "x"
    (folder / small).write_text(json.dumps(document))
    drives = {drive["id"]: drive for drive in page_of(write_report(folder)).data["drives"]}
    assert drives[first]["minimised"] is None


def test_failures_in_other_simulators_are_shown(copied: tuple[Path, list[int]]) -> None:
    folder, failures = copied
    report = rerun(folder, EmbeddedSimulator(friction=0.8), Planner(), tests=failures)
    page = page_of(write_report(folder))
    assert block_of(page.data, "gallery")["elsewhere"] == [
        {
            "test": test.id,
            "where": "embedded,friction=0.8",
            "text": f"{test.verdict}: {test.drives[0].reason}",
        }
        for test in report.tests
    ]
    assert set(failures) <= {drive["id"] for drive in page.data["drives"]}


# Repeating


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({}, "started from Python"),
        ({"workers": 4}, "The same seed gives the same campaign"),
        ({"budget": {"simulations": None, "time": 60}}, "machine's speed"),
    ],
)
def test_the_page_says_whether_a_campaign_can_be_repeated(
    searched: Path, changes: Mapping[str, Any], sentence: str
) -> None:
    with CampaignStore.open(searched) as store:
        config = {**store.config, **changes}
    (paragraph, *_) = configuration_section(searched, config, {}).blocks
    assert isinstance(paragraph, Paragraph)
    assert sentence in paragraph.text


def test_the_command_repeats_the_campaign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    run = ["run", "--simulations", "3", "--seed", "3", "--workers", "1", "--out", "c"]
    assert CliRunner().invoke(cli, run).exit_code == 0
    line = f"frenetic run {Path('c/campaign.toml')}"
    assert line in "".join(page_of(Path("c/report.html")).texts[""])
    assert CliRunner().invoke(cli, [*line.split()[1:], "--out", "again"]).exit_code == 0
    results = []
    for folder in ("c", "again"):
        with CampaignStore.open(folder) as store:
            results.append([test.result for test in store.tests()])
    assert results[0] == results[1]


# Files and the command line


def invoke(*arguments: str) -> Any:
    """Run a command that must succeed."""
    done = CliRunner().invoke(cli, arguments)
    assert done.exit_code == 0, done.output
    return done


def test_a_report_that_cannot_be_written_is_a_one_line_error(
    searched: Path, tmp_path: Path
) -> None:
    (tmp_path / "folder.html").mkdir()
    for place in (tmp_path / "nowhere" / "r.html", tmp_path / "folder.html"):
        with pytest.raises(FreneticError, match=r"^[^\n]* cannot be written: [^\n]*another place"):
            write_report(searched, place)
    with pytest.raises(CampaignError, match="holds no campaign"):
        write_report(tmp_path)


def test_the_report_command_prints_the_path(searched: Path, tmp_path: Path) -> None:
    out = tmp_path / "r.html"
    assert invoke("report", str(searched), "--out", str(out)).stdout == f"Report:      {out}\n"
    assert page_of(out).data["campaign"] == shlex.quote(str(searched))


@pytest.mark.parametrize("is_possible", [True, False])
def test_a_search_writes_a_report_or_keeps_its_results_without_one(
    tmp_path: Path, is_possible: bool
) -> None:
    folder = tmp_path / "c"
    if not is_possible:
        (folder / "report.html").mkdir(parents=True)
    seed = ("--seed", "1", "--workers", "1", "--out", str(folder))
    done = invoke("run", "--simulations", "20", *seed)
    if not is_possible:
        assert "There is no report: " in done.stderr
        assert f"Results:     {folder}" in done.output
        with CampaignStore.open(folder) as store:
            assert store.counts().simulations == 20
        return
    assert f"Report:      {folder / 'report.html'} (in " in done.output
    invoke("resume", str(folder), "--simulations", "10", "--workers", "1")
    assert page_of(folder / "report.html").texts["title"][0].endswith("in 30 simulations")
