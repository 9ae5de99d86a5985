"""A campaign's failures in other simulators."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

from frenetic._support.words import signed
from frenetic.campaign.store import CampaignStore
from frenetic.errors import CampaignError
from frenetic.oracle import assess
from frenetic.redrive.confirm import Confirmation, names_of, read_confirmations
from frenetic.report.html.blocks import Block, Column, Paragraph, Section, Table
from frenetic.report.html.tests import columns_size, drive_columns
from frenetic.spec import part_text

OTHERS_SIZE: Final = 1_000_000
"""Approximate bytes of JSON for the drives in other simulators."""

_COLUMNS: Final = (
    Column("test", is_number=True),
    Column("here (m)", is_number=True, text="MOOBD in the campaign"),
    Column("there (m)", is_number=True, text="MOOBD in the other simulator"),
    Column("verdict"),
    Column(
        "how",
        text="the same failure is on the same side within 30 m along the road, and road, offsets"
        " and speeds before it differ by at most 2 m",
    ),
    Column("what happened there"),
)


@dataclass(frozen=True)
class OtherDrive:
    """A test's drive in the other simulator."""

    test: int
    agreement: str
    reason: str
    moobd: float | None
    """m."""
    columns: tuple[tuple[int, ...], ...]
    """See `drive_columns`."""


@dataclass(frozen=True)
class Confirmed:
    """Pictures of roads with the paths in both simulators."""

    kind: ClassVar[str] = "confirmed"
    here: str
    """Name of the campaign's simulator."""
    there: str
    """Name of the other one."""
    drives: tuple[OtherDrive, ...]


def confirmations_of(store: CampaignStore) -> tuple[list[Confirmation], str]:
    """The confirmations of a campaign, and trouble with them."""
    try:
        return list(read_confirmations(store.folder)), ""
    except CampaignError as error:
        return [], str(error)


def confirmed_sections(
    store: CampaignStore, confirmations: Sequence[Confirmation], trouble: str
) -> tuple[Section, ...]:
    """A section about the failures driven in other simulators; none without any.

    Args:
        store: the campaign.
        confirmations: its confirmations.
        trouble: trouble with them.
    """
    blocks: list[Block] = [Paragraph(trouble)] if trouble else []
    room = OTHERS_SIZE
    for one in confirmations:
        blocks += _blocks(store, one)
        pictures = _pictures(store, one, room)
        room -= sum(columns_size(drive.columns) for drive in pictures.drives)
        blocks.append(pictures)
    if not blocks:
        return ()
    lead = "What fails alike in two simulators says something of the driver."
    return (Section("confirmed", "In other simulators", tuple(blocks), lead),)


def _blocks(store: CampaignStore, confirmation: Confirmation) -> Iterator[Block]:
    correlation = confirmation.correlation
    ranks = (
        ""
        if correlation is None
        else f" MOOBDs go together with a rank correlation of"
        f" {signed(correlation.spearman)}"
        f" (p {correlation.p:.2g}, {correlation.pairs} roads)."
    )
    yield Paragraph(
        f"{part_text(confirmation.driver, store.config.get('driver'))} in"
        f" {part_text(confirmation.simulator, store.config.get('simulator'))}:"
        f" {confirmation}.{ranks}"
    )
    rows = tuple(
        (
            str(test.test_id),
            signed(test.recorded.moobd, none=""),
            signed(test.other.moobd, none=""),
            str(test.agreement),
            str(test.match or ""),
            test.reason,
        )
        for test in confirmation.tests
    )
    yield Table(_COLUMNS, rows, links=tuple(f"#test-{one.test_id}" for one in confirmation.tests))


def _pictures(store: CampaignStore, confirmation: Confirmation, room: int) -> Confirmed:
    """Pictures of as many of its drives as there is room for."""
    drives = []
    for test in confirmation.tests:
        drive = confirmation.drive(test)
        if drive is None or not len(drive.trajectory):
            continue
        road = store.test(test.test_id, with_trajectory=False).road
        columns = drive_columns(drive.trajectory, assess(road, drive))
        room -= columns_size(columns)
        if room < 0:
            break
        moobd = None if test.moobd is None else round(test.moobd, 3)
        drives.append(OtherDrive(test.test_id, test.verdict, test.reason, moobd, columns))
    names = names_of(store, confirmation)
    return Confirmed(names.recorded, names.other, tuple(drives))
