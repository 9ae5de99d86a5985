"""The section of a report with a driver's margins."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from html_campaigns import make_sloping
from made_up_margins import DELAY, limits, margins

from frenetic.campaign import CampaignStore
from frenetic.report.html import DataBlock, Paragraph, Report, Section, Table, campaign_report
from frenetic.report.html.margin import margin_section
from frenetic.report.html.page import render
from frenetic.rerun.margin_files import FILE, write_margins
from frenetic.rerun.margin_results import Margins

PART = {"class": "a:B"}
CONFIG = {"driver": PART, "simulator": PART}


def blocks_of(*studies: Margins) -> tuple[list[Paragraph], list[DataBlock], list[Table]]:
    """Return the paragraphs, figures and tables of the section of studies."""
    blocks = margin_section(studies, CONFIG, Path("page")).blocks
    return (
        [block for block in blocks if isinstance(block, Paragraph)],
        [block for block in blocks if isinstance(block, DataBlock)],
        [block for block in blocks if isinstance(block, Table)],
    )


def test_the_section_has_a_sentence_a_figure_and_a_table() -> None:
    (sentence, *notes), (figure,), (table,) = blocks_of(margins())
    assert sentence.text == (
        "Where the driver begins to fail on 5 % of 80 random roads of rural <80> $x$."
    )
    assert any("pass again beyond the failing amount" in note.text for note in notes)
    assert table.columns[-1] == ">2 most demanding"
    assert table.rows[0][:5] == ("more delay", "0 s", "0.3 s", "0.3 s to 0.3 s", "1")
    assert table.rows[1][2:5] == ("never up to 0.01", "–", "–")
    assert table.links == (), "the page of a campaign has no drives of a study"
    assert table.caption == (
        "Drive: on the road that begins to fail nearest to this amount; 'frenetic show c DRIVE'"
        " shows it. Roads: 80 random roads of rural <80> $x$, seed 0, and the 2 roads that the"
        " campaign passed with the lowest MOOBD, which a search chose and which do not count. 9"
        " drives in all."
    )
    delay, friction, view = figure.data["rows"]
    assert (delay["name"], delay["range"], delay["amount"]) == ("More delay", "0 s to 1 s", "0.3 s")
    assert (delay["bar"], delay["interval"], delay["demanding"]) == (
        30.0,
        (30.0, 30.0, False),
        20.0,
    )
    assert (friction["bar"], friction["is_beyond"], friction["amount"]) == (100.0, True, "never")
    assert (friction["interval"], friction["demanding"]) == (None, None)
    assert (view["bar"], view["amount"], view["range"]) == (0.0, "usual", "unlimited to 1 m")


def test_without_demanding_roads_nothing_speaks_of_them() -> None:
    plain = tuple(replace(margin, demanding=()) for margin in margins().margins)
    _, (figure,), (table,) = blocks_of(replace(margins(), margins=plain))
    assert "Diamond" not in figure.data["caption"]
    assert "search" not in table.caption
    assert table.columns[-1] == ">never fails"


def test_another_driver_than_the_campaigns_is_named() -> None:
    edited = replace(margins(), driver={"class": "my_driver:Mine"})
    (sentence, *_), _, _ = blocks_of(edited)
    assert sentence.text.endswith("rural <80> $x$, driven with Mine.")


def test_the_figure_is_drawn_without_a_script_and_escapes_texts() -> None:
    section = margin_section([margins()], CONFIG, Path("c"))
    page = render(Report("margins", (Section("summary", "m", ()), section)))
    assert page.count('class="margin"') == 3
    assert page.count('class="bar-beyond"') == 1
    assert page.count('class="demanding"') == 2
    assert "rural &lt;80&gt; $x$" in page
    assert '<a href="#test-1">more delay</a>' in page, "a study's own page has its drives"
    assert '<th scope="row">less friction</th>' in page, "nothing fails"
    assert "rural <80>" not in page.partition('id="data"')[0]


def test_a_report_shows_the_margins_in_its_folder_and_warns_of_a_damaged_file(
    tmp_path: Path,
) -> None:
    folder = make_sloping(tmp_path / "c")

    def report() -> Report:
        with CampaignStore.open(folder) as store:
            return campaign_report(store)

    assert "margin" not in [section.id for section in report().sections]
    write_margins(margins(folder))
    assert [section.id for section in report().sections][:2] == ["summary", "margin"]
    assert report().title == margins().headline
    assert 1 in [drive["id"] for drive in report().data["drives"]], "a drive that shows a margin"
    copied = replace(margins(folder).margins[0], limits=limits(DELAY, *[0.3] * 80)[-1:])
    write_margins(replace(margins(folder), margins=(copied,)))
    assert report().title.startswith("Where the driver"), "though drive 80 is not in the campaign"
    (folder / FILE).write_text("{}")
    (headline,) = report().sections[0].blocks
    assert isinstance(headline, DataBlock)
    assert "margins.json is damaged" in headline.data["warning"]
