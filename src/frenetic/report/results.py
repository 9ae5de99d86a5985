"""A search with all that its user gets: causes, shortened roads, pictures and the report.

`run` and `resume` do in one call what ``frenetic run`` and ``frenetic resume`` do::

    import frenetic

    campaign = frenetic.Campaign(
        strategy=frenetic.Frenetic(seed=1),
        simulator=frenetic.EmbeddedSimulator(),
        driver=MyDriver(),
        budget=frenetic.Budget(simulations=200),
    )
    results = frenetic.run(campaign)
    for cause in results.findings.clusters.causes:
        print(cause.failures, cause.words)
    print(results.report)
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, Literal, TypeAlias

from frenetic.analysis.caution import caution
from frenetic.analysis.clusters import Clusters, representative_failures
from frenetic.campaign import Campaign, CampaignStore, Event, Summary, Test
from frenetic.campaign.counts import Counts
from frenetic.errors import CampaignError, FreneticError
from frenetic.processes.interrupt import plain_interrupts
from frenetic.report.failures import FAILURES, GALLERY, write_failures
from frenetic.report.html.campaign import write_report
from frenetic.report.html.reading import Reading
from frenetic.report.minimised import (
    MinimisedFiles,
    minimised_document,
    minimised_drives,
    minimised_road,
    write_minimised,
)
from frenetic.rerun.minimise import minimise_causes

SLOW_DRIVE: Final = 0.5
"""Wall time of a drive above which no failing road is shortened, in s."""
SHORTENING_SHARE: Final = 3
"""Drives of a search for each one that shortens failing roads afterwards; also s of wall time."""
LEAST_SHORTENING: Final = 30.0
"""Wall time that shortening may take, however short the search was, in s."""


@dataclass(frozen=True)
class Findings:
    """The failures of a campaign by cause, or else its nearest misses."""

    reading: Reading
    """The campaign's tests, each of which is read once."""
    listed: Sequence[Test]
    """The most telling failures or misses, which the gallery shows."""
    warning: str
    """Warning of conclusions that the counts do not support; empty without any."""

    @classmethod
    def of(cls, store: CampaignStore) -> Findings:
        """Read the findings of a campaign.

        Raises:
            CampaignError: the campaign is damaged.
        """
        reading = Reading.of(store)
        clusters = reading.clusters if reading.misses is None else reading.misses
        listed = representative_failures(store, clusters=clusters)
        return cls(reading, listed, caution(store) or "")

    @property
    def counts(self) -> Counts:
        """Counts of the tests by outcome."""
        return self.reading.counts

    @property
    def clusters(self) -> Clusters:
        """The distinct failures with their causes; none if nothing failed."""
        return self.reading.clusters

    @property
    def misses(self) -> Clusters | None:
        """The nearest misses; None if a test failed."""
        return self.reading.misses

    @property
    def failures(self) -> list[Test]:
        """The most severe failures, each of which gets a file."""
        return [test for test, _ in self.reading.failures.values()]


@dataclass(frozen=True)
class Results:
    """What a search came to, and the files in its folder."""

    folder: Path
    """The campaign's folder."""
    summary: Summary | None
    """Counts and times of the search; None if it ended by an error."""
    findings: Findings
    shortened: Mapping[int, Test] = field(default_factory=dict)
    """Id of a failing test -> the drive on its shortened road."""
    notes: tuple[str, ...] = ()
    """Sentences that the user should read."""
    gallery: Path | None = None
    """Picture of the most telling failures; None if there is nothing to show."""
    report: Path | None = None
    """The HTML report; None if nothing was tested or it cannot be written, as a note says."""


@dataclass(frozen=True)
class Step:
    """Something that is done with the results of a search."""

    kind: Literal["shortening", "found", "drawing", "drawn", "reporting", "reported"]
    """``shortening``, ``drawing``, ``reporting``: that begins; ``found``: causes and shortened
    roads are known; ``drawn``, ``reported``: the pictures or the report are written."""
    results: Results
    """The results so far."""
    seconds: float = 0.0
    """Wall time that it may take, in s; 0 if it has no limit."""


OnEvent: TypeAlias = Callable[[Event | Step], object]


def run(campaign: Campaign, *, on_event: OnEvent | None = None) -> Results:
    """Search, and write everything that the user gets into the campaign's folder.

    That is a failing road of each cause shortened, files and pictures of the failures, and the
    report.

    Args:
        campaign: with a budget.
        on_event: called with each `Event` of the search, as `Campaign.run` does, and with each
            `Step` after it.

    Raises:
        CampaignError: as for `Campaign.run`. The results so far are written.
    """
    return _run(campaign, campaign.run, on_event)


def resume(campaign: Campaign, *, on_event: OnEvent | None = None) -> Results:
    """Go on with the campaign in a folder, see `Campaign.resume`, and write what `run` does."""
    return _run(campaign, campaign.resume, on_event)


def shorten_causes(campaign: Campaign, findings: Findings, summary: Summary) -> Iterator[str]:
    """Shorten a failing road of each cause, and write it with its picture.

    It may take a third of the search's drives and time.

    Yields:
        Why a road was not shortened, or what else the user should know.
    """
    folder, tester, causes = campaign.folder, campaign.tester, findings.clusters.causes
    drives, seconds = summary.simulations // SHORTENING_SHARE, _shortening_seconds(summary)
    answers = minimise_causes(folder, causes, tester, drives, seconds, isolate=campaign.isolate)
    for test_id, answer in answers:
        if isinstance(answer, FreneticError):
            yield f"test {test_id} was not shortened: {answer}"
            continue
        try:
            files = MinimisedFiles.beside(minimised_road(folder, test_id))
            files.prepare()
            document = minimised_document(answer, tester, test_id)
            write_minimised(answer, files, document, name=f"Test {test_id}", is_compared=False)
        except FreneticError as error:
            yield str(error)
            return
        if answer.stop_reason == "stopped" and answer.error is None:
            yield f"shortening was interrupted; go on: {_minimise_command(campaign)}"


def write_results(
    store: CampaignStore, results: Results, on_event: OnEvent = lambda _: None
) -> Results:
    """Write files and pictures of the failures, and the report; return the results with these.

    Raises:
        CampaignError: a file of a failure cannot be written.
    """
    findings = results.findings
    if findings.listed:
        on_event(Step("drawing", results))
        write_failures(store, findings.failures, findings.listed, results.shortened)
        results = replace(results, gallery=results.folder / FAILURES / GALLERY)
        on_event(Step("drawn", results))
    if findings.counts.tests:
        on_event(Step("reporting", results))
        try:
            report = write_report(store, reading=findings.reading)
            results = replace(results, report=report)
        except FreneticError as error:  # which loses nothing else
            results = replace(results, notes=(*results.notes, f"There is no report: {error}"))
        on_event(Step("reported", results))
    return results


def _run(campaign: Campaign, search: Callable[..., Summary], on_event: OnEvent | None) -> Results:
    """Search by `Campaign.run` or `Campaign.resume`, and write the results."""
    emit = on_event or (lambda _: None)
    with plain_interrupts():
        return _searched(campaign, search, emit)


def _searched(campaign: Campaign, search: Callable[..., Summary], emit: OnEvent) -> Results:
    """Search, and write the results, also of a search that ends by an error."""
    try:
        summary = search(on_event=emit)
    except CampaignError:
        if campaign.started:
            # What cannot be written for the same reason, such as a full disk, is left out.
            with suppress(FreneticError, OSError):
                _finish(campaign, None, emit)
        raise
    return _finish(campaign, summary, emit)


def _finish(campaign: Campaign, summary: Summary | None, emit: OnEvent) -> Results:
    """Read the findings, shorten roads and write the results."""
    with CampaignStore.open(campaign.folder) as store:
        findings = Findings.of(store)
        notes = [findings.warning] if findings.warning else []
        results = Results(campaign.folder, summary, findings, notes=tuple(notes))
        if summary is not None and len(findings.clusters):
            notes += _shortened(campaign, results, summary, emit)
        shortened = minimised_drives(store, [test.id for test in findings.listed])
        results = replace(results, shortened=shortened, notes=tuple(notes))
        emit(Step("found", results))
        return write_results(store, results, emit)


def _shortened(
    campaign: Campaign, results: Results, summary: Summary, emit: OnEvent
) -> Iterator[str]:
    """Shorten roads unless that says nothing or takes too long; yield notes for the user."""
    if summary.interrupted or summary.not_repeatable:
        return
    workers = campaign.workers
    is_elsewhere = isinstance(workers, str)
    seconds = summary.seconds * (1 if isinstance(workers, str) else workers)
    if is_elsewhere or seconds > SLOW_DRIVE * summary.simulations:
        yield f"shorter roads for the same failures: {_minimise_command(campaign)}"
        return
    emit(Step("shortening", results, _shortening_seconds(summary)))
    yield from shorten_causes(campaign, results.findings, summary)


def _shortening_seconds(summary: Summary) -> float:
    """Wall time that shortening may take, in s."""
    return max(LEAST_SHORTENING, summary.seconds / SHORTENING_SHARE)


def _minimise_command(campaign: Campaign) -> str:
    """The command that shortens failing roads of a campaign."""
    return f"frenetic minimise {shlex.quote(str(campaign.folder))} --top 3"
