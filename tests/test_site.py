"""The documentation site, built from docs/ and the docstrings."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import quote_plus

import pytest
from html_browser import background
from playwright.sync_api import Browser

import frenetic

pytest_plugins = ["browsing"]
pytestmark = pytest.mark.heavy

ROOT = Path(__file__).parent.parent
ELSEWHERE = r"[\"']?((?:https?:)?//[^\"' >)]+)"
LOADED = re.compile(
    rf"<(?:script|img|iframe|source|video|audio|embed|object)\b[^>]*?(?:src|data)={ELSEWHERE}"
    rf"|<link\b(?![^>]*rel=[\"']?canonical)[^>]*?href={ELSEWHERE}"
    rf"|(?:url\(|@import\s+){ELSEWHERE}"
)
"""Matches addresses of other hosts from which a page or a style sheet loads."""

QUESTIONS = {
    "getting started": "index.html",
    "install": "index.html#install",
    "write my own driver": "drivers.html#your-own",
    "what is MOOBD": "index.html#when-a-drive-fails-and-what-moobd-is",
    "compare two versions of a driver": "comparing.html#two-versions-of-a-driver",
    "resume crash": "campaigns.html",
    "several computers": "cluster.html",
    "beamng": "beamng.html",
    "my own simulator": "simulators.html#your-own",
    "opendrive": "exports.html",
    "fail in CI": "command-line.html#ci",
    "same seed": "campaigns.html#same-seed-same-campaign",
    "failure real": "rerun.html",
    "minimise": "minimising.html",
    "reproduce the paper": "paper.html",
}
"""Search of a new user -> the page, or its part, with the answer."""


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Folder of the built site, and the output of the build."""
    folder = tmp_path_factory.mktemp("site")
    shutil.copy(ROOT / "zensical.toml", folder)
    for part in ("docs", "src"):
        junk = shutil.ignore_patterns("__pycache__", "*.nb[ic]")
        shutil.copytree(ROOT / part, folder / part, ignore=junk)
    process = subprocess.run(
        [sys.executable, "-m", "zensical", "build", "--strict"],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
    )
    assert process.returncode == 0, process.stdout
    return folder / "site", process.stdout


@pytest.fixture(scope="module")
def address(built: tuple[Path, str]) -> Iterator[str]:
    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, format: str, *args: object) -> None:  # noqa: A002  # the base class's name
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(built[0]))) as server:
        serving = threading.Thread(target=server.serve_forever)
        serving.start()
        yield f"http://127.0.0.1:{server.server_address[1]}/"
        server.shutdown()
        serving.join()


def test_the_build_reports_no_issues(built: tuple[Path, str]) -> None:
    assert "No issues found" in built[1]
    assert "griffe" not in built[1]  # griffe reads the docstrings


def test_pages_load_nothing_from_other_hosts(built: tuple[Path, str]) -> None:
    files = [path for kind in ("html", "css") for path in built[0].rglob(f"*.{kind}")]
    assert len(files) > 40
    for path in files:
        addresses = LOADED.findall(path.read_text(encoding="utf-8"))
        assert not addresses, f"{path.name}: {addresses}"


def test_every_public_name_is_in_the_reference(built: tuple[Path, str]) -> None:
    pages = {page.stem: page.read_text(encoding="utf-8") for page in (built[0] / "api").iterdir()}
    overview = pages.pop("index")
    for name in frenetic.__all__:
        assert re.search(rf'href="\w+\.html#frenetic\.(\w+\.)+{name}"', overview), (
            f"docs/api/index.md does not name frenetic.{name}"
        )
    for package, page in pages.items():
        room = f"frenetic.{package}"
        room = room if find_spec(room) else f"frenetic.plugins.{package}"
        for name in getattr(import_module(room), "__all__", ()):
            assert re.search(rf'id="{re.escape(room)}\.(\w+\.)*{name}"', page), name


def test_anchors_linked_from_readme_and_other_pages_exist(built: tuple[Path, str]) -> None:
    for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md"):
        text = (ROOT / name).read_text(encoding="utf-8")
        for page, anchor in re.findall(r"\]\(docs/([\w/-]+)\.md#([^)]+)\)", text):
            target = built[0] / f"{page}.html"
            assert f'id="{anchor}"' in target.read_text(encoding="utf-8"), f"{page}.md#{anchor}"


def test_the_search_box_answers_a_new_users_questions(browser: Browser, address: str) -> None:
    page = browser.new_page()
    requests: list[str] = []
    page.on("request", lambda request: requests.append(request.url))
    page.goto(address)
    page.get_by_role("button", name="Search").first.click()
    box = page.locator("input:visible").first
    results = page.locator("a[href*='?h=']")
    for question, answer in QUESTIONS.items():
        box.fill(question)
        query = f"?h={quote_plus(question)}"
        for _ in range(300):  # results appear one after the other
            links: list[str] = results.evaluate_all("links => links.map(link => link.href)")
            first = [link.removeprefix(address) for link in links[:3] if query in link]
            if any(link.replace(query, "").startswith(answer) for link in first):
                break
            page.wait_for_timeout(100)
        else:
            pytest.fail(f"{question}: {first}")
    assert all(url.startswith(address) for url in requests)
    page.close()


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_pages_fit_a_phone_and_the_readers_scheme(
    browser: Browser, address: str, scheme: str
) -> None:
    context = browser.new_context(
        viewport={"width": 390, "height": 844},
        color_scheme="dark" if scheme == "dark" else "light",
    )
    page = context.new_page()
    for name in ("index", "command-line", "measures", "api/campaign"):
        page.goto(f"{address}{name}.html")
        assert page.evaluate("document.documentElement.scrollWidth") <= 390, name
        assert (background(page) > 600) == (scheme == "light"), name
    context.close()
