"""A page from its data: one self-contained HTML file."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from msgspec.json import encode

from frenetic._support.files import write_file
from frenetic._support.words import signed
from frenetic.report.html.blocks import Block, Part, Section

REPLAY_SCRIPTS: Final = ("base.js", "road.js", "elsewhere.js", "player.js", "replay.js")
"""Files in ``static`` that a page with one replay needs, in this order."""
SCRIPTS: Final = (
    *REPLAY_SCRIPTS[:-1],
    *("gallery.js", "map.js", "tests.js", "charts.js", "main.js"),
)
"""Files in ``static`` that draw a page of sections, in this order."""
SCRIPTED: Final = frozenset({"chart", "switch", "gallery", "elsewhere", "featureMap", "tests"})
"""Kinds of blocks that the script draws; the template draws the others."""

_SECTION_ID: Final = re.compile(r"[a-z][a-z0-9-]*")


def made_by() -> str:
    """The program and its version, for the foot of a page."""
    try:
        return f"frenetic {version('frenetic-roads')}"
    except PackageNotFoundError:
        return "frenetic, version unknown"


@dataclass(frozen=True)
class Report:
    """The contents of a page."""

    title: str
    sections: tuple[Section, ...]
    made_by: str = field(default_factory=made_by)
    """The program and its version."""
    data: Mapping[str, Any] = field(default_factory=dict)
    """What the script needs beside the blocks, see `campaign_report` and `animate`."""


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
    blocks = [b for s in report.sections for b in s.blocks if b.kind in SCRIPTED]
    script, style = _assets(is_replay="replay" in report.data)
    text = (
        _templates()
        .get_template("page.html")
        .render(
            report=report,
            scripted=SCRIPTED,
            policy=_policy(script, style),
            style=Markup(style),  # noqa: S704  # our own
            script=Markup(script),  # noqa: S704  # likewise
            data=_island({**report.data, "title": report.title, "blocks": [*map(_plain, blocks)]}),
        )
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


def _plain(block: Block) -> dict[str, Any]:
    return {"kind": block.kind, **(block.data if isinstance(block, Part) else vars(block))}


def _island(data: Mapping[str, Any]) -> Markup:
    """JSON whose texts cannot end a script element."""
    text = encode(data).decode()  # what is not finite is null
    for sign in "&<>\u2028\u2029":
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
    templates.filters["fixed"] = signed
    return templates


@cache
def _assets(*, is_replay: bool) -> tuple[str, str]:
    """The page's script and its style, with the library that draws charts (uPlot, MIT)."""
    own = "\n".join(map(_text, REPLAY_SCRIPTS if is_replay else SCRIPTS))
    script, style = f'"use strict";\n(() => {{\n{own}\n}})();\n', _text("report.css")
    if not is_replay:
        script = f"{_text('uPlot.iife.min.js')}\n{script}"
        style = f"{_text('uPlot.min.css')}\n{style}"
    # A script has one line end, and nothing that ends its element.
    script = script.replace("\r\n", "\n").replace("\r", "\n").replace("\0", "\\0")
    return re.sub(r"<(?=/script|script|!--)", r"\\x3c", script, flags=re.IGNORECASE), style


def _text(name: str) -> str:
    return files(__package__).joinpath("static", name).read_text(encoding="utf-8")
