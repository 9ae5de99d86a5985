"""Campaigns and comparisons as HTML files that open anywhere, without a network.

`write_report` writes the page of a campaign. A page is made of *sections*, a section of *blocks*. A
section of your own needs no JavaScript if its blocks are of existing kinds::

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

from frenetic.report.html.campaign import REPORT, campaign_report, write_report
from frenetic.report.html.comparison import write_comparison_page
from frenetic.report.html.page import (
    Chart,
    DataBlock,
    Facts,
    Paragraph,
    Report,
    Section,
    Series,
    Table,
    render,
    write_page,
)
from frenetic.report.html.quality import write_quality_page

__all__ = [
    "REPORT",
    "Chart",
    "DataBlock",
    "Facts",
    "Paragraph",
    "Report",
    "Section",
    "Series",
    "Table",
    "campaign_report",
    "render",
    "write_comparison_page",
    "write_page",
    "write_quality_page",
    "write_report",
]
