"""The report as a page that grows: its server, its pieces, and how a browser shows it."""

from __future__ import annotations

import http.client
import json
import os
import platform
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from html_browser import Trouble
from playwright.sync_api import Browser, expect

from frenetic.campaign import Budget, Campaign, CampaignStore, Test
from frenetic.campaign.log import CampaignLog, Event
from frenetic.campaign.progress import Progress
from frenetic.campaign.store import LOCK
from frenetic.drivers import Planner
from frenetic.errors import CampaignError, FreneticError
from frenetic.outcome import Outcome
from frenetic.report.html import LiveReport, campaign_report, live
from frenetic.report.html.campaign import GrowingReport
from frenetic.search import Frenetic2021
from frenetic.simulators import EmbeddedSimulator

pytest_plugins = ["browsing"]

LIMIT = 60.0  # s until a page or an edition has to be there


@pytest.fixture(scope="module")
def tests(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, list[Test]]:
    """The record of a campaign, and its tests."""
    folder = tmp_path_factory.mktemp("live") / "searched"
    Campaign(
        strategy=Frenetic2021(seed=1, max_redraws=10),
        simulator=EmbeddedSimulator(),
        driver=Planner(),
        budget=Budget(simulations=120),
        folder=folder,
    ).run()
    with CampaignStore.open(folder) as store:
        return store.config, list(store.tests(with_trajectory=True))


class Growing:
    """A campaign that grows test by test."""

    def __init__(self, folder: Path, config: Any, tests: Sequence[Test]) -> None:
        self.folder = folder
        self._tests = list(tests)
        self.store = CampaignStore.create(folder, config)
        self._log = CampaignLog(folder)
        self._log.write(
            Event.STARTED, "started", host=platform.node(), process_id=os.getpid(), seed=1
        )

    def grow(self, number: int) -> None:
        taken, self._tests = self._tests[:number], self._tests[number:]
        for record in taken:
            self.store.asked(record.candidate)
            self.store.told(record)
        self.store.write()
        counts = self.store.counts()
        progress = Progress(
            passed=counts.passed, failed=counts.failed, seconds=1.0, budget_spent=0.3
        )
        self._log.progress(progress, force=True)

    def finish(self) -> None:
        self.store.finish(seconds=1.0)
        self._log.write(Event.FINISHED, "finished")

    def close(self) -> None:
        self.store.close()
        self._log.close()


@pytest.fixture
def begin(tmp_path: Path, tests: tuple[Any, list[Test]]) -> Iterator[Callable[[], Growing]]:
    made: list[Growing] = []

    def begun() -> Growing:
        made.append(Growing(tmp_path / "c", *tests))
        return made[-1]

    yield begun
    for one in made:
        one.close()


def ask(page: LiveReport, path: str, method: str = "GET", **headers: str) -> tuple[int, str]:
    connection = http.client.HTTPConnection(page.address.split("/")[2], timeout=LIMIT)
    connection.request(method, path, headers=headers)
    answer = connection.getresponse()
    found = answer.status, answer.read().decode()
    connection.close()
    return found


def wait_for(page: LiveReport, condition: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """The state as soon as it is so."""
    end = time.monotonic() + LIMIT
    while time.monotonic() < end:
        state: dict[str, Any] = json.loads(ask(page, "/state")[1])
        if condition(state):
            return state
        time.sleep(0.02)
    raise AssertionError(f"it stays {state}")


# What is read and told


def test_report_that_has_grown_is_that_of_the_whole_campaign(
    begin: Callable[[], Growing], monkeypatch: pytest.MonkeyPatch
) -> None:
    campaign, report = begin(), GrowingReport()
    read: list[int] = []
    whole = CampaignStore._read_trajectory

    def noted(store: CampaignStore, test_id: int) -> Any:
        read.append(test_id)
        return whole(store, test_id)

    monkeypatch.setattr(CampaignStore, "_read_trajectory", noted)
    for number in (50, 60):
        campaign.grow(number)
        report.make(campaign.store)
    read.clear()
    campaign.grow(10)
    grown = report.make(campaign.store)
    assert len(set(read)) < 30  # the new ones, and drives that are shown only now
    assert report.told == 120
    assert grown == campaign_report(campaign.store)


def test_page_is_told_only_what_is_new(begin: Callable[[], Growing], tmp_path: Path) -> None:
    with LiveReport(tmp_path / "c", interval=0.01) as page:
        waiting = wait_for(page, lambda state: True)
        assert waiting["status"] == "waiting"
        assert "there is no campaign" in waiting["note"]
        campaign = begin()
        campaign.grow(60)
        state = wait_for(page, lambda state: state["edition"] != waiting["edition"])
        whole = json.loads(ask(page, f"/news?{waiting['edition']}")[1])
        assert (state["status"], whole["whole"]) == ("running", True)
        assert whole["order"][:3] == ["summary", "time", "failures"]
        assert [section["id"] for section in whole["sections"]] == whole["order"]
        # The page says itself that it runs.
        assert whole["sections"][0]["blocks"][0]["warning"] == ""
        campaign.grow(60)
        campaign.finish()
        wait_for(
            page, lambda new: new["status"] == "finished" and new["edition"] != state["edition"]
        )
        news = json.loads(ask(page, f"/news?{state['edition']}")[1])
        changed = [section["id"] for section in news["sections"]]
        assert not news["whole"]
        assert {"summary", "time"} <= set(changed)
        assert "repeat" not in changed
        assert news["order"] == whole["order"]
        assert not {drive["id"] for drive in news["drives"]} & {
            drive["id"] for drive in whole["drives"]
        }
        assert json.loads(ask(page, "/news?0123abcd-1")[1])["whole"]  # another server's


def test_report_is_not_made_for_nobody(
    begin: Callable[[], Growing], monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[str] = []
    monkeypatch.setattr(GrowingReport, "make", lambda *_, **__: made.append("report"))
    campaign = begin()
    campaign.grow(1)
    with LiveReport(campaign.folder, interval=0.001):
        time.sleep(0.05)
    assert made == []


def test_campaign_that_was_killed_is_called_so(
    begin: Callable[[], Growing], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live, "QUIET", 0.0)
    campaign = begin()
    campaign.grow(1)
    with LiveReport(campaign.folder) as page:
        assert page.state().status == "running"
        campaign.close()  # as its end would, without a word in the log
        assert (campaign.folder / LOCK).is_file()
        state = page.state()
    assert (state.status, state.has_ended) == ("killed", True)
    assert "frenetic resume" in state.note


def test_damaged_campaign_is_said_to_be_so(tmp_path: Path) -> None:
    (tmp_path / "campaign.sqlite").write_bytes(b"nothing of the kind" * 100)
    with LiveReport(tmp_path, interval=0.01) as page:
        state = wait_for(page, lambda state: "cannot be made" in state["note"])
    assert state["status"] == "stored"


def test_report_goes_on_after_an_unforeseen_error(
    begin: Callable[[], Growing], monkeypatch: pytest.MonkeyPatch
) -> None:
    make, errors = GrowingReport.make, [RuntimeError("unforeseen")]

    def breaking(*args: Any, **options: Any) -> Any:
        if errors:
            raise errors.pop()
        return make(*args, **options)

    monkeypatch.setattr(GrowingReport, "make", breaking)
    campaign = begin()
    campaign.grow(1)
    with LiveReport(campaign.folder, interval=0.01) as page:
        wait_for(page, lambda state: "RuntimeError: unforeseen" in state["note"])
        campaign.grow(1)
        wait_for(page, lambda state: not state["note"] and not state["edition"].endswith("-0"))


# Who is answered


@pytest.mark.parametrize(
    ("path", "method", "host", "status"),
    [
        ("/", "GET", "127.0.0.1:1", 200),
        ("/", "GET", "localhost", 200),
        ("/state", "GET", "rebound.example", 403),
        ("/news", "GET", "127.0.0.1.rebound.example", 403),
        ("/", "GET", "[", 403),
        ("/campaign.sqlite", "GET", "localhost", 404),
        ("/../c/campaign.log", "GET", "localhost", 404),
        ("/%2e%2e/etc/passwd", "GET", "localhost", 404),
        ("http://localhost/", "GET", "localhost", 404),
        ("/state", "POST", "localhost", 501),
        ("/", "DELETE", "localhost", 501),
    ],
)
def test_only_this_computer_gets_only_the_page(
    tmp_path: Path, path: str, method: str, host: str, status: int
) -> None:
    with LiveReport(tmp_path) as page:
        assert page.address.startswith("http://127.0.0.1:")
        assert ask(page, path, method, Host=host)[0] == status


def test_port_is_free_after_the_end(tmp_path: Path) -> None:
    with LiveReport(tmp_path) as page:
        port = int(page.address.rstrip("/").rpartition(":")[2])
        with pytest.raises(FreneticError, match=rf"port {port} .*choose another"):
            LiveReport(tmp_path, port=port)
    page.close()
    with socket.socket() as free:
        assert free.connect_ex(("127.0.0.1", port)) != 0
    with LiveReport(tmp_path, port=port) as page:
        assert ask(page, "/")[0] == 200


def test_file_is_no_folder_of_a_campaign(tmp_path: Path) -> None:
    (tmp_path / "c").touch()
    with pytest.raises(CampaignError, match="is not a folder"):
        LiveReport(tmp_path / "c")


# In a browser


def test_page_grows_under_its_reader(
    browser: Browser, begin: Callable[[], Growing], tmp_path: Path
) -> None:
    trouble = Trouble()
    with LiveReport(tmp_path / "c", interval=0.05) as served:
        page = browser.new_context(viewport={"width": 1280, "height": 900}).new_page()
        page.on("pageerror", lambda error: trouble.errors.append(str(error)))
        page.on("console", lambda message: trouble.errors.append(message.text))
        page.goto(served.address)
        expect(page.locator("#live")).to_contain_text("there is no campaign")
        campaign = begin()
        campaign.grow(100)
        failures = sum(one.outcome is Outcome.FAIL for one in campaign.store.tests())
        expect(page.locator("h1")).to_contain_text("in 100 simulations")
        expect(page.locator("#live")).to_contain_text("running")
        # A reader looks at the map, has opened a failure and looks for some.
        page.get_by_role("button", name="wall time").click()
        page.locator("#gallery-search").fill("bend")
        page.locator("#map").evaluate("map => map.scrollIntoView({behavior: 'instant'})")
        headline = page.locator("#map h2")
        top = headline.evaluate("one => one.getBoundingClientRect().top")
        cards = page.locator(".gallery .card")
        before = cards.count()
        kept = cards.first.element_handle()
        player = page.get_by_role("dialog")
        cards.first.evaluate("card => card.click()")
        title = player.locator("h2").text_content()
        campaign.grow(20)
        expect(page.locator("h1")).to_contain_text("in 120 simulations")
        assert player.locator("h2").text_content() == title
        page.keyboard.press("Escape")
        assert abs(headline.evaluate("one => one.getBoundingClientRect().top") - top) < 1.0  # px
        assert page.locator("#gallery-search").input_value() == "bend"
        expect(page.locator(".switch [aria-pressed=true]")).to_have_text("wall time")
        assert kept.evaluate("card => card.isConnected")  # not drawn again
        assert cards.count() >= before
        assert sum(one.outcome is Outcome.FAIL for one in campaign.store.tests()) > failures
        campaign.finish()
        expect(page.locator("#live")).to_contain_text("finished")
        expect(page.locator("#summary")).not_to_contain_text("Not finished")
        assert trouble.errors == []
    expect(page.locator("#live")).to_contain_text("not served any more")
    expect(page.locator("h1")).to_contain_text("in 120 simulations")
    page.context.close()
