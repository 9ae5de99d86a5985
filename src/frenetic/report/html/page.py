"""A page from its data: one self-contained HTML file."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from frenetic._support.files import write_file
from frenetic.report.html.blocks import Section, to_json
from frenetic.report.html.tests import DriveData, TestTable

SCRIPTS: Final = (
    "base.js",
    "road.js",
    "player.js",
    "family.js",
    "gallery.js",
    "elsewhere.js",
    "map.js",
    "charts.js",
    "groups.js",
    "blocks.js",
    "main.js",
)
"""Files in ``static`` that become one script, in this order."""

_MARK: Final = re.compile(r"\{\{(\w+)\}\}")
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
    """The tests that blocks name by their ids."""
    drives: tuple[DriveData, ...] = ()
    """Those of them with a drive in the page."""
    replay: int | None = None
    """Id of the test whose replay is all of the page; None for a page of sections."""


def render(report: Report, scripts: tuple[str, ...] = SCRIPTS) -> str:
    """The page: self-contained HTML that may load nothing.

    Args:
        report: its contents.
        scripts: files in ``static`` that draw it, in order.

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
    script = _script(scripts)
    style = _text("report.css")
    parts = {
        "title": html.escape(report.title),
        "policy": _policy(script, style),
        "style": style,
        "data": _island(to_json(report)),
        "script": script,
    }
    return _MARK.sub(lambda mark: parts[mark[1]], _text("template.html"))


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


def _island(data: Any) -> str:
    """JSON whose texts cannot end a script element."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))  # ASCII, so no U+2028 either
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


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
def _text(name: str) -> str:
    return files(__package__).joinpath("static", name).read_text(encoding="utf-8")


@cache
def _script(scripts: tuple[str, ...]) -> str:
    parts = "\n".join(_text(name) for name in scripts)
    return _unbreakable(f'"use strict";\n(() => {{\n{parts}\n}})();\n')


def _unbreakable(script: str) -> str:
    """A script for a page: one line end, and nothing that ends its element."""
    script = script.replace("\r\n", "\n").replace("\r", "\n").replace("\0", "\\0")
    return re.sub(r"<(?=/script|script|!--)", r"\\x3c", script, flags=re.IGNORECASE)
