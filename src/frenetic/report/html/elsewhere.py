"""A campaign's failures in other simulators."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final

from frenetic._support.words import signed
from frenetic.again.rerun import Rerun, names_of
from frenetic.again.verdicts import matches_text
from frenetic.campaign.store import CampaignStore
from frenetic.oracle import assess
from frenetic.report.html.blocks import Block, Column, Paragraph, Part, Section, Table
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


def elsewhere_sections(store: CampaignStore, reruns: Sequence[Rerun]) -> tuple[Section, ...]:
    """A section about the tests driven in other simulators; none without any.

    Args:
        store: the campaign.
        reruns: its reruns in other simulators.
    """
    blocks: list[Block] = []
    room = OTHERS_SIZE
    for one in reruns:
        blocks += _blocks(store, one)
        drives = _drives(store, one, room)
        room -= sum(columns_size(drive["columns"]) for drive in drives)
        here, there = names_of(one, store.config)
        blocks.append(Part("elsewhere", {"here": here, "there": there, "drives": drives}))
    if not blocks:
        return ()
    lead = "What fails alike in two simulators says something of the driver."
    return (Section("elsewhere", "In other simulators", tuple(blocks), lead),)


def _blocks(store: CampaignStore, rerun: Rerun) -> Iterator[Block]:
    correlation = rerun.correlation
    ranks = (
        ""
        if correlation is None
        else f" MOOBDs go together with a rank correlation of"
        f" {signed(correlation.spearman)}"
        f" (p {correlation.p:.2g}, {correlation.pairs} roads)."
    )
    yield Paragraph(
        f"{part_text(rerun.driver, store.config.get('driver'))} in"
        f" {part_text(rerun.simulator, store.config.get('simulator'))}:"
        f" {rerun}.{ranks}"
    )
    rows = tuple(
        (
            str(test.id),
            signed(test.recorded.moobd, none=""),
            signed(test.drives[0].moobd, none=""),
            str(test.change),
            matches_text(test.drives),
            test.drives[0].reason,
        )
        for test in rerun.tests
    )
    yield Table(_COLUMNS, rows, links=tuple(f"#test-{one.id}" for one in rerun.tests))


def _drives(store: CampaignStore, rerun: Rerun, room: int) -> tuple[dict[str, Any], ...]:
    """As many of its drives as there is room for."""
    drives = []
    for test in rerun.tests:
        again = test.drives[0]
        drive = again.test.drive
        if drive is None or not len(drive.trajectory):
            continue
        road = store.test(test.id, with_trajectory=False).road
        columns = drive_columns(drive.trajectory, assess(road, drive))
        room -= columns_size(columns)
        if room < 0:
            break
        drives.append(
            {
                "test": test.id,
                "agreement": test.verdict,
                "reason": again.reason,
                "moobd": None if again.moobd is None else round(again.moobd, 3),
                "columns": columns,
            }
        )
    return tuple(drives)
