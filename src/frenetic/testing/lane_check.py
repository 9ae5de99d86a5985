"""The check behind a driver's test: it drives remembered roads, then searches for failing ones."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from frenetic._support.files import write_file
from frenetic._support.words import counted
from frenetic.campaign import Budget, Campaign, CampaignStore, Event, RoadTester, Test
from frenetic.campaign.defaults import MAX_IN_FLIGHT
from frenetic.criteria.criterion import COMPETITION, criteria_sets
from frenetic.drivers import Driver
from frenetic.errors import FreneticError
from frenetic.oracle.drive import Drive
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Result, judge
from frenetic.rerun.margin import measure_margins
from frenetic.rerun.margin_quantities import RequiredAmount, measured_quantities
from frenetic.rerun.minimise import Minimised, minimise_causes
from frenetic.road import Road
from frenetic.road.files import entries_of, read_road
from frenetic.segments.causes import as_text, cause_of
from frenetic.segments.evidence import evidence_of_drive
from frenetic.segments.segment import segment_of
from frenetic.spec import Spec

_MAX_FAILURES: Final = 20
"""Number of failures that end a search; our choice."""
_MAX_CAUSES: Final = 3
"""Largest number of causes that a failure message names, each with a shortened road; our choice."""
_MINIMISING_DRIVES: Final = 100
"""Largest number of drives that shorten the road of a cause; our choice."""
_VISIBLE_CUT: Final = 0.5  # [m] by which a road has to be shorter for the message to say so
_REMEDY: Final = "let pytest write there"
_DIGEST_LENGTH: Final = 8  # characters of the digest in a road file's name


@dataclass(frozen=True)
class LaneCheck:
    """The check that a driver keeps its lane: on remembered roads, then in a search."""

    spec: Spec
    """Spec of the search, with a budget of simulations."""
    seconds: float
    """Wall time after which the search ends, in s."""
    driver: Driver
    """The driver under test."""
    folder: Path
    """Folder of the remembered roads."""
    name: str
    """Id of the test."""
    stem: str
    """Beginning of the names of the test's road files."""
    margin: Sequence[RequiredAmount] = ()
    """Amounts of conditions before which the driver must not begin to fail."""
    notices: list[str] = field(default_factory=list)
    """Notices for the user, added by `failure_text`."""

    def failure_text(self) -> str:
        """Drive, and return the message about the failures; empty if nothing failed.

        Raises:
            FreneticError: the simulator broke, or a remembered road's file is damaged.
        """
        with self.spec.make_simulator() as simulator:
            tester = RoadTester(simulator, self.driver, self.spec.terms)
            failures = list(self._drive_remembered(tester))
            if failures:
                title = f"It fails on {counted(len(failures), 'road')} on which it failed before"
                return self._message(title, failures)
            text = self._search(tester)
        return text or self._margin_text(tester)

    def _drive_remembered(self, tester: RoadTester) -> Iterator[list[str]]:
        """Drive the remembered roads, and yield the lines about each road that fails."""
        terms = tester.terms
        paths = sorted(self.folder.glob(f"{self.stem}-{'?' * _DIGEST_LENGTH}.json"))
        for path in paths:
            loaded = read_road(path).road()
            road, verdict = loaded.placed(
                terms.map_size, terms.map_margin, road_class=terms.road_class
            )
            if road is None or not verdict.valid:
                self.notices.append(f"{path} is not driven: {verdict.message}")
                continue
            drive = tester.drive(road)
            result = judge(road, drive)
            if result.outcome is Outcome.ERROR:
                raise FreneticError(f"the simulator broke on {path}: {result.reason}")
            if result.outcome is Outcome.FAIL:
                self._draw(road, drive, path)
                yield _failure_lines(_cause(road, drive, result), result, road, drive, path)

    def _search(self, tester: RoadTester) -> str:
        """Search for failing roads, and return the message about them; empty if there are none."""
        strategy = self.spec.make_strategy(driver=tester.driver, simulator=tester.simulator)
        budget = self.spec.budget
        assert budget is not None
        with TemporaryDirectory(prefix="frenetic-") as folder:
            campaign = Campaign(
                strategy=strategy,
                simulator=tester.simulator,
                driver=tester.driver,
                # A limit of time here would make the roads depend on the machine's speed.
                budget=Budget(simulations=budget.simulations, failures=_MAX_FAILURES),
                folder=folder,
                max_in_flight=strategy.default_max_in_flight or MAX_IN_FLIGHT,
                objective=self.spec.named_objective,
                terms=tester.terms,
            )
            end = time.monotonic() + self.seconds

            def on_event(event: Event) -> None:
                if event.kind == "interrupted":
                    raise KeyboardInterrupt
                if event.kind == "result" and time.monotonic() > end:
                    campaign.stop()

            summary = campaign.run(on_event=on_event)
            if summary.errors and not summary.failed:
                raise FreneticError(summary.broken_text)
            if not summary.failed:
                if summary.interrupted:
                    self.notices.append(
                        f"stopped after {self.seconds:g} s and {summary.simulations} of"
                        f" {budget.simulations} simulations, none of which failed"
                    )
                return ""
            with CampaignStore.open(folder) as store:
                lines = list(self._remember_causes(store, tester))
            failures = counted(summary.failures, "failure")
            title = f"{failures} in {counted(summary.simulations, 'simulation')}"
            return self._message(title, lines, summary.not_repeatable)

    def _margin_text(self, tester: RoadTester) -> str:
        """Measure margins, and return the message about those too small; empty if there are none.

        Each range ends at the required amount, so that few drives are needed where it is borne.
        """
        if not self.margin:
            return ""
        quantities = measured_quantities(tester, {}, self.margin)
        seed = self.spec.seed or 0
        with TemporaryDirectory(prefix="frenetic-") as folder:
            margins = measure_margins(tester, quantities, seed=seed, out=Path(folder) / "margins")
        shortfalls = margins.shortfalls(self.margin)
        if not shortfalls:
            return ""
        title = f"{counted(len(shortfalls), 'margin')} too small"
        failures = [
            [
                text,
                f"  {margin.never.total - margin.never.count} of {margin.never.total} random"
                f" roads fail up to {margin.quantity.text(margin.quantity.end)}",
            ]
            for margin in margins.margins
            if (text := shortfalls.get(margin.quantity.key)) is not None
        ]
        return self._message(title, failures, " ".join(margins.notes))

    def _remember_causes(self, store: CampaignStore, tester: RoadTester) -> Iterator[list[str]]:
        """Shorten and write a road of each of the most frequent causes; yield lines about it."""
        from frenetic.report.results import Findings  # imports slowly

        clusters = Findings.of(store).clusters
        causes = clusters.causes[:_MAX_CAUSES]
        drives = _MINIMISING_DRIVES * len(causes)
        answers = dict(minimise_causes(store.folder, causes, tester, drives))
        for cause in causes:
            test = store.test(cause.example)
            smallest, remarks, answer = test, [], answers.get(test.id)
            if isinstance(answer, Minimised):
                smallest = answer.smallest
            elif answer is not None:
                remarks.append(f"it was not shortened: {answer}")
            if smallest.road.length < test.road.length - _VISIBLE_CUT:
                remarks.insert(0, f"shortened from {test.road.length:.0f} m")
            path = self._remember(smallest, cause.words)
            words = f"{cause.words} ({cause.failures} of {clusters.failures})"
            yield _failure_lines(
                words, smallest.result, smallest.road, smallest.drive, path, "; ".join(remarks)
            )

    def _remember(self, test: Test, cause: str) -> Path:
        """Write a test's road and the picture of its drive; return the path of the road's file.

        Args:
            test: the test.
            cause: cause of the failure in words, for the reader of the file.
        """
        road, road_class = test.road, self.spec.road_class
        origin = {
            "test": self.name,
            "cause": cause,
            "reason": test.result.reason,
            "roads": COMPETITION if road_class is None else road_class.name,
            "criteria": self.spec.rules.criteria.name,
        }
        entries = {name: value for name, value in entries_of(road).items() if name != "pose"}
        lines = [
            f"  {json.dumps(name)}: {json.dumps(value)}"
            for name, value in (origin | entries).items()
        ]
        text = "{\n" + ",\n".join(lines) + "\n}\n"
        path = self.folder / f"{self.stem}-{short_digest(json.dumps(entries))}.json"
        write_file(path, text, remedy=_REMEDY, parents=True)
        ignored = self.folder / ".gitignore"
        if not ignored.exists():
            write_file(ignored, "*.png\n", remedy=_REMEDY)
        if test.drive is not None:
            self._draw(road, test.drive, path)
        return path

    def _draw(self, road: Road, drive: Drive, path: Path) -> None:
        """Draw a drive beside the file of its road, unless the drive has no records."""
        from frenetic.report.picture import draw_drive  # matplotlib imports slowly

        if len(drive.trajectory):
            draw_drive(road, drive, path.with_suffix(".png"), title=path.stem)

    def _message(self, title: str, failures: Iterable[Sequence[str]], note: str = "") -> str:
        """Return the message of a failed check.

        Args:
            title: what failed, in a few words.
            failures: lines about each failure.
            note: a warning for the reader; empty without one.
        """
        spec = self.spec
        roads = COMPETITION if spec.road_class is None else spec.road_class.as_text()
        criteria = spec.rules.criteria
        is_known = criteria_sets().get(criteria.name) == criteria
        criteria_text = criteria.name if is_known else criteria.as_text()
        lines = [f"{title}; roads: {roads}; criteria: {criteria_text}"]
        for failure in failures:
            lines += ["", *failure]
        if note:
            lines += ["", f"Note: {note}"]
        lines += ["", f'Drive them again: pytest "{self.name}"']
        return "\n".join(lines)


def _failure_lines(
    cause: str, result: Result, road: Road, drive: Drive | None, path: Path, remark: str = ""
) -> list[str]:
    """Return the lines of the message about one failure.

    Args:
        cause: what the driver did, after "The driver".
        result: result of the drive.
        road: the road.
        drive: the drive; None if it has no records.
        path: path of the road's file.
        remark: a remark about the road; empty without one.
    """
    length = f"{road.length:.0f} m{f', {remark}' if remark else ''}"
    lines = [f"The driver {cause}", f"  {result.reason}"]
    evidence = None if drive is None else evidence_of_drive(road, drive, result)
    if evidence is not None:
        lines.append(f"  mistake   {evidence.text}")
    lines.append(f"  road      {_relative_path(path)}, {length}")
    if (picture := path.with_suffix(".png")).exists():
        lines.append(f"  picture   {_relative_path(picture)}")
    return lines


def _cause(road: Road, drive: Drive, result: Result) -> str:
    """Return what the driver does wrong in a drive, in words."""
    if result.fault is not None:
        return str(result.fault)
    return as_text(*cause_of(segment_of(road, drive, result.finding)))


def short_digest(text: str, length: int = _DIGEST_LENGTH) -> str:
    """Return the beginning of a text's SHA-256, with ``length`` hexadecimal digits."""
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:length]


def _relative_path(path: Path) -> str:
    """Return a path relative to the current folder if it lies in this folder, else as it is."""
    try:
        return str(path.resolve().relative_to(Path.cwd()))
    except ValueError:
        return str(path)
