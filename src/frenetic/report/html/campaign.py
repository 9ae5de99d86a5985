"""The HTML report of a campaign: its sections, its drives and its file."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, Final

from msgspec.json import encode

from frenetic._support.entry_points import imported, installed
from frenetic._support.files import open_file
from frenetic.analysis.axes import varied_axes
from frenetic.analysis.bend_map import sweep_map
from frenetic.analysis.clusters import Clusters
from frenetic.analysis.coverage import DomainCoverage, domain_coverage
from frenetic.analysis.failures import Failure
from frenetic.campaign.configuration import SPEC
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.conditions.condition import as_text
from frenetic.errors import CampaignError
from frenetic.export.failure_values import FailureAnalysis
from frenetic.export.table_rows import CampaignSource, open_store
from frenetic.oracle.outcome import Outcome
from frenetic.report.html.configuration import configuration_section, shell_path
from frenetic.report.html.domain import domain_section
from frenetic.report.html.feature_map import map_section
from frenetic.report.html.gallery import gallery_section
from frenetic.report.html.headline import headline, title_of
from frenetic.report.html.margin import margin_section
from frenetic.report.html.page import DataBlock, Report, Section, write_page
from frenetic.report.html.reading import Reading, finished_at_of
from frenetic.report.html.sweep import sweep_section
from frenetic.report.html.tests import (
    COLUMNS,
    Film,
    TestSummary,
    condition_titles,
    drive_data,
    files_of,
    table_of,
)
from frenetic.report.html.timeline import timeline_section
from frenetic.rerun.margin_files import campaign_margins
from frenetic.rerun.margin_results import Margins
from frenetic.rerun.reruns import Rerun, in_other_simulators, read_reruns
from frenetic.segments.passing import PassingDrives

FILMS: Final = "frenetic.films"
"""Group of entry points for functions that add films to drives.

Such a function takes a campaign's configuration, and returns a function of a test. This returns the
test's `Film`, or None.
"""
DRIVES_SIZE: Final = 3_500_000
"""Largest number of bytes of JSON for all drives of a page; our choice."""
FILMS_SIZE: Final = 3_000_000
"""Largest number of bytes of all films of a page; our choice."""
REPORT: Final = "report.html"
"""Name of the report in a campaign's folder."""
_BATCH: Final = 20
"""Number of tests that are read at once, with their trajectories; our choice."""
_HEAD_SIZE: Final = 1024
"""Bytes at a report's beginning that hold the time at which its campaign ended."""


def write_report(
    campaign: CampaignSource,
    path: Path | str | None = None,
    *,
    reading: Reading | None = None,
    sections: Sequence[Section] = (),
) -> Path:
    """Write the report of a campaign: one self-contained HTML file.

    Args:
        campaign: an open campaign, or a campaign's folder.
        path: path of the file, which is replaced; by default ``report.html`` in the campaign's
            folder.
        reading: the campaign's tests, if they are read already.
        sections: sections to add after the campaign's sections.

    Returns:
        The file.

    Raises:
        CampaignError: there is no campaign, or it is damaged.
        FreneticError: the file cannot be written.
    """
    with open_store(campaign) as store:
        path = store.folder / REPORT if path is None else Path(path)
        report = campaign_report(store, reading=reading, sections=sections)
    return write_page(report, path)


def has_report(store: CampaignStore) -> bool:
    """Return whether a campaign has ended and its folder holds the report of this end.

    A report that was written before the campaign was resumed does not count.
    """
    finished_at = finished_at_of(store.facts)
    try:
        with open_file(store.folder / REPORT) as file:
            beginning = file.read(_HEAD_SIZE).decode("utf-8", "replace")
    except OSError:
        return False
    report = Report(title="", sections=(), finished_at=finished_at)
    return bool(finished_at) and report.finished_tag in beginning


def campaign_report(
    store: CampaignStore,
    *,
    reading: Reading | None = None,
    sections: Sequence[Section] = (),
) -> Report:
    """Return the report of a campaign.

    Args:
        store: the campaign.
        reading: the campaign's tests, if they are read already.
        sections: sections to add after the campaign's sections.

    Raises:
        CampaignError: the campaign is damaged.
    """
    reading = Reading.of(store) if reading is None else reading
    tests, counts, clusters = reading.tests, reading.counts, reading.clusters
    shown_clusters, config = reading.misses or clusters, store.config  # misses if nothing failed
    (reruns, studies), trouble = _studies(store.folder)
    elsewhere_reruns = in_other_simulators(reruns, config)
    own_studies = [margins for margins in studies if margins.folder == store.folder]
    named_ids = [
        *(drive for margins in own_studies for drive in margins.shown_drives),
        *(test.id for rerun in elsewhere_reruns for test in rerun.tests),
    ]
    shown = _tests_to_show(tests, shown_clusters, named_ids)
    coverage = domain_coverage(store.setting, store.tests())
    swept = sweep_map(store.tests())
    drives = _drives(store, shown, reading.passing)
    table = table_of(tests, FailureAnalysis.of(store, clusters))
    title = own_studies[0].headline if own_studies else title_of(clusters, counts)
    margin_sections = [margin_section(studies, config, store.folder)] if studies else []
    return Report(
        title=title,
        sections=(
            Section("summary", title, (headline(store, clusters, counts, trouble),)),
            *(margin_sections if own_studies else []),
            gallery_section(store, shown_clusters, tests, drives, counts, reruns, reading.passing),
            timeline_section(tests, clusters),
            *([] if coverage is None else [domain_section(coverage)]),
            *([] if swept is None else [sweep_section(swept, store.setting.lane_width)]),
            *([] if own_studies else margin_sections),
            _map_section(reading, shown, coverage),
            Section("tests", "All tests", (DataBlock("tests", {}),)),
            configuration_section(store.folder, config, store.facts),
            *sections,
        ),
        data={
            "campaign": shell_path(store.folder),
            "is_named": isinstance(config.get(SPEC), Mapping),
            "lane_width": store.setting.lane_width,
            "tests": table,
            "conditions": condition_titles(table),
            "resolutions": COLUMNS,
            "drives": drives,
        },
        finished_at=reading.finished_at,
    )


def _map_section(
    reading: Reading, shown: Sequence[int], coverage: DomainCoverage | None
) -> Section:
    """Return the section with the feature map, in which the tests to show come first."""
    driven = [test.conditions for test in reading.tests if test.outcome.is_driven]
    axes = varied_axes(driven) if coverage is None else coverage.axes
    order = [i for i in dict.fromkeys([*shown, *reading.mapped]) if i in reading.mapped]
    mapped = {i: reading.mapped[i] for i in order}
    cells = {axis: [axis.find(candidate) for _, candidate in mapped.values()] for axis in axes}
    features = {i: features for i, (features, _) in mapped.items()}
    return map_section(features, reading.tests, cells)


def _studies(folder: Path) -> tuple[tuple[Sequence[Rerun], Sequence[Margins]], str]:
    """Return reruns and margins of a campaign, and a warning, which is empty if all are read."""
    try:
        return (read_reruns(folder), campaign_margins(folder)), ""
    except CampaignError as error:
        return ([], []), str(error)


def _drives(
    store: CampaignStore, shown: Sequence[int], passing: PassingDrives | None
) -> list[dict[str, Any]]:
    """Return the data of the first tests to show, as many as there is room for.

    Args:
        store: the campaign.
        shown: ids of the tests to show, the most important first.
        passing: passing drives with which mistakes are compared.
    """
    drives: list[dict[str, Any]] = []
    drive_bytes_left, film_bytes_left = DRIVES_SIZE, FILMS_SIZE
    film_functions: list[Callable[[Test], Film | None]] = [
        imported(entry.target)(store.config) for entry in installed(FILMS)
    ]
    batches = (shown[i : i + _BATCH] for i in range(0, len(shown), _BATCH))
    records = (store.tests_with_ids(batch, with_trajectory=True) for batch in batches)
    for record in chain.from_iterable(records):
        if drive_bytes_left <= 0:
            break
        if (segment := record.segment) is None:
            continue
        origin, failure = record.candidate.origin, Failure.of_driven(record)
        data = drive_data(record.id, record.result, segment, origin, failure, passing)
        data |= files_of(record.id, store)
        if conditions := as_text(record.candidate.conditions):
            data["reason"] += f"; {conditions}"
        drive_bytes_left -= len(encode(data))
        if film_bytes_left > 0:
            films = (film_of(record) for film_of in film_functions)
            data["film"] = next((film for film in films if film is not None), None)
        if data["film"] is not None:
            film_bytes_left -= len(data["film"].pictures)
        drives.append(data)
    return drives


def _tests_to_show(
    tests: Sequence[TestSummary], clusters: Clusters, named_ids: Sequence[int]
) -> list[int]:
    """Return ids of the tests to show, the most important first.

    First comes an example of each cause, then each cluster's most severe and typical failure, then
    the tests that other parts of the page name, then the most severe failures.

    Args:
        tests: all tests of the campaign.
        clusters: the distinct failures, or the nearest misses.
        named_ids: ids of the drives that show margins, and of the failures that were driven in
            another simulator.
    """
    examples = [cause.example for cause in clusters.causes]
    of_clusters = [i for cluster in clusters for i in (cluster.most_severe, cluster.typical)]
    failed = sorted(
        (test for test in tests if test.outcome is Outcome.FAIL and not test.is_repeat),
        key=lambda test: (test.moobd or 0.0, test.id),
    )
    by_severity = [test.id for test in failed]
    known = {test.id for test in tests}
    named_ids = [i for i in named_ids if i in known]  # a file may name drives of another campaign
    return list(dict.fromkeys([*examples, *of_clusters, *named_ids, *by_severity]))
