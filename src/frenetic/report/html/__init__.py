"""A campaign as one HTML file that opens anywhere, without a network: `write_report`.

What the page says is put together here as *sections* of *blocks* (`frenetic.report.html.blocks`),
which become JSON in the page; how it looks is up to ``static``.

Your own section needs no JavaScript, as long as its blocks are of existing kinds::

    from frenetic.report.html import Chart, Paragraph, Section, Series, write_report

    errors = Section(
        id="errors",
        title="Errors",
        blocks=(
            Paragraph("How often the simulator broke."),
            Chart((Series("errors", (1.0, 2.0), (0.0, 3.0)),), "night", "errors"),
        ),
    )
    write_report("campaigns/night", sections=[errors])
"""

from frenetic.report.html.blocks import (
    Chart,
    Column,
    Fact,
    Facts,
    Paragraph,
    Part,
    Section,
    Series,
    Table,
)
from frenetic.report.html.campaign import REPORT, campaign_report, write_report
from frenetic.report.html.comparison import comparison_report, write_comparison_page
from frenetic.report.html.page import Report, render, write_page

__all__ = [
    "REPORT",
    "Chart",
    "Column",
    "Fact",
    "Facts",
    "Paragraph",
    "Part",
    "Report",
    "Section",
    "Series",
    "Table",
    "campaign_report",
    "comparison_report",
    "render",
    "write_comparison_page",
    "write_page",
    "write_report",
]
