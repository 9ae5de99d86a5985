"""A search with everything that its user gets: causes, shortened roads, pictures and the report.

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
from frenetic.analysis.explained import ExplainedCause, explained_causes
from frenetic.campaign import Campaign, CampaignStore, Event, Summary, Test
from frenetic.campaign.counts import Counts
from frenetic.errors import CampaignError, CampaignGoneError, FreneticError
from frenetic.processes.interrupt import plain_interrupts
from frenetic.report.failures import FAILURES, GALLERY, write_failures
from frenetic.report.html.campaign import write_report
from frenetic.report.html.reading import Reading
from frenetic.report.minimised import MinimisedFiles, minimised_document, write_minimised
from frenetic.rerun.cause_trials import examples_of, try_failures
from frenetic.rerun.minimise import minimise_causes
from frenetic.rerun.minimised_roads import minimised_drives, minimised_road

SLOW_DRIVE: Final = 0.5
"""Wall time of a drive above which no failing road is shortened, in s; our choice."""
SHORTENING_DIVISOR: Final = 3
"""Shortening may take a third of the search's drives and of its wall time; our choice."""
MIN_SHORTENING_TIME: Final = 30.0
"""Wall time that shortening may take however short the search was, in s; our choice."""
TOP_CAUSES: Final = 3
"""Number of causes for which the advised command shortens roads; our choice."""


@dataclass(frozen=True)
class Findings:
    """The failures of a campaign by cause, or else its nearest misses."""

    reading: Reading
    """The campaign's tests, read once."""
    listed: Sequence[Test]
    """The most telling failures, or nearest misses, which the gallery shows."""
    warning: str
    """Warning of conclusions that the counts do not support; empty without a warning."""

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
        """The distinct failures with their causes; empty if nothing failed."""
        return self.reading.clusters

    @property
    def misses(self) -> Clusters | None:
        """The nearest misses; None if a test failed."""
        return self.reading.misses

    @property
    def failures(self) -> list[Test]:
        """The most severe failures, each of which gets a file."""
        return list(self.reading.failures)


@dataclass(frozen=True)
class Results:
    """The results of a search, and the files in its folder."""

    folder: Path
    """The campaign's folder."""
    summary: Summary | None
    """Counts and times of the search; None if it ended by an error."""
    findings: Findings
    causes: tuple[ExplainedCause, ...] = ()
    """The causes of the failures, with evidence and trials."""
    shortened: Mapping[int, Test] = field(default_factory=dict)
    """Id of a failing test -> drive on its shortened road."""
    notes: tuple[str, ...] = ()
    """Sentences that the user should read."""
    gallery: Path | None = None
    """Picture of the most telling failures; None if there is nothing to show."""
    report: Path | None = None
    """The HTML report; None if nothing was tested or it cannot be written, as a note says."""


@dataclass(frozen=True)
class Step:
    """A step of the work after a search, which listeners are told."""

    kind: Literal["trying", "shortening", "found", "drawing", "drawn", "reporting", "reported"]
    """Kind of the step.

    - ``trying``, ``shortening``, ``drawing``, ``reporting``: the work begins.
    - ``found``: causes and shortened roads are known.
    - ``drawn``, ``reported``: the pictures, or the report, are written.
    """
    results: Results
    """The results so far."""
    seconds: float = 0.0
    """Wall time that the work may take, in s; 0 without a limit."""


OnEvent: TypeAlias = Callable[[Event | Step], object]
"""Listener to the events of a search and the steps after it."""


def run(campaign: Campaign, *, on_event: OnEvent | None = None) -> Results:
    """Run a campaign, and write everything that its user gets into its folder.

    The folder gets trials of the causes, a shortened failing road of each cause, files and pictures
    of the failures, and the report.

    Args:
        campaign: the campaign; it needs a budget.
        on_event: called with each `Event` of the search, as `Campaign.run` does, and with each
            `Step` after it.

    Raises:
        CampaignError: `Campaign.run` raises it. The results so far are written.
    """
    return _run(campaign, campaign.run, on_event)


def resume(campaign: Campaign, *, on_event: OnEvent | None = None) -> Results:
    """Continue a campaign, see `Campaign.resume`, and write the same files as `run`."""
    return _run(campaign, campaign.resume, on_event)


def shorten_causes(campaign: Campaign, findings: Findings, summary: Summary) -> Iterator[str]:
    """Shorten a failing road of each cause, and write it with its picture.

    Shortening may take a third of the search's drives and of its wall time.

    Yields:
        Notes for the user, such as why a road was not shortened.
    """
    folder, tester, causes = campaign.folder, campaign.tester, findings.clusters.causes
    drives, seconds = summary.simulations // SHORTENING_DIVISOR, _shortening_seconds(summary)
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
    """Write files and pictures of the failures, and the report.

    Returns:
        The results with the paths of what was written.

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
        except FreneticError as error:  # the other results stand
            results = replace(results, notes=(*results.notes, f"There is no report: {error}"))
        on_event(Step("reported", results))
    return results


def _run(campaign: Campaign, search: Callable[..., Summary], on_event: OnEvent | None) -> Results:
    """Search and write the results; an interrupt of compiled code raises KeyboardInterrupt.

    Args:
        campaign: the campaign.
        search: its method `run` or `resume`.
        on_event: listener to events and steps; None without a listener.
    """
    with plain_interrupts():
        return _search_and_finish(campaign, search, on_event or (lambda _: None))


def _search_and_finish(
    campaign: Campaign, search: Callable[..., Summary], emit: OnEvent
) -> Results:
    """Search and write the results, also of a search that ends by an error."""
    try:
        summary = search(on_event=emit)
    except CampaignError:
        if campaign.started:
            # The reason of the error, such as a full disk, may prevent writing, too.
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
            notes += _examine(campaign, results, summary, emit)
        causes = explained_causes(store, findings.clusters, findings.reading.passing)
        shortened = minimised_drives(store, [test.id for test in findings.listed])
        results = replace(results, causes=causes, shortened=shortened, notes=tuple(notes))
        emit(Step("found", results))
        return write_results(store, results, emit)


def _examine(
    campaign: Campaign, results: Results, summary: Summary, emit: OnEvent
) -> Iterator[str]:
    """Try causes and shorten roads if drives repeat and are fast enough; yield notes."""
    if summary.interrupted or summary.not_repeatable:
        return
    workers = campaign.workers
    if isinstance(workers, str):  # the address of a cluster
        is_slow = True
    else:
        is_slow = summary.seconds * workers > SLOW_DRIVE * summary.simulations
    if is_slow:
        yield f"shorter roads for the same failures: {_minimise_command(campaign)}"
        yield f"trials of their causes: {_trials_command(campaign)}"
        return
    emit(Step("trying", results))
    examples = examples_of(results.findings.clusters.causes)
    try:
        try_failures(campaign.folder, examples, campaign.tester, isolate=campaign.isolate)
    except CampaignGoneError:
        raise
    except FreneticError as error:
        yield f"causes were not tried: {error}"
    emit(Step("shortening", results, _shortening_seconds(summary)))
    yield from shorten_causes(campaign, results.findings, summary)


def _shortening_seconds(summary: Summary) -> float:
    """Return the wall time that shortening may take, in s."""
    return max(MIN_SHORTENING_TIME, summary.seconds / SHORTENING_DIVISOR)


def _trials_command(campaign: Campaign) -> str:
    """Return the command that tries the causes of a campaign's failures."""
    return f"frenetic rerun {shlex.quote(str(campaign.folder))} --trials"


def _minimise_command(campaign: Campaign) -> str:
    """Return the command that shortens failing roads of a campaign."""
    return f"frenetic minimise {shlex.quote(str(campaign.folder))} --top {TOP_CAUSES}"
