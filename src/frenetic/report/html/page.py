"""A page of sections with blocks, as one self-contained HTML file.

Texts are plain: nothing in them is HTML.
"""

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
from typing import Any, ClassVar, Final, TypeAlias

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from msgspec.json import encode

from frenetic._support.files import write_file

REPLAY_SCRIPTS: Final = ("base.js", "road.js", "player.js", "replay.js")
"""Files in ``static`` that a page with one replay needs, in this order."""
SCRIPTS: Final = (
    *REPLAY_SCRIPTS[:-1],
    *("gallery.js", "map.js", "tests.js", "charts.js", "main.js"),
)
"""Files in ``static`` that draw a page of sections, in this order."""
SCRIPTED: Final = frozenset({"chart", "gallery", "featureMap", "tests"})
"""Kinds of blocks that the script draws; the template draws the others."""

_SECTION_ID: Final = re.compile(r"[a-z][a-z0-9-]*")


@dataclass(frozen=True)
class DataBlock:
    """A block of our own pages, drawn from its data by a macro or by the script."""

    kind: str
    """Name of a macro of ``templates/blocks.html``, or of a function of the script."""
    data: Mapping[str, Any]
    """Texts, numbers, and lists, mappings or dataclasses of them."""


@dataclass(frozen=True)
class Paragraph:
    """A text."""

    kind: ClassVar[str] = "paragraph"
    text: str


@dataclass(frozen=True)
class Facts:
    """Names and values, one below the other."""

    kind: ClassVar[str] = "facts"
    facts: Mapping[str, str]
    title: str = ""
    folded: bool = False
    """Whether it is folded until its title is clicked."""


@dataclass(frozen=True)
class Table:
    """Rows of texts."""

    kind: ClassVar[str] = "table"
    columns: tuple[str, ...]
    """Titles; one that begins with > is right-aligned, for numbers."""
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    links: tuple[str | None, ...] = ()
    """Relative address of the link in each row's first text, as many as rows, or none."""


@dataclass(frozen=True)
class Series:
    """A line through points, with a band around it if there is one."""

    name: str
    x: tuple[float, ...]
    """Ascending."""
    y: tuple[float, ...]
    low: tuple[float, ...] = ()
    """Lower edge of the band, as many as points, or none."""
    high: tuple[float, ...] = ()
    role: str = "accent"
    """Name of a colour of ``report.css``: accent, fail, pass, quiet, or ``group-0`` to 7."""
    dashed: bool = False
    stepped: bool = False
    """Whether the value holds until the next point."""
    width: float = 2.0
    """Width of the line, in pixels."""
    singles: tuple[tuple[float, ...], ...] = ()
    """Thin lines beside it, each with as many points."""


@dataclass(frozen=True)
class Chart:
    """Lines over a number."""

    kind: ClassVar[str] = "chart"
    series: tuple[Series, ...]
    x_title: str
    y_title: str
    caption: str = ""
    counts: bool = False
    """Whether both axes begin at 0, and the upper one has whole numbers."""
    tests: tuple[int | None, ...] = ()
    """Id of the test that a click at each point of the first line opens, or none."""


Block: TypeAlias = DataBlock | Paragraph | Facts | Table | Chart


@dataclass(frozen=True)
class Section:
    """A headline with blocks under it."""

    id: str
    """Letters, digits and hyphens; each once in a page."""
    title: str
    blocks: tuple[Block, ...]
    lead: str = ""
    """A sentence or two under the headline."""


def made_by() -> str:
    """Return the program and its version, for the foot of a page."""
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
    """Data of the script beside the blocks, see `campaign_report` and `animate`."""
    finished_at: str = ""
    """When the campaign of the page ended; empty if it has not ended, or without a campaign."""

    @property
    def finished_tag(self) -> Markup:
        """The tag near the page's beginning that says when its campaign ended."""
        return Markup('<meta name="campaign-finished" content="{}">').format(self.finished_at)


def render(report: Report) -> str:
    """Return the page as self-contained HTML that loads nothing.

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
    blocks = [
        {"kind": block.kind, **(block.data if isinstance(block, DataBlock) else vars(block))}
        for section in report.sections
        for block in section.blocks
        if block.kind in SCRIPTED
    ]
    script, style = _assets(is_replay="replay" in report.data)
    text = (
        _templates()
        .get_template("page.html")
        .render(
            report=report,
            scripted=SCRIPTED,
            policy=_policy(script, style),
            style=Markup(style),  # noqa: S704  # our own
            script=Markup(script),  # noqa: S704  # our own
            data=_island({**report.data, "title": report.title, "blocks": blocks}),
        )
    )
    # A name of a file may hold what no encoding has.
    return text.encode("utf-8", "replace").decode()


def write_page(report: Report, path: Path | str) -> Path:
    """Write a page completely or not at all.

    Raises:
        FreneticError: the file cannot be written.
    """
    path = Path(path)
    write_file(path, render(report), remedy="choose another place for the page")
    return path


def _island(data: Mapping[str, Any]) -> Markup:
    """Return data as JSON whose texts cannot end a script element."""
    text = encode(data).decode()  # what is not finite is null
    for sign in "&<>\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return Markup(text)  # noqa: S704  # nothing in it is markup any more


def _policy(script: str, style: str) -> str:
    """Return a content security policy that allows this script and style and loads nothing."""
    script_src, style_src = (
        f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
        for text in (script, style)
    )
    return (
        f"default-src 'none'; script-src {script_src}; style-src {style_src}; img-src data:;"
        " base-uri 'none'; form-action 'none'"
    )


@cache
def _templates() -> Environment:
    return Environment(
        loader=PackageLoader("frenetic.report.html"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


@cache
def _assets(*, is_replay: bool) -> tuple[str, str]:
    """Return the page's script and style, with the library that draws charts (uPlot, MIT)."""
    scripts = "\n".join(map(_text, REPLAY_SCRIPTS if is_replay else SCRIPTS))
    script, style = f'"use strict";\n(() => {{\n{scripts}\n}})();\n', _text("report.css")
    if not is_replay:
        script = f"{_text('uPlot.iife.min.js')}\n{script}"
        style = f"{_text('uPlot.min.css')}\n{style}"
    # A script has one line end, and nothing that ends its element.
    script = script.replace("\r\n", "\n").replace("\r", "\n").replace("\0", "\\0")
    return re.sub(r"<(?=/script|script|!--)", r"\\x3c", script, flags=re.IGNORECASE), style


def _text(name: str) -> str:
    return files(__package__).joinpath("static", name).read_text(encoding="utf-8")


# Numbers for people


def command(line: str, text: str) -> DataBlock:
    """Return a block with a command line to copy, and the effect of the command."""
    return DataBlock("command", {"line": line, "text": text})


def percent(share: float) -> str:
    """Return a share 0..1 in percent, in the form of a page's texts."""
    return f"{100.0 * share:.1f}\u00a0%"


def proper(text: str) -> str:
    """Return a text with proper minus signs before negative numbers."""
    return re.sub(r"(?<!\w)-(?=\d)", "−", text)
