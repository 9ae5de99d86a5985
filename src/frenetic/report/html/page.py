"""A page from its data: one self-contained HTML file."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from frenetic._support.files import write_file
from frenetic._support.words import signed
from frenetic.report.html.blocks import Block, Section, to_json
from frenetic.report.html.tests import DriveData, TestTable

REPLAY_SCRIPTS: Final = ("base.js", "road.js", "elsewhere.js", "player.js", "replay.js")
"""Files in ``static`` that a page with one replay needs, in this order."""
SCRIPTS: Final = (
    *REPLAY_SCRIPTS[:-1],
    *("gallery.js", "map.js", "tests.js", "charts.js", "main.js"),
)
"""Files in ``static`` that draw a page of sections, in this order."""
CHARTS: Final = ("uPlot.iife.min.js", "uPlot.min.css")
"""The library that draws charts, as npm has it (MIT)."""
SCRIPTED: Final = frozenset({"chart", "switch", "gallery", "elsewhere", "featureMap", "tests"})
"""Kinds of blocks that the script draws; the template draws the others."""

_SECTION_ID: Final = re.compile(r"[a-z][a-z0-9-]*")


@dataclass(frozen=True)
class Report:
    """The contents of a page."""

    title: str
    sections: tuple[Section, ...]
    campaign: str = ""
    """The campaign's folder, quoted for a shell."""
    drive_options: str | None = None
    """Options that drive its roads as they were driven; None if a command line cannot."""
    made_by: str = ""
    """The program and its version."""
    lane_width: float = 4.0
    """m."""
    tests: TestTable | None = None
    """All tests."""
    drives: tuple[DriveData, ...] = ()
    """Those of them with a drive in the page."""
    replay: int | None = None
    """Id of the test whose replay is all of the page; None for a page of sections."""


def render(report: Report) -> str:
    """The page: self-contained HTML that may load nothing.

    Raises:
        ValueError: a section's id is invalid or not unique.
    """
    ids = [section.id for section in report.sections]
    for name in ids:
        if _SECTION_ID.fullmatch(name) is None or ids.count(name) > 1:
            raise ValueError(
                f"a section's id is {name!r}: letters, digits and hyphens are needed, and each id"
                " once"
            )
    scripted = [b for s in report.sections for b in s.blocks if b.kind in SCRIPTED]
    is_replay = report.replay is not None
    script, style = _assets(REPLAY_SCRIPTS if is_replay else SCRIPTS, has_charts=not is_replay)
    data = {
        name: getattr(report, name)
        for name in (
            "title",
            "campaign",
            "drive_options",
            "lane_width",
            "tests",
            "drives",
            "replay",
        )
    }
    page = _templates().get_template("page.html")
    text = page.render(
        report=report,
        is_scripted=_is_scripted,
        policy=_policy(script, style),
        style=Markup(style),  # noqa: S704  # our own
        script=Markup(script),  # noqa: S704  # likewise
        data=_island({**data, "blocks": scripted}),
    )
    # A name of a file may hold what no encoding has.
    return text.encode("utf-8", "replace").decode()


def write_page(report: Report, path: Path | str) -> Path:
    """Writes a page whole or not at all.

    Raises:
        FreneticError: it cannot be written.
    """
    path = Path(path)
    write_file(path, render(report), remedy="choose another place for the page")
    return path


def made_by() -> str:
    """The program and its version, for the foot of a page."""
    try:
        return f"frenetic {version('frenetic-roads')}"
    except PackageNotFoundError:
        return "frenetic, version unknown"


def _is_scripted(block: Block) -> bool:
    return block.kind in SCRIPTED


def _island(data: Mapping[str, Any]) -> Markup:
    """JSON whose texts cannot end a script element."""
    text = json.dumps(to_json(data), allow_nan=False, separators=(",", ":"))  # ASCII, so no U+2028
    for sign in "&<>":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return Markup(text)  # noqa: S704  # nothing in it is markup any more


def _policy(script: str, style: str) -> str:
    """A content security policy that allows this script and style and loads nothing."""
    hashed = (
        base64.b64encode(hashlib.sha256(t.encode()).digest()).decode() for t in (script, style)
    )
    script_src, style_src = (f"'sha256-{one}'" for one in hashed)
    return (
        f"default-src 'none'; script-src {script_src}; style-src {style_src}; img-src data:;"
        " base-uri 'none'; form-action 'none'"
    )


@cache
def _templates() -> Environment:
    templates = Environment(
        loader=PackageLoader("frenetic.report.html"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    templates.filters["tick"] = lambda value: f"{value:.6g}".replace("-", "−")
    templates.filters["fixed"] = signed
    return templates


@cache
def _assets(scripts: tuple[str, ...], *, has_charts: bool) -> tuple[str, str]:
    """The page's script and its style."""
    library, its_style = CHARTS if has_charts else (None, None)
    own = "\n".join(_text(name) for name in scripts)
    script = f'"use strict";\n(() => {{\n{own}\n}})();\n'
    if library is not None:
        script = f"{_text(library)}\n{script}"
    style = _text("report.css")
    if its_style is not None:
        style = f"{_text(its_style)}\n{style}"
    return _unbreakable(script), style


def _text(name: str) -> str:
    return files(__package__).joinpath("static", name).read_text(encoding="utf-8")


def _unbreakable(script: str) -> str:
    """A script for a page: one line end, and nothing that ends its element."""
    script = script.replace("\r\n", "\n").replace("\r", "\n").replace("\0", "\\0")
    return re.sub(r"<(?=/script|script|!--)", r"\\x3c", script, flags=re.IGNORECASE)
