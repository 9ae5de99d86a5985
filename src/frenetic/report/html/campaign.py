"""The HTML report of a campaign, as a file."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from msgspec.json import encode

from frenetic._support.entry_points import imported, installed
from frenetic.again.rerun import Rerun, elsewhere, own_repeats, read_reruns
from frenetic.analysis.coverage import domain_coverage, varied_axes
from frenetic.analysis.criteria import criteria_in_words
from frenetic.analysis.failures import Clusters, caution
from frenetic.analysis.segments import segment_of_test
from frenetic.campaign.earlier import still_failing
from frenetic.campaign.objective import objectives
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.errors import CampaignError
from frenetic.estimate import Estimate
from frenetic.export.tables import Place, opened
from frenetic.outcome import Outcome
from frenetic.quantities import in_words
from frenetic.report.html.blocks import Part, Section
from frenetic.report.html.domain import domain_section
from frenetic.report.html.elsewhere import elsewhere_sections
from frenetic.report.html.feature_map import map_section
from frenetic.report.html.gallery import gallery_section
from frenetic.report.html.headline import headline
from frenetic.report.html.operators import operators_section
from frenetic.report.html.page import Report, write_page
from frenetic.report.html.reading import Reading
from frenetic.report.html.repeating import repeat_section
from frenetic.report.html.tests import (
    COLUMNS,
    Film,
    TestSummary,
    drive_data,
    files_of,
    table_of,
)
from frenetic.report.html.timeline import timeline_section
from frenetic.search.operators import DOES

FILMS: Final = "frenetic.films"
"""Group of entry points: functions of a campaign's record that give one of a test, for its `Film`
or None."""
DRIVES_SIZE: Final = 3_500_000
"""Most bytes of JSON for all drives of a page."""
FILMS_SIZE: Final = 3_000_000
"""Most bytes of all pictures of a page, likewise."""
REPORT: Final = "report.html"
"""Name of the report in a campaign's folder."""


def write_report(
    campaign: Place,
    path: Path | str | None = None,
    *,
    reading: Reading | None = None,
    sections: Sequence[Section] = (),
) -> Path:
    """Writes the report of a campaign: one self-contained HTML file.

    Args:
        campaign: open, or its folder.
        path: of the file, which is replaced; ``report.html`` in the campaign's folder by default.
        reading: its tests, if they are read already.
        sections: to add after those of the campaign.

    Returns:
        The file.

    Raises:
        CampaignError: there is no campaign, or it is damaged.
        FreneticError: the file cannot be written.
    """
    with opened(campaign) as store:
        path = store.folder / REPORT if path is None else Path(path)
        report = campaign_report(store, reading=reading, sections=sections)
    return write_page(report, path)


def campaign_report(
    store: CampaignStore,
    *,
    reading: Reading | None = None,
    sections: Sequence[Section] = (),
) -> Report:
    """The report of a campaign.

    Raises:
        CampaignError: the campaign is damaged.
    """
    reading = Reading.of(store) if reading is None else reading
    tests, counts, clusters = reading.tests, reading.counts, reading.clusters
    found, failures = reading.misses or clusters, counts.failed
    config, facts = store.config, store.facts
    reruns, trouble = _reruns(store)
    there = elsewhere(reruns, config)
    shown = _to_show(tests, found, [test.id for one in there for test in one.tests])
    coverage = domain_coverage(store.setting, store.tests())
    axes = varied_axes(reading.conditions) if coverage is None else coverage.axes
    drives = _drives(store, reading, shown)
    order = [i for i in dict.fromkeys([*shown, *reading.features]) if i in reading.features]
    measured = {i: reading.features[i] for i in order}
    cells = {axis: [axis.find(reading.mapped[i]) for i in order] for axis in axes}
    moobds = {test.id: test.moobd for test in tests if test.moobd is not None}
    road_class = store.setting.road_class
    top = headline(
        config,
        facts,
        counts,
        clusters,
        folder=str(store.folder),
        criteria=criteria_in_words(store),
        roads="" if road_class is None else road_class.in_words(),
        domain=_domain(store),
        elapsed=store.elapsed(),
        objectives=objectives(store),
        known=still_failing(store),
        caution=caution(store),
        trouble=trouble,
    )
    own = own_repeats(reruns)
    return Report(
        title=top.title,
        sections=(
            Section("summary", top.title, (top,)),
            gallery_section(found, moobds, drives, own, failures, counts.broken),
            timeline_section(tests, clusters),
            *([] if coverage is None else [domain_section(coverage)]),
            map_section(measured, tests, cells),
            operators_section(tests, clusters),
            *elsewhere_sections(store, there),
            Section("tests", "All tests", (Part("tests", {}),)),
            repeat_section(config, facts),
            *sections,
        ),
        data={
            "campaign": _shell(store.folder),
            "is_named": isinstance(config.get("command"), Mapping),
            "lane_width": store.setting.lane_width,
            "tests": table_of(tests),
            "operators": {test.origin.operator: DOES.get(test.origin.operator) for test in tests},
            "resolutions": COLUMNS,
            "drives": drives,
        },
    )


def _domain(store: CampaignStore) -> str:
    """What conditions were searched, and how often the driver fails in them, if that is known."""
    if (domain := store.setting.domain) is None:
        return ""
    found = Estimate.read(store.folder)
    return domain.in_words() if found is None else f"{domain.in_words()}; {found.in_words()}"


def _drives(store: CampaignStore, reading: Reading, shown: Sequence[int]) -> list[dict[str, Any]]:
    """The drives of as many tests to show as there is room for."""
    drives: list[dict[str, Any]] = []
    room, room_for_pictures = DRIVES_SIZE, FILMS_SIZE
    films: list[Callable[[Test], Film | None]] = [
        imported(entry.target)(store.config) for entry in installed(FILMS)
    ]
    for test_id in shown:
        if room <= 0:
            break
        if test_id in reading.failures:
            record, segment = reading.failures[test_id]
        else:
            record = store.test(test_id)
            segment = segment_of_test(record)
        if segment is None:
            continue
        data = drive_data(test_id, record.result, segment, record.candidate.origin.generation)
        data |= files_of(test_id, store)
        if conditions := in_words(record.candidate.conditions):
            data["reason"] += f"; {conditions}"
        drives.append(data)
        room -= len(encode(data))
        seen = (film(record) for film in films if room_for_pictures > 0)
        film = next((one for one in seen if one is not None), None)
        drives[-1]["film"] = film
        room_for_pictures -= 0 if film is None else len(film.pictures)
    return drives


def _to_show(
    tests: Sequence[TestSummary], clusters: Clusters, elsewhere: Sequence[int]
) -> list[int]:
    """Ids of the tests to show, the most important first.

    An example of each cause, each cluster's most severe and typical failure, then those driven in
    another simulator, and the most severe failures.
    """
    examples = [cause.example for cause in clusters.causes]
    heads = [i for cluster in clusters for i in (cluster.most_severe, cluster.typical)]
    failed = sorted(
        (test for test in tests if test.outcome is Outcome.FAIL),
        key=lambda test: (test.moobd or 0.0, test.id),
    )
    return list(dict.fromkeys([*examples, *heads, *elsewhere, *(test.id for test in failed)]))


def _reruns(store: CampaignStore) -> tuple[list[Rerun], str]:
    """The reruns of a campaign, and trouble with them."""
    try:
        return read_reruns(store.folder), ""
    except CampaignError as error:
        return [], str(error)


def _shell(path: Path) -> str:
    """A path for pasting into a shell."""
    text = str(path).encode("utf-8", "replace").decode()  # it may hold what no page can
    return f'"{text}"' if sys.platform == "win32" else shlex.quote(text)
