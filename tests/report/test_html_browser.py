"""The HTML report in a browser; ``browsing`` starts it."""

from __future__ import annotations

import io
import json
import math
import re
import shlex
import shutil
from collections import Counter
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from html_browser import background, contrast, low_contrast
from html_campaigns import HOSTILE, make_hostile
from PIL import Image
from playwright.sync_api import Browser, Locator, Page, expect

from frenetic.analysis.bend_map import sweep_map
from frenetic.analysis.clusters import Clusters, distinct_failures
from frenetic.analysis.coverage import DomainCoverage, domain_coverage
from frenetic.analysis.failures import Failure, describe
from frenetic.campaign import Budget, Campaign, CampaignStore, Test
from frenetic.cli import cli
from frenetic.drivers.loading import load_driver
from frenetic.oracle.outcome import Outcome
from frenetic.report import animate
from frenetic.report.html import (
    Chart,
    Facts,
    Paragraph,
    Section,
    Series,
    Table,
    write_report,
)
from frenetic.road import profile
from frenetic.search import RandomSearch
from frenetic.segments.causes import as_text
from frenetic.simulators import EmbeddedSimulator

pytest_plugins = ["browsing", "reported_campaign"]
pytestmark = pytest.mark.heavy
Show = Callable[..., Page]
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True}  # pixels


@pytest.fixture
def page(show: Show, searched: Path) -> Page:
    """The report of `searched`, opened."""
    return show(searched / "report.html")


def clusters_of(folder: Path) -> Clusters:
    with CampaignStore.open(folder) as store:
        return distinct_failures(store)


def open_first(page: Page, folder: Path) -> Test:
    """Open the first failure and return its test."""
    page.locator(".gallery .card").first.click()
    number = int(re.findall(r"\d+", page.locator("#player-title").text_content() or "")[0])
    with CampaignStore.open(folder) as store:
        return store.test(number)


def run(*arguments: str) -> str:
    """Run a command that must succeed; return its output."""
    done = CliRunner().invoke(cli, arguments)
    assert done.exit_code == 0, done.output
    return done.output


def seconds(page: Page) -> float:
    """Return the time at which the player stands, in s."""
    return float(page.locator("#scrub").input_value())


def box_of(element: Locator) -> dict[str, float]:
    box: Any = element.bounding_box()
    assert box is not None
    return dict(box)


def text_box(element: Locator) -> dict[str, float]:
    """Return the box of an element's text, without the rest of the element."""
    box: dict[str, float] = element.evaluate(
        "el => { const r = document.createRange(); r.selectNodeContents(el);"
        " return r.getBoundingClientRect().toJSON(); }"
    )
    return box


def bottom(box: dict[str, float]) -> float:
    return box["y"] + box["height"]


def overlap(first: dict[str, float], second: dict[str, float]) -> bool:
    return (
        first["x"] < second["x"] + second["width"]
        and second["x"] < first["x"] + first["width"]
        and first["y"] < bottom(second)
        and second["y"] < bottom(first)
    )


def cursor(page: Page) -> float:
    """Return the place of the cursor in the profiles, as a share of their width."""
    area, line = box_of(page.locator("#profiles")), box_of(page.locator("#cursor"))
    return (line["x"] - area["x"]) / area["width"]


def car(page: Page) -> tuple[float, float]:
    """Return the position of the car, in m on the turned map."""
    moved = page.locator("#car").get_attribute("transform") or ""
    x, y = re.findall(r"-?[\d.]+", moved)[:2]
    return float(x), float(y)


# The player


def test_the_replay_moves_the_car_and_the_cursor(page: Page) -> None:
    page.locator(".gallery .card").first.click()
    page.keyboard.press("Home")
    assert seconds(page) == 0.0
    start = car(page)
    page.select_option("select[aria-label='Speed of the replay']", "8")
    page.get_by_role("button", name="Play").click()
    expect(page.locator(".clock")).to_have_text(re.compile(r"^([3-9]|\d\d)\."))
    page.get_by_role("button", name="Pause").click()
    assert math.dist(car(page), start) > 5.0
    assert cursor(page) > 0.03
    now = seconds(page)
    page.wait_for_timeout(100)
    assert seconds(page) == now
    page.locator("#scrub").focus()
    page.keyboard.press("End")
    page.get_by_role("button", name="Play").click()  # from the start again
    expect(page.locator("#play")).to_have_text("Play", timeout=20_000)
    assert seconds(page) == pytest.approx(float(page.locator("#scrub").get_attribute("max") or 0))


def test_a_failure_opens_2_to_3_s_before_the_departure(page: Page, searched: Path) -> None:
    test = open_first(page, searched)
    assert test.departure is not None
    assert 2.0 < test.departure.time - seconds(page) < 3.0
    for scene in (".stage-main", ".stage-close"):
        view, shape = box_of(page.locator(f"{scene} .scene")), box_of(page.locator(f"{scene} .car"))
        assert view["x"] < shape["x"] < shape["x"] + shape["width"] < view["x"] + view["width"]
        assert view["y"] < shape["y"] < bottom(shape) < bottom(view)


@pytest.mark.parametrize(
    ("changes", "before"),
    [
        ({"outcome": "PASS"}, None),
        ({"breaches": [{"words": "too fast", "time": 5.0, "distance": 9.0, "x": 0, "y": 0}]}, 5.0),
        ({}, math.inf),  # stuck, too late, or the driver broke
    ],
    ids=["passed", "broke a limit", "ended otherwise"],
)
def test_a_drive_without_departure_opens_before_its_failure_or_at_the_start(
    show: Show, searched: Path, tmp_path: Path, changes: dict[str, Any], before: float | None
) -> None:
    html = (searched / "report.html").read_text(encoding="utf-8")
    marked = re.search(r'(<script type="application/json" id="data">)(.*?)</script>', html, re.S)
    assert marked is not None
    data = json.loads(marked[2])
    drive = data["drives"][0]
    drive |= {"departure": None, "minimised": None, **changes}
    changed = tmp_path / "changed.html"
    text = html[: marked.start(2)] + json.dumps(data) + html[marked.end(2) :]
    changed.write_text(text, encoding="utf-8")
    page = show(changed, fragment=f"#test-{drive['id']}")
    expect(page.get_by_role("dialog")).to_be_visible()
    end = float(page.locator("#scrub").get_attribute("max") or 0)
    wanted = 0.0 if before is None else min(before, end) - 2.5
    assert seconds(page) == pytest.approx(wanted, abs=0.06)


def test_the_replay_shows_the_values_and_the_place_of_the_drive(page: Page, searched: Path) -> None:
    test = open_first(page, searched)
    page.keyboard.press("Home")
    assert test.drive is not None
    path, start = test.drive.trajectory, car(page)
    area = box_of(page.locator("#profiles"))
    page.mouse.move(area["x"] + 0.3 * area["width"], area["y"] + 20)
    assert cursor(page) == pytest.approx(0.3, abs=0.01)
    assert math.dist(car(page), start) > 5.0
    tick = page.locator(".plot-ticks span").last
    box, place = box_of(tick), float(tick.text_content() or "") / test.road.length
    assert box["x"] + box["width"] / 2 == pytest.approx(area["x"] + place * area["width"], abs=1.5)
    page.locator("#scrub").focus()
    page.keyboard.press("End")
    shown = {
        row.locator("> span").first.text_content(): row.locator(".now").text_content() or ""
        for row in page.locator(".plot-name").all()
    }
    sideways, pedals = path.lateral_acceleration[-1], (path.throttle[-1], path.brake[-1])
    value_and_unit = shown["lateral acceleration"].replace("−", "-").split(" ")
    assert float(value_and_unit[0]) == pytest.approx(sideways, abs=0.06)
    assert value_and_unit[1] == "m/s²"
    assert shown["throttle, brake"] == "{:.0f}, {:.0f} %".format(*(100 * pedal for pedal in pedals))
    units = {"oob distance": " m", "speed": " km/h", "steering": "°", "curvature": "1/\u2060m"}
    assert all(shown[name].endswith(unit) for name, unit in units.items())
    driven = math.dist((path.x[0], path.y[0]), (path.x[-1], path.y[-1]))
    assert math.dist(car(page), start) == pytest.approx(driven, abs=0.1)
    # The page has computed the road from its curvatures.
    centre = page.locator("dialog .scene .centre").first.get_attribute("d") or ""
    points = [tuple(map(float, p.split())) for p in centre.strip("M").split("L")]
    ends = test.road.points[[0, -1]]
    assert math.dist(points[0], points[-1]) == pytest.approx(math.dist(*ends), abs=0.1)
    length = sum(math.dist(a, b) for a, b in pairwise(points))
    assert length == pytest.approx(test.road.length, abs=0.5)
    body = page.locator("#car .body")
    sizes = [float(body.get_attribute(name) or 0) for name in ("width", "height")]
    assert sizes == pytest.approx([test.drive.car.length, test.drive.car.width], abs=1e-3)


def test_the_replay_shows_heights_slopes_and_widened_lanes(show: Show, sloping: Path) -> None:
    page = show(sloping / "report.html")
    test = open_first(page, sloping)
    road = test.road
    page.locator("#scrub").focus()
    page.keyboard.press("End")
    shown = {
        row.locator("> span").first.text_content(): row.locator(".now").text_content() or ""
        for row in page.locator(".plot-name").all()
    }
    assert test.departure is not None
    at = test.departure.distance
    for name, value in (
        ("height", float(road.heights(at))),
        ("grade", 100.0 * float(profile.value_at(road.grade, at))),
        ("superelevation", 100.0 * float(profile.value_at(road.superelevation, at))),
    ):
        number, unit = shown[name].replace("−", "-").split(" ")
        assert float(number) == pytest.approx(value, abs=0.06)
        assert unit == ("m" if name == "height" else "%")
    edges = [
        np.array([p.split() for p in (edge.get_attribute("d") or "").strip("M").split("L")], float)
        for edge in page.locator("dialog .stage-main .scene .edge").all()
    ]
    widths = np.hypot(*(edges[0] - edges[1]).T)
    places = np.linspace(0.0, road.length, len(widths))
    wanted = 2.0 * (road.lane_width + profile.value_at(road.widening, places))
    assert widths == pytest.approx(wanted, abs=0.02)
    assert np.ptp(widths) > 0.5
    # On a road of a kilometre the ticks do not overlap, and the car is large enough to see.
    ticks = [box_of(tick) for tick in page.locator(".plot-ticks span").all()]
    assert all(a["x"] + a["width"] < b["x"] for a, b in pairwise(ticks))
    assert float(page.locator("#car .body").get_attribute("width") or 0) > 9.0
    expect(page.locator("dialog .facts")).to_contain_text(road.as_text())


def test_gallery_and_player_work_with_the_keyboard(page: Page) -> None:
    cards, title = page.locator(".gallery .card"), page.locator("#player-title")
    cards.first.focus()
    page.keyboard.press("ArrowRight")
    expect(cards.nth(1)).to_be_focused()
    page.keyboard.press("ArrowDown")
    page.keyboard.press("ArrowUp")
    expect(cards.nth(1)).to_be_focused()
    outline = page.evaluate("getComputedStyle(document.activeElement).outlineStyle")
    assert outline == "solid"
    page.keyboard.press("Enter")
    expect(page.get_by_role("dialog")).to_be_visible()
    first = title.text_content()
    page.keyboard.press("Home")
    for key, time in (("ArrowRight", 0.1), ("Shift+ArrowRight", 1.1), ("ArrowLeft", 1.0)):
        page.keyboard.press(key)
        assert seconds(page) == pytest.approx(time)
    for text in ("Pause", "Play"):
        page.keyboard.press("Space")
        expect(page.locator("#play")).to_have_text(text)
    page.keyboard.press("n")
    assert title.text_content() != first
    page.keyboard.press("p")
    assert title.text_content() == first
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog")).to_be_hidden()
    expect(cards.nth(1)).to_be_focused()


def test_each_test_has_an_address(show: Show, searched: Path) -> None:
    page = show(searched / "report.html")
    cards, title = page.locator(".gallery > .cluster > .card"), page.locator("#player-title")
    ids = cards.evaluate_all("els => els.map(el => el.dataset.test)")
    cards.nth(1).click()
    address = page.evaluate("location.hash")
    assert address == f"#test-{ids[1]}"
    reopened = show(searched / "report.html", fragment=address)
    expect(reopened.locator("#player-title")).to_have_text(title.text_content() or "")
    expect(reopened.locator(".player-nav")).to_contain_text(f"2 of {len(clusters_of(searched))}")
    for name, number in (("Next", ids[2]), ("Previous", ids[1]), ("Previous", ids[0])):
        reopened.get_by_role("button", name=f"{name} test").click()
        expect(reopened.locator("#player-title")).to_contain_text(f"Test {number} ")


def test_copied_commands_run(show: Show, tmp_path: Path) -> None:
    folder = tmp_path / "it's a night"
    options = ("--failures", "2", "--seed", "1", "--workers", "1", "--with", "noise=0.1")
    run("run", *options, "--out", str(folder))
    page = show(folder / "report.html")
    (file, *_) = sorted((folder / "minimised").glob("*.json"))
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.locator(".gallery .card").first.click()
    lines = page.locator("dialog .command-line")
    button = lines.last.get_by_role("button")
    button.click()
    expect(button).to_have_text("Copied")
    texts = lines.locator("code").all_text_contents()
    assert page.evaluate("navigator.clipboard.readText()") == texts[-1]
    small, drive, shown = map(shlex.split, texts)
    assert small[:2] == ["frenetic", "drive"]
    assert Path(small[2]) in {*file.parent.iterdir()}
    assert run(*drive[1:]).startswith("FAIL")
    assert shown[:3] == ["frenetic", "show", str(folder)]


# Charts


def place_in_chart(page: Page, share: float) -> tuple[float, float]:
    """Return a place in the first chart, at a share of its width."""
    over = page.locator(".block-chart .u-over")
    over.scroll_into_view_if_needed()
    box = box_of(over)
    return box["x"] + share * box["width"], box["y"] + 60


def tip_values(page: Page) -> tuple[int, dict[str | None, str | None]]:
    """Return the number of tests at the first chart's cursor, and the values there."""
    tip = page.locator(".block-chart .chart-tip")
    rows = {
        row.locator("span").text_content(): row.locator("b").text_content()
        for row in tip.locator("> div").all()
    }
    return int(re.findall(r"^(\d+) ", tip.locator("p").first.text_content() or "")[0]), rows


def test_the_chart_shows_the_values_at_the_mouse(page: Page, searched: Path) -> None:
    with CampaignStore.open(searched) as store:
        driven = [test for test in store.tests() if test.outcome in ("PASS", "FAIL", "ERROR")]
        repeats = store.repeats()
    legend = page.locator(".block-chart .legend button")
    page.mouse.move(*place_in_chart(page, 0.6))
    at, rows = tip_values(page)
    assert at == pytest.approx(90, abs=2)
    failed = [
        test.id for test in driven[:at] if test.outcome is Outcome.FAIL and test.id not in repeats
    ]
    assert rows["failures"] == str(len(failed))
    assert list(rows) == legend.all_text_contents()
    expect(page.locator(".chart-tip")).to_contain_text(f"Latest failure: test {failed[-1]}.")
    legend.filter(has_text="distinct failures").first.click()
    page.mouse.move(*place_in_chart(page, 0.6))
    assert "distinct failures" not in tip_values(page)[1]
    page.mouse.down()
    page.mouse.up()
    expect(page.locator("#player-title")).to_contain_text(f"Test {failed[-1]} FAIL")


def test_the_first_tap_shows_values_and_the_second_opens_the_test(
    show: Show, searched: Path
) -> None:
    page = show(searched / "report.html", **PHONE)
    place = place_in_chart(page, 0.6)
    page.touchscreen.tap(*place)
    expect(page.locator(".chart-tip")).to_contain_text("Latest failure")
    expect(page.locator("dialog")).to_be_hidden()
    page.touchscreen.tap(*place)
    expect(page.locator("dialog")).to_be_visible()


def test_the_chart_can_be_read_with_the_keyboard(page: Page) -> None:
    page.locator(".block-chart .chart-drawing").focus()
    page.keyboard.press("ArrowRight")
    first, _ = tip_values(page)
    for _ in range(60):
        page.keyboard.press("ArrowRight")
    assert tip_values(page)[0] > first + 50
    tip = page.locator(".block-chart .chart-tip")
    number = re.findall(r"test (\d+)", tip.text_content() or "")[0]
    page.keyboard.press("Enter")
    expect(page.locator("#player-title")).to_contain_text(f"Test {number} ")


# Gallery, map and table


def heads(page: Page) -> list[int]:
    """Return the tests that stand for the clusters in the gallery."""
    more = page.locator("#failures button.more")
    if more.is_visible():
        more.click()
    cards = page.locator(".gallery > .cluster > .card")
    numbers: list[str] = cards.evaluate_all("els => els.map(el => el.dataset.test)")
    return sorted(map(int, numbers))


def test_the_card_of_a_causes_example_describes_the_example(page: Page, searched: Path) -> None:
    causes = clusters_of(searched).causes
    severe = {cluster.most_severe for cause in causes for cluster in cause.clusters}
    examples = [cause.example for cause in causes if cause.example not in severe]
    assert examples
    for example in examples:
        text = page.locator(f'.gallery > .cluster > .card[data-test="{example}"] .card-text')
        expect(text).to_contain_text(": leaves to the ")


def test_failures_can_be_sorted_and_searched(page: Page, searched: Path) -> None:
    clusters, search = clusters_of(searched), page.locator("#gallery-search")
    page.select_option("#gallery-side", "left")
    texts = page.locator(".gallery .card-text").all_text_contents()
    assert 0 < len(texts) < len(clusters)
    assert all("leaves to the left" in text for text in texts)
    page.select_option("#gallery-side", "")
    page.select_option("#gallery-sort", "first")
    assert len(heads(page)) == len(clusters)
    first = int(page.locator(".gallery .card").first.get_attribute("data-test") or 0)
    assert first in min(clusters, key=lambda cluster: min(cluster.ids)).ids
    search.fill(" ENTERING left")
    texts = page.locator(".gallery > .cluster > .card .card-text").all_text_contents()
    assert 0 < len(texts) < len(clusters)
    assert all({"entering", "left"} <= {*re.split(r"\W", text)} for text in texts)
    expect(page.locator("#failures .found")).to_have_text(f"{len(heads(page))} of {len(clusters)}")
    member = next(
        i
        for cluster in clusters
        if len(cluster) > 1
        for i in cluster.ids
        if i != cluster.most_severe
    )
    search.fill(f"#{member}")
    assert heads(page) == [member]
    with CampaignStore.open(searched) as store:
        happens = Failure.of_test(store.test(member))
        assert happens is not None
        expect(page.locator(".gallery .card-text").first).to_contain_text(describe(happens))
        failed = store.tests(Outcome.FAIL, with_repeats=False)
        operators = {test.id: test.candidate.origin.operator for test in failed}
    operator = next(name for name in sorted(set(operators.values())) if name != "random")
    search.fill(operator)
    assert {operators[i] for i in heads(page)} == {operator}
    search.fill("no such words")
    expect(page.locator(".gallery")).to_have_text("None of these.")
    page.get_by_role("button", name="Clear").click()
    assert len(heads(page)) == len(clusters)
    more = page.locator("button.alike").first
    number = int(re.findall(r"\d+", more.text_content() or "")[0])
    members = page.locator(".cluster.is-open .members .card")
    assert members.count() == 0
    more.click()
    expect(more).to_have_attribute("aria-expanded", "true")
    assert members.count() == min(number, 60)
    more.click()
    expect(members.first).to_be_hidden()


def test_failures_can_be_filtered_by_robustness(show: Show, searched: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(searched, tmp_path / "again")
    parts = ("--driver", "planner", "--simulator", "embedded", "--top", "2")
    run("rerun", str(folder), "--times", "20", *parts)
    page = show(write_report(folder))
    all_heads = heads(page)
    page.select_option("#gallery-robust", "repeatable")
    robust = heads(page)
    assert len(robust) == 2
    expect(page.locator(".gallery .repeats.repeatable")).to_have_count(2)
    colour = "el => getComputedStyle(el).color"
    fail = page.locator(".card-line .outcome-fail").first.evaluate(colour)
    assert page.locator(".repeats.repeatable").first.evaluate(colour) == fail  # no success
    page.select_option("#gallery-robust", "none")
    assert len(heads(page)) >= len(all_heads) - 2
    assert not set(robust) & set(heads(page))


def test_the_map_shows_the_roads_of_a_cell(page: Page) -> None:
    total = "els => els.map(el => Number(el.textContent)).reduce((a, b) => a + b, 0)"
    cells, panel = page.locator(".cell"), page.locator(".map-panel")
    failures, before = cells.evaluate_all(total), cells.all_text_contents()
    assert failures > 0
    cell = page.locator(".cell.severity").first
    number = cell.text_content()
    cell.click()
    expect(cell).to_have_attribute("aria-selected", "true")
    text = re.compile(rf"^{number} failures? of (\d+) tests?, (\d+)\s%$")
    expect(panel.locator("h3")).to_have_text(text)
    match = text.match(panel.locator("h3").text_content() or "")
    assert match is not None
    drives, share = map(int, match.groups())
    assert share == pytest.approx(100.0 * int(number or 0) / drives, abs=0.5)
    index = int(cell.evaluate("el => [...document.querySelectorAll('.cell')].indexOf(el)"))
    page.select_option("#map-shade", "share")
    assert cells.nth(index).text_content() == f"{share}%"
    expect(page.locator(".map-figure figcaption")).to_contain_text("share that fails")
    page.select_option("#map-shade", "severity")
    cells.nth(index).click()
    panel.locator(".card").first.click()
    expect(page.get_by_role("dialog")).to_be_visible()
    page.keyboard.press("Escape")
    page.select_option("#map-across", "bends")
    assert cells.all_text_contents() != before
    # Whole numbers stand at the middle of their cells.
    labels, row = page.locator(".edges-x span"), page.locator(".cell-row").first.locator(".cell")
    numbers = [int(text) for text in labels.all_text_contents()]
    assert numbers == list(range(numbers[0], numbers[-1] + 1))
    centre = (
        "els => els.map(el => { const b = el.getBoundingClientRect(); return b.x + b.width / 2; })"
    )
    assert labels.evaluate_all(centre) == pytest.approx(row.evaluate_all(centre), abs=1.5)
    title = re.compile(f"^Number of bends {numbers[-1]}, ")
    expect(row.last).to_have_attribute("title", title)
    page.select_option("#map-shade", "count")
    assert cells.evaluate_all(total) == failures
    assert page.locator(".cell.count").count() > 0
    page.locator(".cell[tabindex='0']").focus()
    here = page.evaluate("document.activeElement.title")
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("ArrowDown")
    assert page.evaluate("document.activeElement.title") != here
    page.keyboard.press("Enter")
    expect(panel.locator("h3")).to_contain_text("failure")


def test_a_cell_of_a_sweep_opens_its_worst_drive(show: Show, swept: Path) -> None:
    page = show(swept / "report.html")
    with CampaignStore.open(swept) as store:
        bends = sweep_map(store.tests())
    assert bends is not None
    cells = page.locator(".sweep g")
    expect(cells).to_have_count(bends.drives.size)
    assert bends.failures.any()
    shares = [f"{100 * share:.0f}\u00a0%" for share in bends.share.ravel()]
    assert page.locator(".sweep .share").all_text_contents() == shares
    expect(page.locator(".sweep [class^=shade]")).to_have_count(int((bends.failures > 0).sum()))
    worst = int(bends.worst_tests[bends.failures > 0][0])
    page.locator(f".sweep a[href='#test-{worst}']").first.click()
    expect(page.get_by_role("dialog")).to_be_visible()
    expect(page.locator("#player-title")).to_contain_text(str(worst))


def coverage_of(folder: Path) -> DomainCoverage:
    with CampaignStore.open(folder) as store:
        coverage = domain_coverage(store.setting, store.tests())
    assert coverage is not None
    return coverage


def test_the_domain_shows_reached_and_unreached_cells(show: Show, varied: Path) -> None:
    page, coverage = show(varied / "report.html"), coverage_of(varied)
    rows = page.locator(".domain > div")
    expect(rows).to_have_count(len(coverage.singles))
    for row, single in zip(rows.all(), coverage.singles, strict=True):
        expect(row.locator("li")).to_have_count(single.count)
        expect(row.locator("li.unreached")).to_have_count(single.never_reached)
        expect(row.locator("[class*=failing-]")).to_have_count(single.failed)
    assert sum(single.never_reached for single in coverage.singles) > 0
    pairs = page.locator("#domain tbody tr", has=page.locator("a"))
    numbers, first = pairs.first.locator("td").all_text_contents(), coverage.pairs[0]
    counts = first.count, first.driven, first.failed, first.never_reached
    assert numbers[:4] == [str(number) for number in counts]
    text = coverage.gaps[0].as_text().replace(" -", " \u2212")
    gaps = page.locator("#domain .table").last.locator("tbody tr")
    expect(gaps.first).to_contain_text(text, ignore_case=True)


def test_a_pair_of_the_domain_opens_in_the_map(show: Show, varied: Path) -> None:
    page, coverage = show(varied / "report.html"), coverage_of(varied)
    page.get_by_role("link", name="gust, delay").click()
    expect(page.locator("#map-across")).to_have_value("gust")
    expect(page.locator("#map-up")).to_have_value("delay")
    expect(page.locator(".cells")).to_be_in_viewport()
    pair = next(pair for pair in coverage.pairs if [a.name for a in pair.axes] == ["gust", "delay"])
    # The delay grows upwards.
    wanted = [str(n or "") for n in np.flipud(pair.failures.T).ravel().tolist()]
    assert page.locator(".cell").all_text_contents() == wanted
    expect(page.locator(".cell.empty")).to_have_count(pair.never_reached)
    assert page.locator(".edges-y span").first.text_content() == "usual"
    corner = page.locator(".cell-row").last.locator(".cell").first
    text = "Gust \u221220 to \u221210 m/s, Delay as usual: "
    expect(corner).to_have_attribute("title", re.compile(f"^{text}"))
    least_radius = show(varied / "report.html", fragment="#map:min_radius:max_curvature")
    expect(least_radius.locator(".map-x")).to_have_text("Least radius (m)")
    expect(least_radius.locator(".edges-x span").last).to_have_text("∞")
    unknown_axis = show(varied / "report.html", fragment="#map:beauty:delay")
    expect(unknown_axis.locator("#map-up")).to_have_value("mean_speed")


def test_tests_can_be_sorted_and_searched(page: Page, searched: Path) -> None:
    with CampaignStore.open(searched) as store:
        tests = {test.id: test for test in store.tests(with_segments=True)}
    rows, ids = page.locator("#tests tbody tr"), page.locator("#tests tbody th")
    assert ids.all_text_contents() == [str(i) for i in sorted(tests)[:50]]
    page.get_by_role("button", name="MOOBD (m, at most 2.00)").click()
    head = page.locator("#tests thead th", has_text="MOOBD (m, at most 2.00)")
    expect(head).to_have_attribute("aria-sort", "ascending")
    known = {i: test.moobd for i, test in tests.items() if test.moobd is not None}
    shown = [known[int(text)] for text in ids.all_text_contents()]
    assert shown == pytest.approx(sorted(known.values())[:50], abs=0.011)
    page.keyboard.press("Enter")
    expect(head).to_have_attribute("aria-sort", "descending")
    page.select_option("#tests-outcome", "FAIL")
    failures = sum(test.outcome is Outcome.FAIL for test in tests.values())
    expect(page.locator("#tests .found")).to_have_text(f"{failures} of {len(tests)}")
    causes = Counter(
        as_text(*test.stored_values.cause)
        for test in tests.values()
        if test.stored_values is not None and test.stored_values.cause is not None
    )
    (cause, number), *_ = causes.most_common()
    page.select_option("#tests-cause", cause)
    expect(page.locator("#tests .found")).to_have_text(f"{number} of {len(tests)}")
    expect(rows.first).to_contain_text(cause)
    page.select_option("#tests-cause", "")
    page.select_option("#tests-outcome", "")
    page.get_by_role("button", name=f"Show more of {len(tests)}").click()
    expect(rows).to_have_count(len(tests))
    page.fill("#tests-search", "#150")
    page.locator("#tests tbody a").click()
    expect(page.locator("#player-title, #notice code").first).to_contain_text("150")


# Light and dark, wide and narrow, paper


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_all_text_has_enough_contrast(show: Show, searched: Path, theme: str) -> None:
    page = show(searched / "report.html", color_scheme=theme)
    # Unfold the details, and add each shade of the map with a number in it.
    page.evaluate(
        """() => {
          for (const details of document.querySelectorAll("details")) details.open = true;
          const added = (place, style, text) => {
            const span = document.createElement("span");
            span.className = style;
            span.textContent = text;
            document.querySelector(place).append(span);
            return span;
          };
          for (const style of ["covered", "empty"]) added(".map-panel", `cell ${style}`, "12");
          for (const shade of ["severity", "count"]) {
            for (let i = 0; i < 7; i++) {
              const cell = added(".map-panel", `cell ${shade} depth-${i}`, "12");
              cell.style.setProperty("--tint", `var(--${shade}-${i})`);
            }
          }
          for (const word of ["robust", "unclear", "fragile"]) {
            added(".card", `repeats ${word}`, word);
          }
        }"""
    )
    assert low_contrast(page) == []
    raised = "els => els.forEach(el => { el.style.background = 'var(--raised)'; })"
    page.locator(".card, tbody tr > *").evaluate_all(raised)
    page.locator(".legend button").first.click()
    page.locator("button.alike").first.click()
    page.locator(".cell.severity").first.click()
    page.locator(".block-chart .chart-drawing").focus()
    page.keyboard.press("ArrowRight")
    page.evaluate("location.hash = '#test-99999'")
    expect(page.locator("#notice")).to_be_visible()
    assert low_contrast(page) == []
    page.locator(".gallery .card").first.click()
    assert low_contrast(page) == []


def has_colour(canvas: Locator, colour: tuple[int, int, int]) -> bool:
    """Return whether a chart has lines of a colour."""
    pixels = np.asarray(Image.open(io.BytesIO(canvas.screenshot())).convert("RGB"))
    return int((np.abs(pixels.astype(int) - colour).max(axis=2) < 8).sum()) > 50


def test_dark_colours_follow_the_system_and_the_switch(show: Show, searched: Path) -> None:
    page = show(searched / "report.html", color_scheme="dark")
    canvas, switch = page.locator(".block-chart canvas"), page.locator("#theme")
    chosen = switch.locator("option:checked")
    light, dark = (196, 31, 39), (255, 122, 112)  # of failures
    assert background(page) < 150
    assert has_colour(canvas, dark)
    expect(chosen).to_have_text("System colours")
    switch.select_option("Light colours")
    assert background(page) > 600
    assert has_colour(canvas, light)
    assert not has_colour(canvas, dark)
    page.reload()
    expect(chosen).to_have_text("Light colours")
    switch.select_option("Dark colours")
    assert background(page) < 150


def test_lanes_and_path_differ_in_the_dark(show: Show, searched: Path) -> None:
    page = show(searched / "report.html", color_scheme="dark")
    page.locator(".gallery .card").first.click()
    for picture in (".gallery .card", ".stage-main", ".stage-close"):
        ego, other = (
            page.locator(f"{picture} .lane-{lane}").first.evaluate(
                "el => getComputedStyle(el).fill"
            )
            for lane in ("ego", "other")
        )
        paths = page.locator(f"{picture} .path")
        colours = paths.evaluate_all("els => els.map(el => getComputedStyle(el).stroke)")
        assert contrast(ego, other) > 1.5
        assert min(contrast(ego, colour) for colour in colours) > 3.0


@pytest.mark.parametrize("width", [320, 768])
def test_small_screens_need_no_scrolling_sideways(show: Show, searched: Path, width: int) -> None:
    page = show(searched / "report.html", viewport={"width": width, "height": 844}, has_touch=True)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.locator(".gallery .card").first.click()
    dialog = page.get_by_role("dialog")
    assert dialog.evaluate("dialog => dialog.scrollWidth <= dialog.clientWidth")
    assert box_of(dialog)["width"] <= width


def test_a_phone_shows_the_player_and_the_roads_of_a_cell(show: Show, searched: Path) -> None:
    page = show(searched / "report.html", **PHONE)
    for name in ("nav", "#tests .table"):  # a box that goes on to the right fades out
        box = page.locator(name)
        expect(box).to_have_class(re.compile("goes-on"))
        assert box.evaluate("box => getComputedStyle(box).maskImage").startswith("linear-gradient")
        box.evaluate("box => box.scrollTo({ left: 1e4, behavior: 'instant' })")
        expect(box).not_to_have_class(re.compile("goes-on"))
    page.locator(".cell.severity").first.tap()
    expect(page.locator(".map-panel h3")).to_be_in_viewport()
    expect(page.locator(".map-panel .card").first).to_be_in_viewport()
    page.locator(".gallery .card").first.click()
    area = box_of(page.locator("#profiles"))
    assert area["y"] + area["height"] < 844
    # The widest possible value.
    page.locator(".plot-name .now").evaluate_all(
        "els => els.forEach(el => { el.textContent = '\u22120.044 1/\u2060m'; })"
    )
    ends = page.locator(".plot-name > span:not(.high):not(.low)").evaluate_all(
        "els => els.map(el => { const r = document.createRange(); r.selectNodeContents(el);"
        " return r.getBoundingClientRect().right; })"
    )
    assert len(ends) == 12
    assert max(ends) <= area["x"]


@pytest.mark.parametrize("screen", [{}, PHONE], ids=["screen", "phone"])
def test_axis_numbers_overlap_no_curve_and_no_other_text(
    show: Show, sloping: Path, screen: dict[str, Any]
) -> None:
    page = show(sloping / "report.html", **screen)
    page.locator(".gallery .card").first.click()
    plots = [box_of(plot) for plot in page.locator("#profiles .plot").all()]
    assert len(plots) == 9
    for plot, row in zip(plots, page.locator(".plot-name").all(), strict=True):
        numbers = [box_of(row.locator(f".{end}")) for end in ("high", "low")]
        texts = [text_box(span) for span in row.locator("> span:not(.high, .low)").all()]
        for number in numbers:
            assert not any(overlap(number, other) for other in (*plots, *texts))
            assert plot["y"] <= number["y"] < number["y"] + number["height"] <= bottom(plot)
        assert not overlap(*numbers)
    ticks = [box_of(tick) for tick in page.locator(".plot-ticks span").all()]
    assert len(ticks) > 2
    assert all(a["x"] + a["width"] + 4.0 < b["x"] for a, b in pairwise(ticks))
    assert min(tick["y"] for tick in ticks) >= max(map(bottom, plots))


@pytest.mark.parametrize("density", [1, 2, 3])
def test_numbers_of_a_chart_have_the_same_size_on_a_dense_screen(
    show: Show, searched: Path, density: int
) -> None:
    page = show(searched / "report.html", **PHONE, device_scale_factor=density)
    canvas, over = page.locator(".block-chart canvas"), page.locator(".block-chart .u-over")
    pixels = np.asarray(Image.open(io.BytesIO(canvas.screenshot(scale="device"))).convert("L"))
    below = round((bottom(box_of(over)) - box_of(canvas)["y"]) * density) + 4 * density
    numbers = pixels[below : below + 18 * density]  # between the curves and the axis' title
    inked = np.flatnonzero(numbers.min(axis=1) < 160)
    assert 7.5 < (inked[-1] - inked[0] + 1) / density < 11.0  # [px], of figures 12 px large


def test_a_printed_page_is_white_and_has_no_switches(show: Show, searched: Path) -> None:
    page = show(searched / "report.html", color_scheme="dark")
    details = page.locator("#configuration details")
    details.nth(1).locator("summary").click()
    folded = "els => els.map(el => el.open)"
    before = details.evaluate_all(folded)
    page.locator(".gallery .card").first.click()
    page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
    page.emulate_media(media="print")
    assert background(page) == 3 * 255
    for hidden in (".bar", ".choices", ".copy", ".map-panel", "#player"):
        expect(page.locator(hidden).first).to_be_hidden()
    assert all(details.evaluate_all(folded))
    charts = page.locator(".chart-drawing canvas")
    assert 500 < max(charts.evaluate_all("els => els.map(el => el.clientWidth)")) <= 660
    page.evaluate("window.dispatchEvent(new Event('afterprint'))")
    page.emulate_media(media="screen")
    assert background(page) < 150
    assert details.evaluate_all(folded) == before
    expect(page.locator("#player")).to_be_visible()
    assert len(page.pdf(format="A4")) > 20_000


# Texts from outside, and sections of the caller


def test_no_text_from_outside_is_run(show: Show, searched: Path, tmp_path: Path) -> None:
    page = show(write_report(make_hostile(tmp_path, searched)))
    page.locator(".gallery .card").first.click()
    expect(page.locator(".reason")).to_have_text(HOSTILE)
    assert page.evaluate("window.hacked === undefined && typeof hacked === 'undefined'")
    assert page.locator("main img, dialog img").count() == 0


def test_a_script_that_is_not_ours_is_refused(browser: Browser, searched: Path) -> None:
    page = browser.new_page()
    page.goto((searched / "report.html").as_uri())
    blocked = page.evaluate(
        """() => new Promise((resolve) => {
          const refused = (event) => resolve(event.effectiveDirective);
          document.addEventListener("securitypolicyviolation", refused);
          const script = document.createElement("script");
          script.textContent = "window.hacked = 1";
          document.body.append(script);
        })"""
    )
    assert blocked.startswith("script-src")
    assert page.evaluate("window.hacked === undefined")
    page.close()


def test_sections_of_the_caller_are_drawn(show: Show, searched: Path, tmp_path: Path) -> None:
    line = Series("line", (0.0, 1.0), (1.0, 2.0), (0.5, 1.5), (1.5, 2.5), dashed=True)
    section = Section(
        id="bench",
        title="The bench",
        lead="Two tools.",
        blocks=(
            Paragraph("A paragraph."),
            Facts({"c": "d"}, "Folded facts", folded=True),
            Table(("tool", ">n"), (("ours", "1"), ("theirs", "2")), "Caption."),
            Chart((line,), "runs", "failures"),
        ),
    )
    page = show(write_report(searched, tmp_path / "r.html", sections=[section]))
    ours = page.locator("#bench")
    ours.locator(".chart-drawing").focus()
    page.keyboard.press("ArrowRight")
    expect(ours.locator(".chart-tip b")).to_have_text("1")
    for text in ("Two tools.", "A paragraph.", "Folded facts", "theirs", "Caption."):
        expect(ours).to_contain_text(text)
    expect(ours.locator("thead th.number")).to_have_text("n")
    expect(ours.locator(".stroke.dashed").first).to_be_visible()
    expect(page.locator("nav a").last).to_have_text("The bench")


def test_a_replay_plays_inside_another_page(show: Show, searched: Path, tmp_path: Path) -> None:
    with CampaignStore.open(searched) as store:
        (failure,) = store.tests(Outcome.FAIL, order_by="moobd", limit=1, with_trajectory=True)
    replay = animate(failure)
    host_page = tmp_path / "notebook.html"
    host_page.write_text(f"<!doctype html><meta charset='utf-8'>{replay.html}", encoding="utf-8")
    page = show(host_page)
    frame = page.frame_locator("iframe")
    expect(frame.locator("#player-title")).to_contain_text(f"Test {failure.id}")
    assert page.evaluate("document.activeElement.tagName") == "BODY"  # the replay took no focus
    before = frame.locator("#car").get_attribute("transform")
    frame.locator("#play").click()
    expect(frame.locator("#car")).not_to_have_attribute("transform", before or "")
    expect(frame.locator("#play")).to_have_text("Pause")
    for left_out in (".bar", ".player-nav", "#foot"):
        expect(frame.locator(left_out)).to_be_hidden()
    alone = show(replay.write(tmp_path / "replay.html"))
    alone.locator("#scrub").fill("1")
    assert seconds(alone) == 1.0


def test_the_player_plays_the_camera_pictures(show: Show, tmp_path: Path) -> None:
    Campaign(
        strategy=RandomSearch(seed=3),
        simulator=EmbeddedSimulator(),
        driver=load_driver("marking-follower"),
        budget=Budget(simulations=1),
        folder=tmp_path / "seen",
    ).run()
    page = show(write_report(tmp_path / "seen"), fragment="#test-1")
    picture = page.locator("#picture")
    expect(picture).to_have_attribute("viewBox", "0 0 160 80")
    page.locator("#player").press("End")
    expect(picture).not_to_have_attribute("viewBox", "0 0 160 80")
