from __future__ import annotations

import base64
import hashlib
import json
import re
import shlex
import shutil
import sqlite3
from contextlib import closing
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from html_campaigns import HOSTILE, make_empty, make_hostile, make_refused, make_searched

from frenetic.again.conditions import Variation
from frenetic.again.rerun import rerun
from frenetic.analysis.failures import Cluster, Clusters, distinct_failures, nearest_misses
from frenetic.analysis.features import FEATURES, features_of
from frenetic.analysis.segments import segments_of
from frenetic.analysis.statistics import proportion_interval
from frenetic.campaign import Budget, Campaign, CampaignStore
from frenetic.campaign.database import DATABASE
from frenetic.cli import cli
from frenetic.drivers import Planner
from frenetic.errors import CampaignError, FreneticError
from frenetic.oracle import assess
from frenetic.outcome import Outcome
from frenetic.report.html import (
    Chart,
    Fact,
    Facts,
    Paragraph,
    Report,
    Section,
    Series,
    Table,
    campaign_report,
    render,
    write_report,
)
from frenetic.report.html.blocks import to_json
from frenetic.report.html.headline import headline as tell
from frenetic.report.html.operators import operator_results, operators_section
from frenetic.report.html.repeating import repeat_command, repeatability
from frenetic.report.html.tests import RoadData, TestSummary, TestTable
from frenetic.report.html.timeline import POINTS, timeline_of
from frenetic.road import Road
from frenetic.search import Origin, RandomSearch, variation
from frenetic.search.operators import DOES, FAIL_OPERATORS, PASS_OPERATORS
from frenetic.simulators import EmbeddedSimulator


@pytest.fixture(scope="session")
def searched(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_searched(tmp_path_factory.mktemp("html") / "searched")


class Page(HTMLParser):
    """The scripts of a page, its policy, and all addresses in it."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.scripts: list[tuple[str, str]] = []
        self.addresses: list[str] = []
        self.policy = ""
        self.title = ""
        self.style = ""
        self.text = ""
        self._open = ""
        self._type = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        given = dict(attributes)
        self.addresses += [str(given[name]) for name in ("src", "href", "action") if name in given]
        if given.get("http-equiv") == "Content-Security-Policy":
            self.policy = given["content"] or ""
        self._open, self._type = tag, given.get("type") or ""
        if tag == "script":
            self.scripts.append((self._type, ""))

    def handle_data(self, data: str) -> None:
        if self._open == "script":
            self.scripts[-1] = (self._type, self.scripts[-1][1] + data)
        elif self._open == "title":
            self.title += data
        elif self._open == "style":
            self.style += data
        else:
            self.text += data

    def handle_endtag(self, tag: str) -> None:
        self._open = ""

    @property
    def data(self) -> Any:
        (text,) = (text for kind, text in self.scripts if kind == "application/json")
        return json.loads(text)


def page_of(path: Path) -> Page:
    return Page(path.read_text(encoding="utf-8"))


def block_of(data: Any, kind: str) -> Any:
    (found,) = (block for block in data["blocks"] if block["kind"] == kind)
    return found


def section_of(report: Report, name: str) -> Section:
    (section,) = (section for section in report.sections if section.id == name)
    return section


def headline_of(folder: Path) -> Any:
    with CampaignStore.open(folder) as store:
        (block,) = campaign_report(store).sections[0].blocks
    return block


def told(number: int, outcome: Outcome, operator: str = "random", *parents: int) -> TestSummary:
    moobd = {Outcome.PASS: 1.0, Outcome.FAIL: -number / 10.0}.get(outcome)
    return TestSummary(number, outcome, moobd, float(number), Origin(operator, parents))


def alike(*ids: int) -> Cluster:
    return Cluster(ids, ids[0], ids[0], -1.0, "left", 0.1, "leaves to the left")


# The page


def test_page_needs_nothing_else_and_may_load_nothing(searched: Path, tmp_path: Path) -> None:
    path = write_report(searched, tmp_path / "r.html")
    page = page_of(path)
    assert all(address.startswith("#") for address in page.addresses)
    assert page.policy.startswith("default-src 'none'; ")
    allowed = re.findall(r"'sha256-([^']+)'", page.policy)
    (script,) = [text for kind, text in page.scripts if kind != "application/json"]
    for text in (script, page.style):
        assert base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() in allowed
    assert "unsafe-inline" not in page.policy
    assert path.stat().st_size < 2e6


def test_same_campaign_gives_the_same_page(searched: Path, tmp_path: Path) -> None:
    first = write_report(searched, tmp_path / "1.html").read_bytes()
    assert write_report(str(searched), tmp_path / "2.html").read_bytes() == first


def test_no_text_from_outside_becomes_markup(searched: Path, tmp_path: Path) -> None:
    folder = make_hostile(tmp_path, searched)
    page = page_of(write_report(folder))
    assert len(page.scripts) == 2
    assert page.data["drives"][0]["reason"] == HOSTILE
    assert page.data["tests"]["operators"] == [HOSTILE]
    assert shlex.split(page.data["campaign"]) == [str(folder)]
    text = (folder / "report.html").read_text(encoding="utf-8")
    assert "window.hacked" in text
    assert "<script>window.hacked" not in text
    assert not any("\u2028" in script for _, script in page.scripts)


def test_of_failures_that_are_not_compared_the_title_says_that_there_may_be_more(
    searched: Path,
) -> None:
    with CampaignStore.open(searched) as store:
        every, few = (distinct_failures(store, limit) for limit in (None, 3))
        titles = [campaign_report(store, clusters=one).title for one in (every, few)]
    assert titles[0].startswith(f"{len(every)} distinct failures in ")
    assert titles[1].startswith(f"At least {len(few)} distinct failure")


def test_title_is_escaped() -> None:
    page = Page(render(Report(title=HOSTILE, sections=(Section("a", HOSTILE, ()),))))
    assert page.title == HOSTILE
    assert len(page.scripts) == 2


# What it says


def test_headline_counts_what_the_campaign_holds(searched: Path) -> None:
    with CampaignStore.open(searched) as store:
        counts = store.counts()
        clusters = distinct_failures(store)
        slow = {"seconds": 3600.0 * counts.tests / 4.3}
        rate = tell(store.config, slow, counts, clusters, folder="", elapsed=0.0).tiles[0].note
        report = campaign_report(store)
    assert rate == "4.3 tests/h"
    headline = headline_of(searched)
    tiles = {tile.label: tile.value for tile in headline.tiles}
    assert tiles["simulations"] == str(counts.simulations) == "150"
    assert tiles["failures"] == str(counts.by_outcome[Outcome.FAIL])
    assert tiles["distinct failures"] == str(len(clusters))
    assert tiles["invalid roads"] == str(counts.by_outcome[Outcome.INVALID])
    assert report.title == f"{len(clusters)} distinct failures in 150 simulations"
    assert headline.warning == ""


def test_a_campaign_without_failures_shows_its_nearest_misses(tmp_path: Path) -> None:
    Campaign(
        strategy=RandomSearch(seed=1),
        simulator=EmbeddedSimulator(),
        driver=Planner(aggression=0.2),
        budget=Budget(simulations=40),
        folder=tmp_path / "calm",
    ).run()
    data = page_of(write_report(tmp_path / "calm")).data
    with CampaignStore.open(tmp_path / "calm") as store:
        section = section_of(campaign_report(store), "failures")
    assert section.title == "Nearest misses"
    assert section.lead.startswith("No failure was found. ")
    with CampaignStore.open(tmp_path / "calm") as store:
        assert store.counts().by_outcome[Outcome.FAIL] == 0
        misses = nearest_misses(store)
        few = Clusters(misses.clusters[:2], misses.threshold)
        of_few = page_of(write_report(store, tmp_path / "few.html", misses=few)).data
    given = [one["most_severe"] for one in block_of(of_few, "gallery")["clusters"]]
    assert given == [one.most_severe for one in few]
    shown = [one["most_severe"] for one in block_of(data, "gallery")["clusters"]]
    assert len(shown) == 5
    assert shown == [one.most_severe for one in misses]
    drives = {drive["id"]: drive for drive in data["drives"]}
    assert all(drives[number]["outcome"] == "PASS" for number in shown)


def test_drives_come_back_as_they_were_stored(searched: Path, tmp_path: Path) -> None:
    data = page_of(write_report(searched, tmp_path / "r.html")).data
    steps = (0.01, 0.01, 0.01, 0.001, 0.01, 0.01, 0.01, 0.001, 0.01, 0.01, 0.01)
    with CampaignStore.open(searched) as store:
        for drive in data["drives"][:20]:
            test = store.test(drive["id"])
            assert test.drive is not None
            path, seen = test.drive.trajectory, assess(test.road, test.drive)
            n = len(seen.distance)
            time, x, y, heading, distance, oob, speed, steering, lateral, throttle, brake = (
                step * np.cumsum(np.cumsum(column))
                for step, column in zip(steps, drive["columns"], strict=True)
            )
            assert len(time) < n
            assert time[-1] == pytest.approx(path.time[n - 1], abs=0.006)
            assert oob.min() == pytest.approx(test.moobd, abs=0.006)
            for column, original, close in (
                (x, path.x, 0.25),
                (y, path.y, 0.25),
                (heading, path.heading, 0.02),
                (distance, seen.distance, 0.25),
                (speed, path.speed, 0.1),
                (steering, path.steering, 0.02),
                (lateral, path.lateral_acceleration, 0.5),
                (throttle, path.throttle, 0.1),
                (brake, path.brake, 0.1),
            ):
                assert column == pytest.approx(np.interp(time, path.time, original), abs=close)
            road = RoadData(**drive["road"])
            again = Road(road.curvatures, road.step, road.pose, lane_width=4.0)
            assert np.abs(again.points - test.road.points).max() < 0.05


def test_every_cluster_can_be_opened(searched: Path) -> None:
    with CampaignStore.open(searched) as store:
        clusters = distinct_failures(store)
        report = campaign_report(store, clusters=clusters)
    opened = {drive.id for drive in report.drives}
    assert {cluster.most_severe for cluster in clusters} <= opened


def test_few_drives_are_shown_where_there_is_little_room(
    searched: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("frenetic.report.html.campaign.DRIVES_SIZE", 20_000)
    with CampaignStore.open(searched) as store:
        report = campaign_report(store)
        worst = distinct_failures(store)[0].most_severe
    assert 2 <= len(report.drives) < 10
    assert report.drives[0].id == worst
    gallery = next(section for section in report.sections if section.id == "failures")
    assert re.search(r"\d+ of \d+ failures can be opened here", gallery.lead)


def test_timeline_ends_with_the_counts_and_continues_the_random_share() -> None:
    tests = [told(i, Outcome.FAIL if i % 4 == 0 else Outcome.PASS) for i in range(1, 21)]
    tests += [told(i, Outcome.INVALID) for i in range(21, 26)]
    tests += [told(i, Outcome.FAIL, "C1", 4) for i in range(26, 31)]
    tests += [told(31, Outcome.DROPPED, "C1", 4)]
    clusters = Clusters((alike(4, 8, 26), alike(12, 16, 20, 27), alike(28, 29, 30)), 2.0)
    timeline = timeline_of(tests, clusters)
    assert timeline is not None
    assert timeline.failures[[24, -1]].tolist() == [5, 10]
    assert timeline.distinct[[2, 3, 11, 26, 27, -1]].tolist() == [0, 1, 2, 2, 3, 3]
    assert timeline.latest[-1] == 30
    simulations, number, time = timeline.axes
    assert [axis.x[-1] for axis in timeline.axes] == [25, 30, 30.0]
    assert simulations.expected is not None
    assert number.expected is not None
    assert time.expected is simulations.expected
    shares = [5 / 20, *proportion_interval(5, 20)]
    assert simulations.expected.failures[:, -1] == pytest.approx(25 * np.array(shares))
    assert number.expected.failures[0, -1] == pytest.approx(30 * 5 / 25)
    # The random roads found two of the three distinct failures, in two and three roads.
    assert simulations.expected.distinct[0, 19] == pytest.approx(2.0)
    assert simulations.expected.distinct[0, -1] >= 2.0
    assert "failed (25.0\u00a0%), 2 distinct failures" in timeline.caption
    assert "5 of the 20 random roads" in timeline.caption
    charts = list(timeline.charts())
    assert [chart.name for chart in charts] == ["simulations", "tests", "wall time"]
    assert [line.name for line in charts[0].series[:2]] == ["failures", "distinct failures"]
    assert len(charts[0].series) == 4


def test_timeline_of_a_long_campaign_is_thinned_but_keeps_its_ends() -> None:
    tests = [told(i, Outcome.FAIL if i % 10 == 0 else Outcome.PASS) for i in range(1, 10_001)]
    timeline = timeline_of(tests, Clusters((), 2.0))
    assert timeline is not None
    assert len(timeline.failures) == POINTS
    assert timeline.axes[0].x[[0, -1]].tolist() == [1, 10_000]
    assert timeline.failures[-1] == 1000


@pytest.mark.parametrize(
    ("seconds", "title", "last"),
    [
        (100.0, "wall time (s)", 100.0),
        (600.0, "wall time (min)", 10.0),
        (36e3, "wall time (h)", 10),
    ],
)
def test_wall_time_has_a_unit_that_suits_it(seconds: float, title: str, last: float) -> None:
    tests = [
        TestSummary(i, Outcome.PASS, 1.0, seconds * i / 10, Origin("random")) for i in range(1, 11)
    ]
    timeline = timeline_of(tests, Clusters((), 2.0))
    assert timeline is not None
    assert (timeline.axes[-1].title, timeline.axes[-1].x[-1]) == (title, last)


def test_timeline_without_random_roads_or_times_says_so() -> None:
    tests = [TestSummary(1, Outcome.FAIL, -1.0, None, Origin("mine"))]
    timeline = timeline_of(tests, Clusters((alike(1),), 2.0))
    assert timeline is not None
    assert [axis.name for axis in timeline.axes] == ["simulations", "tests"]
    assert timeline.axes[0].expected is None
    assert "no random expectation" in timeline.caption
    (chart, _) = timeline.charts()
    assert chart.series[0].width > chart.series[1].width  # one line lies on the other


def test_operators_are_counted_by_hand() -> None:
    tests = [
        told(1, Outcome.PASS),
        told(2, Outcome.FAIL),
        told(3, Outcome.FAIL, "C1", 1, 2),  # -0.3, from -0.2 and 1.0
        told(4, Outcome.INVALID, "C1", 1),
        told(5, Outcome.PASS, "P1", 1),
        told(6, Outcome.FAIL, "P1", 3),  # -0.6, from -0.3
        told(7, Outcome.DROPPED, "F1", 3),
    ]
    clusters = Clusters((alike(2, 3), alike(6)), 2.0)
    random, crossed, mutated = operator_results(tests, clusters)
    assert (random.name, random.tests, random.failures, random.change) == ("random", 2, 1, None)
    assert (crossed.tests, crossed.driven, crossed.failures, crossed.share) == (2, 1, 1, 1.0)
    assert (crossed.distinct, crossed.first) == (1, 0)
    assert (random.distinct, random.first) == (1, 1)
    assert (mutated.distinct, mutated.first) == (1, 1)
    assert crossed.change == pytest.approx(-0.1)
    assert mutated.change == pytest.approx((0.0 - 0.3) / 2)
    assert mutated.interval == proportion_interval(1, 2)


def test_every_operator_is_explained(searched: Path) -> None:
    listing_1 = {*PASS_OPERATORS, *FAIL_OPERATORS, "C1", "C2"}
    others = {"random", "earlier", "screened"}
    assert {*others, *listing_1, *variation.OPERATORS} == DOES.keys()
    with CampaignStore.open(searched) as store:
        report = campaign_report(store)
    assert report.tests is not None
    assert report.tests.operators_do == tuple(DOES[name] for name in report.tests.operators)
    (section,) = (section for section in report.sections if section.id == "operators")
    (table,) = (block for block in section.blocks if isinstance(block, Table))
    assert [row[1] for row in table.rows] == [DOES[row[0]] for row in table.rows]
    strange = operators_section([told(1, Outcome.FAIL, "mine")], Clusters((), 2.0))
    assert strange.lead == "Which operators of the strategy paid off."


def test_map_has_every_test_in_the_cell_of_its_features(searched: Path, tmp_path: Path) -> None:
    block = block_of(page_of(write_report(searched, tmp_path / "r.html")).data, "featureMap")
    axes = {axis["name"]: axis for axis in block["axes"]}
    assert axes.keys() == FEATURES.keys()
    assert axes["mean_speed"]["unit"] == "km/h"
    with CampaignStore.open(searched) as store:
        measured = {record.id: segment for record, segment in segments_of(store)}
    assert sorted(block["tests"]) == sorted(measured)
    for row, i in enumerate(block["tests"]):
        for name, feature in FEATURES.items():
            for scope, segment in (("segment", measured[i]), ("whole", measured[i].whole())):
                axis = axes[name][scope]
                value = feature.of(features_of(segment)) * (3.6 if "speed" in name else 1.0)
                cell = int(axis["bins"][row], 36)
                assert axis["edges"][cell] - 1e-6 <= value <= axis["edges"][cell + 1] + 1e-6


def test_table_keeps_what_it_was_made_of() -> None:
    table = TestTable.of(
        [told(1, Outcome.PASS), told(2, Outcome.INVALID), told(5, Outcome.FAIL, "F1", 1)]
    )
    assert table.ids == (1, 2, 5)
    assert table.outcomes == "PIF"
    assert table.moobds == (100, None, -50)
    assert [table.operators[i] for i in table.operator] == ["random", "random", "F1"]
    assert table.parents == ((), (), (1,))
    assert (table.sides, table.lengths, table.durations) == ("---", (0, 0, 0), (None, None, None))


def copied(searched: Path, folder: Path) -> tuple[Path, list[int]]:
    """A copy of a campaign, and three of its failures."""
    shutil.copytree(searched, folder)
    with CampaignStore.open(folder) as store:
        return folder, [test.id for test in store.tests(Outcome.FAIL, limit=3)]


def test_the_telling_rerun_of_a_failure_is_shown(searched: Path, tmp_path: Path) -> None:
    folder, (first, *_) = copied(searched, tmp_path / "c")
    slow, grip = [Variation("speed", 30.0, 30.0)], [Variation("friction", 1.0, 1.0)]
    for aggression, variations in ((1.0, slow), (0.9, grip), (1.0, ())):
        driver = Planner(aggression=aggression)
        rerun(folder, EmbeddedSimulator(), driver, tests=[first], times=5, vary=variations)
    (repeats,) = block_of(page_of(write_report(folder)).data, "gallery")["repeats"]
    assert (repeats["test"], repeats["stability"], repeats["share"]) == (first, "fragile", 0.0)
    assert "speed 30 km/h" in repeats["text"]


def test_minimised_roads_are_shown(searched: Path, tmp_path: Path) -> None:
    folder, (first, second, _) = copied(searched, tmp_path / "c")
    for name in ("minimised", "failures"):
        (folder / name).mkdir()
    small, broken = (f"minimised/test-{number:05d}.json" for number in (first, second))
    (folder / small).write_text('{"curvatures": [0, 0.05, 0]}')
    (folder / broken).write_text("no road")
    road = f"failures/test-{second:05d}.json"
    (folder / road).write_text("{}")
    drives = {one["id"]: one for one in page_of(write_report(folder)).data["drives"]}
    assert drives[first]["minimised"]["road"]["curvatures"] == [0.0, 0.05, 0.0]
    assert drives[first]["minimised"]["file"] == small
    assert drives[second]["minimised"] is None
    assert (drives[first]["road_file"], drives[second]["road_file"]) == (None, road)


def test_damaged_reruns_are_mentioned_and_do_no_harm(searched: Path, tmp_path: Path) -> None:
    folder, failures = copied(searched, tmp_path / "c")
    rerun(folder, EmbeddedSimulator(), Planner(), tests=failures, times=2)
    spoil(folder)
    assert "is damaged" in headline_of(folder).warning


def spoil(folder: Path) -> None:
    """Damages what drove a campaign's roads again."""
    (again,) = folder.glob(f"again/*/{DATABASE}")
    with closing(sqlite3.connect(again)) as database, database:
        database.execute("UPDATE test SET outcome = 'MAYBE'")


def test_failures_in_other_simulators_are_shown(searched: Path, tmp_path: Path) -> None:
    folder, failures = copied(searched, tmp_path / "c")
    there = rerun(folder, EmbeddedSimulator(friction=0.8), Planner(), tests=failures)
    with CampaignStore.open(folder) as store:
        report = campaign_report(store)
    text, table, pictures = section_of(report, "elsewhere").blocks
    assert isinstance(text, Paragraph)
    told = "planner in embedded, friction 0.8: 3 fail again (3 elsewhere)."
    assert text.text.startswith(told)
    assert isinstance(table, Table)
    assert [row[0] for row in table.rows] == [str(number) for number in failures]
    assert table.links == tuple(f"#test-{number}" for number in failures)
    data = block_of(page_of(write_report(folder)).data, "elsewhere")
    assert data == json.loads(json.dumps(to_json(pictures)))
    assert (data["here"], data["there"]) == ("embedded", "embedded, friction 0.8")
    for one, shown in zip(there.tests, data["drives"], strict=True):
        assert (shown["test"], shown["agreement"]) == (one.id, one.verdict)
        trajectory = one.drives[0].test.trajectory
        assert trajectory is not None
        x = 0.01 * np.cumsum(np.cumsum(shown["columns"][1]))
        assert x[0] == pytest.approx(trajectory.x[0], abs=0.006)
    assert set(failures) <= {drive.id for drive in report.drives}


def test_campaigns_without_results_have_a_report(searched: Path, tmp_path: Path) -> None:
    for make in (make_empty, make_refused):
        folder = make(tmp_path / make.__name__, searched)
        assert page_of(write_report(folder)).data["drives"] == []
        headline = headline_of(folder)
        assert headline.title == "No failure in 0 simulations"
        assert headline.warning.startswith("Not finished")
        assert {tile.role for tile in headline.tiles} == {None}  # 0 is no alarm


# Sections of one's own


def test_a_section_of_ones_own_is_shown(searched: Path, tmp_path: Path) -> None:
    section = Section(
        "bench",
        "The bench",
        (
            Paragraph("Two tools."),
            Facts((Fact("tools", "2"),)),
            Chart((Series("ours", (1.0, 2.0), (float("nan"), 4.0)),), "runs", "failures"),
        ),
    )
    page = page_of(write_report(searched, tmp_path / "r.html", sections=[section]))
    assert "The bench" in page.text
    assert "Two tools." in page.text
    assert block_of(page.data, "chart")["series"][0]["y"] == [None, 4.0]


@pytest.mark.parametrize("name", ["", "a b", "x'y", "map", "<b>"])
def test_a_section_id_that_cannot_be_used_is_refused(name: str) -> None:
    sections = (Section("map", "Map", ()), Section(name, "Mine", ()))
    with pytest.raises(ValueError, match="a section's id is"):
        render(Report(title="x", sections=sections))


# Repeating


def test_the_command_repeats_the_campaign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    run = ["run", "--simulations", "3", "--seed", "3", "--workers", "1", "--out", "c"]
    assert CliRunner().invoke(cli, run).exit_code == 0
    with CampaignStore.open(Path("c")) as store:
        line = repeat_command(store.config, store.facts)
        tests = [test.result for test in store.tests()]
    assert line == "frenetic run campaign.toml"
    monkeypatch.chdir("c")
    assert CliRunner().invoke(cli, [*line.split()[1:], "--out", "again"]).exit_code == 0
    with CampaignStore.open(Path("again")) as store:
        assert [test.result for test in store.tests()] == tests


def test_it_is_said_whether_a_campaign_can_be_repeated(searched: Path) -> None:
    with CampaignStore.open(searched) as store:
        config, facts = dict(store.config), store.facts
    assert repeat_command(config, facts) is None
    assert "started from Python" in repeatability(config, facts)
    many = {**config, "workers": 4}
    assert "not exactly repeatable" in repeatability(many, facts)
    assert "any number of workers" in repeatability({**many, "lookahead": 16}, facts)
    timed = {"budget": {"simulations": None, "time": 60, "failures": None}}
    assert "machine's speed" in repeatability(config, timed)
    damaged = {**config, "command": {"strategy": 3}}
    assert repeat_command(damaged, facts) is None
    assert "damaged" in repeatability(damaged, facts)


# Files and the command line


def test_report_replaces_an_older_one_and_leaves_nothing_else(
    searched: Path, tmp_path: Path
) -> None:
    path = tmp_path / "r.html"
    path.write_text("old")
    with CampaignStore.open(searched) as store:
        assert write_report(store, path) == path
    assert page_of(path).title.endswith("simulations")
    assert list(tmp_path.iterdir()) == [path]


def test_report_that_cannot_be_written_is_one_clear_line(searched: Path, tmp_path: Path) -> None:
    with pytest.raises(FreneticError, match=r"cannot be written: .*another place") as caught:
        write_report(searched, tmp_path / "nowhere" / "r.html")
    assert "\n" not in str(caught.value)
    in_the_way = tmp_path / "r.html"
    in_the_way.mkdir()
    with pytest.raises(FreneticError, match="cannot be written"):
        write_report(searched, in_the_way)
    assert list(tmp_path.iterdir()) == [in_the_way]


def test_there_is_no_report_of_what_is_no_campaign(tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="holds no campaign"):
        write_report(tmp_path)


def test_report_command_says_where(searched: Path, tmp_path: Path) -> None:
    out = tmp_path / "r.html"
    done = CliRunner().invoke(cli, ["report", str(searched), "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert done.output == f"Report:      {out}\n"
    assert page_of(out).data["campaign"] == shlex.quote(str(searched))


def test_report_is_shown_in_a_browser_or_its_absence_is_mentioned(
    searched: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = ["report", str(searched), "--out", str(tmp_path / "r.html"), "--open"]
    opened: list[str] = []

    def open_second(url: str) -> bool:
        opened.append(url)
        return len(opened) > 1

    monkeypatch.setattr("webbrowser.open", open_second)
    done = CliRunner().invoke(cli, arguments)
    assert "There is no browser here" in done.stderr
    done = CliRunner().invoke(cli, arguments)
    assert "browser" not in done.stderr
    assert opened == [(tmp_path / "r.html").as_uri()] * 2


def test_a_search_ends_with_a_report(tmp_path: Path) -> None:
    folder = tmp_path / "c"
    search = ["run", "--simulations", "30", "--seed", "1", "--workers", "1", "--out", str(folder)]
    done = CliRunner().invoke(cli, search)
    assert done.exit_code == 0, done.output
    assert f"Report:      {folder / 'report.html'}\n" in done.output
    assert page_of(folder / "report.html").title.endswith("in 30 simulations")
    more = ["resume", str(folder), "--simulations", "10", "--workers", "1"]
    done = CliRunner().invoke(cli, more)
    assert done.exit_code == 0, done.output
    assert page_of(folder / "report.html").title.endswith("in 40 simulations")


def test_a_search_loses_nothing_when_its_report_cannot_be_written(tmp_path: Path) -> None:
    folder = tmp_path / "c"
    (folder / "report.html").mkdir(parents=True)
    search = ["run", "--simulations", "30", "--seed", "1", "--workers", "1", "--out", str(folder)]
    done = CliRunner().invoke(cli, search)
    assert done.exit_code == 0, done.output
    assert "There is no report: " in done.stderr
    assert f"Results:     {folder}" in done.output
    with CampaignStore.open(folder) as store:
        assert store.counts().simulations == 30
