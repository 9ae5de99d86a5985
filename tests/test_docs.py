"""Every code block of README and docs runs, page by page, from top to bottom."""

from __future__ import annotations

import json
import re
import shlex
from pathlib import Path
from runpy import run_path
from typing import TYPE_CHECKING, Any

import pytest

from frenetic import CampaignStore

if TYPE_CHECKING:
    from interpreters import Interpreter

pytest_plugins = ["interpreters"]

ROOT = Path(__file__).parent.parent
NOTEBOOK = ROOT / "docs" / "notebook.ipynb"
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")])
RESEARCH = sorted((ROOT / "research").glob("*.md"))
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\((?!https?:)([^)#]+)")

# Blocks of these kinds are shown, not run: a fragment of a user's own file, benchmarks, which take
# data or time that a test does not have, Python (py) that needs what tests do not install, and the
# client in JavaScript, which a test of its command runs.
SHOWN = {"toml", "console", "text", "py", "javascript"}
# What a page may ask the reader to do beside running Frenetic: setting up. `.ci/run` does that.
SET_UP = ("python3 -m venv", "git clone", ".venv/bin/", ".ci/run")
# A reader searches until there is much to see. Here the same commands run, on fewer roads, but for
# pages that promise what will be found or name a late test.
ENOUGH = {"simulations": 40, "repeats": 2, "times": 2}
NUMBER = re.compile(rf"\b({'|'.join(ENOUGH)})([ =])(\d+)\b")


def run_page(page: Path, interpreter: Interpreter, folder: Path) -> None:
    for kind, text in BLOCK.findall(page.read_text(encoding="utf-8")):
        text = text if page.name in IN_FULL else shortened(text)
        if kind == "python":
            run_python(text, interpreter, folder)
        elif kind == "sh":
            for line in text.splitlines():
                command = line.split("  # ")[0].strip()
                run_command(command, interpreter, folder, pictures=page.name in DRAWN)
        else:
            assert kind in SHOWN, f"{page.name}: nobody runs a block of kind {kind!r}"


def shortened(text: str) -> str:
    """Commands or code with numbers of drives that are at most enough."""
    return NUMBER.sub(lambda one: f"{one[1]}{one[2]}{min(int(one[3]), ENOUGH[one[1]])}", text)


def failed(folder: Path) -> int:
    with CampaignStore.open(folder) as store:
        return store.counts().failed


def start_keeps_its_promises(folder: Path) -> None:
    """What the page says of the campaigns that it runs."""
    assert failed(folder / "mine") > 0
    assert failed(folder / "farther") == 0
    assert len(list((folder / "farther" / "failures").glob("near-miss-*.png"))) == 5


def tutorial_keeps_its_promises(folder: Path) -> None:
    assert failed(folder / "first") > 0
    assert failed(folder / "one") == 1


PROMISES = {"index.md": start_keeps_its_promises, "tutorial.md": tutorial_keeps_its_promises}
"""Name of a page -> the check of what it promises, in the folder in which it ran."""
IN_FULL = {"index.md", "rerun.md"}
"""Pages whose campaigns are not shortened."""
DRAWN = {"README.md", "calibrating.md", "files.md"}
"""Pages whose commands draw pictures, of each kind: they take most of a short search's time."""


def run_python(text: str, interpreter: Interpreter, folder: Path) -> None:
    name = re.match(r"# file: (\S+)\n", text)
    if name is None:
        ended = interpreter.python(text, folder=folder)
        assert ended.code == 0, f"{text}\n{ended.output}"
        return
    (folder / name[1]).write_text(text, encoding="utf-8")
    if name[1].startswith("test_"):
        run_tests(name[1], interpreter, folder)


def run_command(line: str, interpreter: Interpreter, folder: Path, *, pictures: bool) -> None:
    if not line or line.startswith(SET_UP):
        return
    program, *arguments = shlex.split(line)
    assert program == "frenetic", f"a page asks for {line!r}, which no test runs"
    ended = interpreter.frenetic(*arguments, folder=folder, pictures=pictures)
    assert ended.code == 0, f"{line}\n{ended.output}"


def run_tests(name: str, interpreter: Interpreter, folder: Path) -> None:
    arguments = ["-q", "-p", "no:cacheprovider", name]
    code = f"import pytest; raise SystemExit(pytest.main({arguments}))"
    ended = interpreter.python(code, folder=folder)
    assert ended.code == 0, f"{name}\n{ended.output}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_code_runs(page: Path, interpreter: Interpreter, tmp_path: Path) -> None:
    run_page(page, interpreter, tmp_path)
    if page.name in PROMISES:
        PROMISES[page.name](tmp_path)


def test_the_search_of_the_readme_runs_again(interpreter: Interpreter, tmp_path: Path) -> None:
    kinds = BLOCK.findall((ROOT / "README.md").read_text(encoding="utf-8"))
    search = shortened(next(text for kind, text in kinds if kind == "python"))
    for _ in range(2):
        run_python(search, interpreter, tmp_path)


@pytest.mark.parametrize("page", [*PAGES, *RESEARCH], ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in LINK.findall(page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), target


@pytest.mark.parametrize("page", sorted((ROOT / "docs").rglob("*.md")), ids=lambda page: page.name)
def test_page_has_its_place_in_the_site(page: Path) -> None:
    name = page.relative_to(ROOT / "docs").as_posix()
    assert f'= "{name}" }}' in (ROOT / "zensical.toml").read_text(encoding="utf-8")


def test_pages_find_a_block_to_run() -> None:
    kinds = [kind for page in PAGES for kind, _ in BLOCK.findall(page.read_text(encoding="utf-8"))]
    assert kinds.count("python") >= 8
    assert kinds.count("sh") >= 6


# The tutorial notebook: its cells run here, by what writes their outputs into it


def shown(notebook: dict[str, Any]) -> list[tuple[str, list[str]]]:
    """The kinds of output of each code cell, in order, by the cell's id."""
    return [
        (cell["id"], [kind for one in cell["outputs"] for kind in one.get("data", {"text": ""})])
        for cell in notebook["cells"]
        if cell["cell_type"] == "code"
    ]


def test_the_notebook_runs_and_holds_what_it_shows(tmp_path: Path) -> None:
    text = NOTEBOOK.read_text(encoding="utf-8")
    stored = json.loads(text)
    made = run_path(str(ROOT / "docs" / "make_notebook.py"))
    assert shown(made["run_notebook"](stored, tmp_path)) == shown(stored)
    figures = made["figures"](stored)
    images = (ROOT / "docs" / "images").glob("notebook-*.png")
    assert figures == {image.name: image.read_bytes() for image in images}
    page = (ROOT / "docs" / "notebooks.md").read_text(encoding="utf-8")
    assert [name for name in figures if f"(images/{name})" not in page] == []
    assert len(text.encode()) < 300_000
    assert str(ROOT) not in text
    words = "".join(line for cell in stored["cells"] for line in cell["source"])
    assert all((NOTEBOOK.parent / target).exists() for target in LINK.findall(words))
