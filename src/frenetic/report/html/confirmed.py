"""A campaign's failures in other simulators."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from frenetic.campaign.store import JSONValue
from frenetic.errors import CampaignError
from frenetic.redrive.confirm import Confirmation, read_confirmations
from frenetic.redrive.record import Agreement
from frenetic.report.html.blocks import Block, Column, Paragraph, Picture, Section, Table
from frenetic.spec import part_text

MOST_BYTES: Final = 2_000_000
"""Most bytes of a picture in the page; a larger one stays a file."""

_COLUMNS: Final = (
    Column("test", is_number=True),
    Column("here (m)", is_number=True, text="MOOBD in the campaign"),
    Column("there (m)", is_number=True, text="MOOBD in the other simulator"),
    Column("verdict"),
    Column("same place", text="left the lane on the same side, within 30 m along the road"),
    Column("what happened there"),
)


def confirmed_sections(folder: Path, config: Mapping[str, JSONValue]) -> tuple[Section, ...]:
    """A section about the failures driven in other simulators; None without any.

    Args:
        folder: of the campaign.
        config: the campaign's configuration.
    """
    try:
        confirmations = read_confirmations(folder)
    except CampaignError as error:
        blocks: tuple[Block, ...] = (Paragraph(str(error)),)
    else:
        blocks = tuple(block for one in confirmations for block in _blocks(folder, config, one))
    if not blocks:
        return ()
    lead = "What fails in two simulators says something of the driver."
    return (Section("confirmed", "In other simulators", blocks, lead),)


def _blocks(
    folder: Path, config: Mapping[str, JSONValue], confirmation: Confirmation
) -> Iterator[Block]:
    # Its pictures are drawn by matplotlib, which takes its time to import.
    from frenetic.report.confirmation import GALLERY, pictures_of

    counted = ", ".join(f"{confirmation.count(verdict)} {verdict}" for verdict in Agreement)
    correlation = confirmation.correlation
    ranks = (
        ""
        if correlation is None
        else f" MOOBDs go together with a rank correlation of {correlation.spearman:.2f}"
        f" (p {correlation.p:.2g}, {correlation.pairs} roads)."
    )
    yield Paragraph(
        f"{part_text(confirmation.driver, config.get('driver'))} in"
        f" {part_text(confirmation.simulator, config.get('simulator'))}: {counted};"
        f" {confirmation.alike} at the same place.{ranks}"
    )
    rows = tuple(
        (
            str(test.test_id),
            _metres(test.recorded.moobd),
            _metres(test.other.moobd),
            str(test.agreement),
            "yes" if test.is_alike else "",
            test.reason,
        )
        for test in confirmation.tests
    )
    yield Table(_COLUMNS, rows)
    gallery = folder / pictures_of(confirmation) / GALLERY
    picture = _picture(gallery)
    if picture is not None:
        caption = f"Each road as a picture of its own: {gallery.parent}"
        yield Picture(picture, "Both paths on each road", caption)


def _picture(path: Path) -> str | None:
    """A PNG file as a data URI; None if it is missing, too large, or no PNG."""
    try:
        if path.stat().st_size > MOST_BYTES:
            return None
        data = path.read_bytes()
    except OSError:
        return None
    if not data.startswith(b"\x89PNG\r\n\x1a\n"):
        return None
    return f"data:image/png;base64,{base64.b64encode(data).decode()}"


def _metres(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"
