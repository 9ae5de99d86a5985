"""Pages of sections with blocks, as self-contained HTML files.

All texts are plain: nothing in them is read as HTML.
"""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple, TypeAlias

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from msgspec.json import encode

from frenetic._support.files import write_file
from frenetic.parts.program import citation, program_text

REPLAY_SCRIPTS: Final = ("base.js", "road.js", "player.js", "replay.js")
"""Files in ``static`` that a page with one replay needs, in this order."""
SCRIPTS: Final = (
    *REPLAY_SCRIPTS[:-1],
    *("gallery.js", "map.js", "tests.js", "charts.js", "main.js"),
)
"""Files in ``static`` that draw a page of sections, in this order."""
SCRIPTED: Final = frozenset({"chart", "gallery", "featureMap", "tests"})
"""Kinds of blocks that the script draws; the template draws the other kinds."""

_SECTION_ID: Final = re.compile(r"[a-z][a-z0-9-]*")


@dataclass(frozen=True)
class DataBlock:
    """A block of our own pages, drawn from its data by a macro or by the script."""

    kind: str
    """Name of a macro in ``templates/blocks.html``, or of a function in the script."""
    data: Mapping[str, Any]
    """Data of the block: texts, numbers, and lists, mappings or dataclasses of these."""


class Tile(NamedTuple):
    """A number in the data of a ``headline`` block."""

    name: str
    value: str
    note: str = ""
    """Text under the value; empty without a note."""
    role: str = ""
    """Name of a colour of ``report.css``, ``fail`` or ``error``; empty for the usual colour."""


@dataclass(frozen=True)
class Paragraph:
    """A block of text."""

    kind: ClassVar[str] = "paragraph"
    text: str


@dataclass(frozen=True)
class Facts:
    """A block of names with values, one below the other."""

    kind: ClassVar[str] = "facts"
    facts: Mapping[str, str]
    title: str = ""
    folded: bool = False
    """Whether only the title is shown until it is clicked."""


@dataclass(frozen=True)
class Table:
    """A block with rows of texts."""

    kind: ClassVar[str] = "table"
    columns: tuple[str, ...]
    """Titles of the columns; a title that begins with > makes its column right-aligned."""
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    links: tuple[str | None, ...] = ()
    """Relative address to which each row's first text links, or None; empty without links."""


@dataclass(frozen=True)
class Series:
    """A line of a chart, which may have a band around it."""

    name: str
    x: tuple[float, ...]
    """Ascending positions of the line's points."""
    y: tuple[float, ...]
    """Values of the line's points."""
    low: tuple[float, ...] = ()
    """Lower edge of the band at each point; empty without a band."""
    high: tuple[float, ...] = ()
    """Upper edge of the band at each point; empty without a band."""
    role: str = "accent"
    """Name of a colour of ``report.css``: accent, fail, pass, quiet, or ``group-0`` to 7."""
    dashed: bool = False
    """Whether the line is dashed."""
    stepped: bool = False
    """Whether the line keeps its value until the next point."""
    width: float = 2.0
    """Width of the line, in pixels."""
    singles: tuple[tuple[float, ...], ...] = ()
    """Values of thin lines beside the line, at the same points."""


@dataclass(frozen=True)
class Chart:
    """A block with a chart of lines."""

    kind: ClassVar[str] = "chart"
    series: tuple[Series, ...]
    x_title: str
    y_title: str
    caption: str = ""
    counts: bool = False
    """Whether both axes begin at 0, and the vertical axis has whole numbers."""
    tests: tuple[int | None, ...] = ()
    """Id of the test that a click at each point of the first line opens; None for no test."""


Block: TypeAlias = DataBlock | Paragraph | Facts | Table | Chart


@dataclass(frozen=True)
class Section:
    """A headline with blocks under it."""

    id: str
    """Lower-case letters, digits and hyphens; unique in a page."""
    title: str
    blocks: tuple[Block, ...]
    lead: str = ""
    """A sentence or two under the headline."""


@dataclass(frozen=True)
class Report:
    """The contents of a page."""

    title: str
    sections: tuple[Section, ...]
    made_by: str = field(default_factory=program_text)
    """The program with its version and commit, for the foot of the page."""
    citation: str = field(default_factory=citation)
    """How to cite the program, for the foot of the page."""
    data: Mapping[str, Any] = field(default_factory=dict)
    """Data for the script beside the blocks, see `campaign_report` and `animate`."""
    finished_at: str = ""
    """When the page's campaign ended, ISO 8601; empty without a campaign that has ended."""

    @property
    def finished_tag(self) -> Markup:
        """Tag near the page's beginning that holds `finished_at`."""
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
            style=Markup(style),  # noqa: S704  # a file of this package
            script=Markup(script),  # noqa: S704  # files of this package
            data=_script_json({**report.data, "title": report.title, "blocks": blocks}),
        )
    )
    # Some names of files have no encoding.
    return text.encode("utf-8", "replace").decode()


def write_page(report: Report, path: Path | str) -> Path:
    """Write a page completely or not at all.

    Raises:
        FreneticError: the file cannot be written.
    """
    path = Path(path)
    write_file(path, render(report), remedy="choose another place for the page")
    return path


def _script_json(data: Mapping[str, Any]) -> Markup:
    """Return data as JSON whose texts cannot end a script element."""
    text = encode(data).decode()  # infinities and NaN become null
    for sign in "&<>\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return Markup(text)  # noqa: S704  # nothing in it is markup any more


def _policy(script: str, style: str) -> str:
    """Return a content security policy that allows this script and style, and no loading."""
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
    """Return the environment of the HTML templates."""
    return Environment(
        loader=PackageLoader("frenetic.report.html"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


@cache
def _assets(*, is_replay: bool) -> tuple[str, str]:
    """Return script and style of a page; only a page without replay has charts (uPlot, MIT)."""
    scripts = "\n".join(map(_text, REPLAY_SCRIPTS if is_replay else SCRIPTS))
    script, style = f'"use strict";\n(() => {{\n{scripts}\n}})();\n', _text("report.css")
    if not is_replay:
        script = f"{_text('uPlot.iife.min.js')}\n{script}"
        style = f"{_text('uPlot.min.css')}\n{style}"
    # An HTML parser changes line ends and NUL, and ends the element at some texts.
    script = script.replace("\r\n", "\n").replace("\r", "\n").replace("\0", "\\0")
    return re.sub(r"<(?=/script|script|!--)", r"\\x3c", script, flags=re.IGNORECASE), style


def _text(name: str) -> str:
    """Return the text of a file in ``static``."""
    return files(__package__).joinpath("static", name).read_text(encoding="utf-8")


def command(line: str, text: str) -> DataBlock:
    """Return a block with a command line to copy; ``text`` says what the command does."""
    return DataBlock("command", {"line": line, "text": text})


def percent(share: float) -> str:
    """Return a share 0..1 in percent, with a decimal and a space that does not break."""
    return f"{100.0 * share:.1f}\u00a0%"


def proper(text: str) -> str:
    """Return a text with proper minus signs before negative numbers."""
    return re.sub(r"(?<!\w)-(?=\d)", "−", text)
