"""Code of README and docs runs, page by page, and prints the outputs that the page shows."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from itertools import chain, repeat
from pathlib import Path
from runpy import run_path
from shutil import copy, copytree, which
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from PIL import Image

from frenetic._support.arrays import FloatArray

if TYPE_CHECKING:
    from interpreters import Interpreter

pytest_plugins = ["interpreters"]

ROOT = Path(__file__).parent.parent
NOTEBOOK = ROOT / "docs" / "notebook.ipynb"
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")])
SITE = tomllib.loads((ROOT / "zensical.toml").read_text(encoding="utf-8"))["project"]["nav"]
"""The site's titles with their pages, in folders."""
RESEARCH = sorted((ROOT / "research").glob("*.md"))
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\((?!https?:)([^)#]+)")

# Blocks of these kinds do not run: fragments of files; benchmarks, which need data or much time;
# Python (py) that needs packages which tests do not install.
SHOWN = {"toml", "console", "py"}
SOURCES = {"cpp", "js", "rust"}
"""Kinds of blocks with the text of a program's file, whose name the first line has."""
TOOLS = {"g++": False, "node": True, "rustc": True}
"""Program that builds or runs such a file -> whether it may be missing where tests run."""
OUTPUT = "text"
"""Kind of a block that shows the output of the block before it."""
# Commands of a page that set up Frenetic; `.ci/run` runs them.
SET_UP = ("python3 -m venv", "git clone", ".venv/bin/", ".ci/run")
# Tests run the same commands with fewer drives, except on pages that show outputs.
MOST_DRIVES = {"simulations": 40, "repeats": 2, "times": 2}
NUMBER = re.compile(rf"\b({'|'.join(MOST_DRIVES)})([ =])(\d+)\b")
OF_THE_MACHINE = re.compile(
    r"in \d+:\d\d(:\d\d)?(, \d+:\d\d of it to start)?, [\d.,]+ tests/\w+"  # of a search
    r"|\(in \d+:\d\d(:\d\d)?\)|In all: +\d+:\d\d(:\d\d)?"
    r"|\d{4}-\d\d-\d\d[ T]\d\d:\d\d:\d\d[.\d]*(\+\d\d:\d\d)?"
    r"|\b(?=[a-f]*\d)[0-9a-f]{8}\b"  # digests, also of versions
)
"""Parts of an output that depend on machine and time."""
Runs = dict[str, tuple[Path, str]]
"""Command -> its folder and its output."""


def run_page(
    page: Path, interpreter: Interpreter, folder: Path, earlier_runs: Runs | None = None
) -> str:
    """Run a page's blocks; return the page with their current outputs."""
    text = page.read_text(encoding="utf-8")
    in_full = f"```{OUTPUT}\n" in text
    printed: str | None = None

    def run(block: re.Match[str]) -> str:
        nonlocal printed
        kind, code = block.groups()
        if kind == OUTPUT:
            assert printed is not None, f"{page.name}: no block printed this:\n{code}"
            now, printed = as_shown(printed, code), None
            return f"```{OUTPUT}\n{code if masked(now) == masked(code) else now}```"
        if kind in SOURCES:
            name = re.match(r"// file: ([\w.]+)", code)
            assert name is not None, f"{page.name}: {kind} without a file's name"
            (folder / name[1]).write_text(code, encoding="utf-8")
        elif kind in {"python", "sh"}:
            code = code if in_full else shortened(code)
            if kind == "python":
                printed = run_python(code, interpreter, folder)
            else:
                drawn = [Path(name).name for name in PICTURES.get(page.name, {}).values()]
                printed = run_commands(code, interpreter, folder, earlier_runs, drawn)
        else:
            assert kind in SHOWN, f"{page.name}: no test knows blocks of kind {kind!r}"
            if name := re.match(r"# file: (\S+\.toml)\n", code):
                (folder / name[1]).write_text(code, encoding="utf-8")
        return block[0]

    return BLOCK.sub(run, text)


def as_shown(printed: str, shown: str) -> str:
    """Return the part of an output that a page shows.

    A line ``...`` stands for any number of lines, "..." at a line's end for its rest. The line
    after ``...`` says where the output is shown again.
    """
    lines = [line.rstrip() for line in printed.rstrip().splitlines()]
    pattern = shown.splitlines()
    if "..." in pattern:
        first = pattern.index("...")
        rest = pattern[first + 1 :]
        last = len(lines) - len(rest)
        start = rest[0].removesuffix("...") if rest else ""
        again = [i for i in range(first, len(lines)) if start and lines[i].startswith(start)]
        end = min(again, key=lambda i: abs(i - last), default=last)
        lines[first:end] = ["..."]
    return "".join(
        f"{line[: len(old) - 3]}...\n" if old.endswith("...") and old != line else f"{line}\n"
        for line, old in zip(lines, chain(pattern, repeat("")), strict=False)
    )


def masked(text: str) -> str:
    """Return a text without the parts that depend on the machine."""
    return OF_THE_MACHINE.sub("*", text)


def shortened(text: str) -> str:
    """Return commands or code with at most `MOST_DRIVES`."""
    return NUMBER.sub(lambda m: f"{m[1]}{m[2]}{min(int(m[3]), MOST_DRIVES[m[1]])}", text)


PICTURES = {
    "margin.md": {"margins.png": "margins.png"},
    "README.md": {
        "failure.png": "first/minimised/test-00409.png",
        "gallery.png": "first/failures/gallery.png",
    },
    "manoeuvres.md": {"manoeuvre-step.png": "step.png"},
}
"""Name of a page -> the pictures in docs/images that its commands draw."""


def run_python(text: str, interpreter: Interpreter, folder: Path) -> str:
    """Run Python code, or write it into the file that it names; return its output."""
    name = re.match(r"# file: (\S+)\n", text)
    if name is None:
        ended = interpreter.python(text, folder=folder)
        assert ended.code == 0, f"{text}\n{ended.output}"
        return ended.stdout
    (folder / name[1]).write_text(text, encoding="utf-8")
    if name[1].startswith("test_"):
        run_tests([name[1]], interpreter, folder, passes=True)
    return ""


def run_commands(
    text: str, interpreter: Interpreter, folder: Path, earlier_runs: Runs | None, drawn: list[str]
) -> str:
    """Run commands; return the output of the last."""
    printed = ""
    missing = {tool for tool, may_be_missing in TOOLS.items() if may_be_missing and not which(tool)}
    if missing & set(re.findall(r"[\w+]+", text)):
        return printed
    for line in text.splitlines():
        command = line.split("  # ")[0].strip()
        if not command or command.startswith(SET_UP):
            continue
        program, *arguments = shlex.split(command)
        if program == "pytest":
            printed = run_tests(arguments, interpreter, folder)
            continue
        if program in TOOLS:
            subprocess.run([program, *arguments], cwd=folder, check=True)
            continue
        assert program == "frenetic", f"a page asks for {command!r}, which no test runs"
        if earlier_runs and command in earlier_runs:
            before, printed = earlier_runs[command]
            copytree(before, folder / before.name)
            continue
        ended = interpreter.frenetic(*arguments, folder=folder, drawn=drawn)
        assert ended.code == 0, f"{command}\n{ended.output}"
        printed = ended.stdout
        if earlier_runs is not None and arguments[0] == "run":
            earlier_runs[command] = folder / arguments[-1], printed
    return printed


def run_tests(
    names: list[str], interpreter: Interpreter, folder: Path, *, passes: bool = False
) -> str:
    """Run pytest; return its output. A page may show tests that fail."""
    arguments = ["-q", "-p", "no:cacheprovider", *names]
    code = f"import pytest; raise SystemExit(pytest.main({arguments}))"
    ended = interpreter.python(code, folder=folder)
    assert ended.code in ((0,) if passes else (0, 1)), f"{names}\n{ended.output}"
    return ended.stdout


TOGETHER = [["README.md", "index.md"], ["causes.md", "minimising.md"]]
"""Pages that begin with the same search."""
GROUPS = [[page for page in PAGES if page.name in names] for names in TOGETHER]
GROUPS += [[page] for page in PAGES if not any(page in group for group in GROUPS)]


@pytest.mark.heavy
@pytest.mark.parametrize("pages", GROUPS, ids=lambda pages: pages[0].name)
def test_code_runs_and_prints_the_outputs_of_its_page(
    pages: list[Path], interpreter: Interpreter, tmp_path: Path, pytestconfig: pytest.Config
) -> None:
    images, earlier_runs = ROOT / "docs" / "images", Runs()
    remedy = "pytest --all tests/test_docs.py --write-outputs"
    for page in pages:
        folder, pictures = tmp_path / page.stem, PICTURES.get(page.name, {})
        folder.mkdir()
        text = run_page(page, interpreter, folder, earlier_runs)
        if pytestconfig.getoption("--write-outputs"):
            page.write_text(text, encoding="utf-8", newline="\n")
            for name, drawn in pictures.items():
                copy(folder / drawn, images / name)
        assert text == page.read_text(encoding="utf-8"), remedy
        for name, drawn in pictures.items():
            difference = np.abs(coarse(folder / drawn) - coarse(images / name)).max()
            assert difference < 50, f"{name}: {remedy}"


def coarse(picture: Path) -> FloatArray:
    """Return the brightness of 64 by 64 parts of a picture, 0..255.

    Other fonts change it by less than 30.
    """
    with Image.open(picture) as image:
        return np.asarray(image.convert("L").resize((64, 64), Image.Resampling.BOX), float)


def test_link_targets_exist_and_the_site_has_every_page() -> None:
    for page in (*PAGES, *RESEARCH):
        for target in LINK.findall(page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name}: {target}"
    site = (ROOT / "zensical.toml").read_text(encoding="utf-8")
    for page in (ROOT / "docs").rglob("*.md"):
        assert f'= "{page.relative_to(ROOT / "docs").as_posix()}" }}' in site


def test_the_first_page_begins_with_title_summary_and_picture() -> None:
    (first, *_) = pages_in_order(SITE)
    title, words, picture, *_ = first.read_text(encoding="utf-8").split("\n\n")
    assert title == "# Frenetic finds the roads on which an automated driver leaves its lane"
    assert len(re.findall(r"\.(?:\s|$)", words)) in (2, 3)  # sentences
    assert "](images/failure.png)" in picture


# The site's pages, pasted into one folder


def pages_in_order(entries: list[dict[str, Any]]) -> Iterator[Path]:
    """Yield the pages of the site in the order of its navigation."""
    for entry in entries:
        for target in entry.values():
            if isinstance(target, str):
                yield ROOT / "docs" / target
            else:
                yield from pages_in_order(target)


CREATES = re.compile(
    r"""--out[ ]([^\s/]+)|"--out",[ ]"([^"]+)"|folder=(?:Path\()?"([^"]+)"  # campaigns, reports
    |^\#[ ]file:[ ](\S+)|frenetic[ ]init(?:[ ](\S+))?$                    # code
    |copy\(\w+,[ ]"([^"]+)"|Path\("([^"]+)"\)\.write|\.write\(Path\("([^"]+)"
    |open\("([^"]+)",[ ]"w"|mkdir\("([^"]+)"|--(?:plot|junit|trace)[ ](\S+)""",
    re.MULTILINE | re.VERBOSE,
)
"""Files and folders that a block creates."""
READS = re.compile(
    r"frenetic (?:calibrate|check|compare|drive|estimate|export|margin|minimise|rank|report|rerun"
    r"|resume|show) ([a-z][\w-]*)(?!\S*=)"
)
"""The folder or file that a command reads, up to its first dot or slash."""


def created_by(page: Path) -> set[str]:
    """Return files and folders that the code of a page creates."""
    created = set()
    for kind, code in BLOCK.findall(page.read_text(encoding="utf-8")):
        if kind != OUTPUT:
            for match in CREATES.finditer(code):
                created.add(next(filter(None, match.groups()), "my_driver.py"))
    return created


def test_no_two_pages_create_the_same_file_or_folder() -> None:
    pages = {page: created_by(page) for page in pages_in_order(SITE)}
    assert len(set().union(*pages.values())) > 60
    creators = Counter(chain.from_iterable(pages.values()))
    twice = {name: number for name, number in creators.items() if number > 1}
    assert {name: [page.name for page in pages if name in pages[page]] for name in twice} == {}


def test_a_page_creates_each_campaign_once_and_reads_only_what_it_created() -> None:
    for page in pages_in_order(SITE):
        blocks = BLOCK.findall(page.read_text(encoding="utf-8"))
        code = "\n".join(code for kind, code in blocks if kind in {"sh", "console"})
        runs = Counter(re.findall(r"frenetic run .*--out (\S+)", code))
        assert [name for name, number in runs.items() if number > 1] == [], page.name
        created = {re.split(r"[./]", name)[0] for name in created_by(page)}
        assert set(READS.findall(code)) - created == set(), page.name


PASTED = ["pytest.md", "embedded-simulator.md"]
"""Pages of the test's short form: code, commands and tests that fail, without a search."""


@pytest.mark.heavy
@pytest.mark.endurance
def test_all_pages_run_one_after_the_other_in_one_folder(tmp_path: Path, endurance: bool) -> None:
    for page in pages_in_order(SITE):
        if endurance or page.name in PASTED:
            files = files_in(tmp_path)
            paste_page(page, tmp_path)
            now = files_in(tmp_path)
            changed = [file for file, when in files.items() if now.get(file) != when]
            assert changed == [], f"{page.name} changes files of a page before it"


def files_in(folder: Path) -> dict[Path, int]:
    """Return file -> time of its last change in ns, without Python's caches."""
    files = (file for file in folder.rglob("*") if "__pycache__" not in file.parts)
    return {file: file.stat().st_mtime_ns for file in files if file.is_file()}


def paste_page(page: Path, folder: Path) -> None:
    """Paste a page's commands into a shell and run its code, as a reader does."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    for kind, code in BLOCK.findall(page.read_text(encoding="utf-8")):
        name = re.match(r"(?:#|//) file: ([\w.]+)", code)
        if name is not None:
            (folder / name[1]).write_text(code, encoding="utf-8")
        elif kind in {"sh", "python"}:
            lines = [line for line in code.splitlines() if not line.startswith(SET_UP)]
            for command in lines if kind == "sh" else [[sys.executable, "-W", "error", "-c", code]]:
                ended = subprocess.run(
                    command,
                    shell=kind == "sh",
                    cwd=folder,
                    env=os.environ | {"PATH": path},
                    stdout=subprocess.PIPE,
                    stderr=subprocess.STDOUT,
                    encoding="utf-8",
                )
                # A page may show tests that fail.
                allowed = (0, 1) if command[:6] == "pytest" else (0,)
                assert ended.returncode in allowed, f"{page.name}: {command}\n{ended.stdout}"


# The notebook, run by the script that writes its outputs


def shown(notebook: dict[str, Any]) -> list[tuple[str, list[str], list[str]]]:
    """Return each code cell's id, kinds of output and printed texts, in order."""
    return [
        (
            cell["id"],
            [kind for output in cell["outputs"] for kind in output.get("data", {"text": ""})],
            [
                masked("".join(output.get("text") or output["data"]["text/plain"]))
                for output in cell["outputs"]
            ],
        )
        for cell in notebook["cells"]
        if cell["cell_type"] == "code"
    ]


@pytest.mark.heavy
def test_the_notebook_runs_and_stores_its_outputs_and_figures(tmp_path: Path) -> None:
    text = NOTEBOOK.read_text(encoding="utf-8")
    stored = json.loads(text)
    script = run_path(str(ROOT / "docs" / "make_notebook.py"))
    assert shown(script["run_notebook"](stored, tmp_path)) == shown(stored)
    figures = script["figures"](stored)
    images = (ROOT / "docs" / "images").glob("notebook-*.png")
    assert figures == {image.name: image.read_bytes() for image in images}
    page = (ROOT / "docs" / "notebooks.md").read_text(encoding="utf-8")
    assert [name for name in figures if f"(images/{name})" not in page] == []
    assert len(text.encode()) < 300_000
    assert str(ROOT) not in text
    words = "".join(line for cell in stored["cells"] for line in cell["source"])
    assert all((NOTEBOOK.parent / target).exists() for target in LINK.findall(words))
