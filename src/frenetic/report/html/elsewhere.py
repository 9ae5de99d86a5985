"""A campaign's failures in other simulators."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final

from msgspec.json import encode

from frenetic._support.words import signed
from frenetic.again.rerun import Rerun, names_of
from frenetic.again.verdicts import Repeat, matches_text
from frenetic.campaign.store import CampaignStore
from frenetic.oracle import assess
from frenetic.quantities import in_words
from frenetic.report.html.blocks import Block, Column, Paragraph, Part, Section, Table
from frenetic.report.html.tests import drive_columns
from frenetic.spec import part_text

OTHERS_SIZE: Final = 1_000_000
"""Most bytes of JSON for the drives in other simulators."""

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
        drives = []
        for drive in _drives(store, one):
            room -= len(encode(drive))
            if room < 0:
                break
            drives.append(drive)
        here, there = names_of(one, store.config)
        shown = Part("elsewhere", {"here": here, "there": there, "drives": drives})
        blocks += [Paragraph(_text(store, one)), _table(one), shown]
    if not blocks:
        return ()
    lead = "What fails alike in two simulators says something of the driver."
    return (Section("elsewhere", "In other simulators", tuple(blocks), lead),)


def _text(store: CampaignStore, rerun: Rerun) -> str:
    driver, simulator = (
        part_text(getattr(rerun, part), store.config.get(part)) for part in ("driver", "simulator")
    )
    text = f"{driver} in {simulator}: {rerun}."
    if (found := rerun.correlation) is not None:
        text += (
            f" MOOBDs go together with a rank correlation of {signed(found.spearman)}"
            f" (p {found.p:.2g}, {found.pairs} roads)."
        )
    return text


def _table(rerun: Rerun) -> Table:
    rows = tuple(
        (
            str(test.id),
            signed(test.recorded.moobd, none=""),
            signed(test.drives[0].moobd, none=""),
            str(test.change),
            matches_text(test.drives),
            _reason(test.drives[0]),
        )
        for test in rerun.tests
    )
    return Table(_COLUMNS, rows, links=tuple(f"#test-{one.id}" for one in rerun.tests))


def _reason(drive: Repeat) -> str:
    """What happened, and in which conditions of a domain."""
    return "; ".join(filter(None, [drive.reason, in_words(drive.conditions)]))


def _drives(store: CampaignStore, rerun: Rerun) -> Iterator[dict[str, Any]]:
    """The first drive of each test that has records."""
    for test in rerun.tests:
        again = test.drives[0]
        drive = again.test.drive
        if drive is not None and len(drive.trajectory):
            road = store.test(test.id, with_trajectory=False).road
            yield {
                "test": test.id,
                "agreement": test.verdict,
                "reason": _reason(again),
                "moobd": again.moobd,
                "columns": drive_columns(drive.trajectory, assess(road, drive)),
            }
