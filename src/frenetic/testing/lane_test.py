"""A driver's test for pytest: it keeps its lane on roads that a search looks for.

::

    @keeps_lane(roads="rural-80", criteria="after-iso-11270", simulations=300)
    def test_my_driver():
        return MyDriver()

Roads on which it failed once lie beside the test, in `FOLDER`, and are driven first.
"""

from __future__ import annotations

import functools
import hashlib
import inspect
import json
import os
import re
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any, Final, TypeVar

from frenetic._support.bounds import require_count
from frenetic._support.files import write_file
from frenetic._support.words import counted
from frenetic.analysis.causes import as_text, cause_of
from frenetic.analysis.segments import segment_of
from frenetic.campaign import Budget, Campaign, CampaignStore, Event, RoadTester, Test
from frenetic.campaign.defaults import MAX_IN_FLIGHT
from frenetic.criteria.criterion import COMPETITION
from frenetic.drivers import Driver
from frenetic.errors import DriverError, FreneticError
from frenetic.oracle.drive import Drive
from frenetic.oracle.outcome import Outcome
from frenetic.oracle.verdict import Result, judge
from frenetic.rerun.minimise import Minimised, minimise_causes
from frenetic.road import Road
from frenetic.road.files import entries_of, read_road
from frenetic.spec import Spec

FOLDER: Final = "failing-roads"
"""Name of the folder beside a test's file for the roads on which it failed."""
_FAILURES: Final = 20
"""Failures that end a search."""
_CAUSES: Final = 3
"""Most causes that a failure message names, each with a minimised road."""
_MINIMISING: Final = 100
"""Most drives to minimise the road of each cause."""
_REMEDY: Final = "let pytest write there"

_MOST_STEM: Final = 60  # characters of a module's, and of a test's, name in a road file's name
_PLAIN: Final = re.compile(rf"[a-z0-9_]{{1,{_MOST_STEM}}}-[a-z0-9_]{{1,{_MOST_STEM}}}")
"""What a file's name says of a test without loss on any system."""
_UNSAFE: Final = re.compile(r"[^A-Za-z0-9_.]+")

TestFunction = TypeVar("TestFunction", bound=Callable[..., Any])


class DriverFailedError(AssertionError):
    """The driver failed on a road; the message says why, on which and how to drive it again."""


SHOWN: Final = (DriverFailedError, FreneticError)
"""Errors that the plug-in shows without a traceback."""


def keeps_lane(
    function: None = None,
    /,
    *,
    roads: str | Mapping[str, Any] = "competition",
    criteria: str | Mapping[str, Any] = "competition",
    simulations: int = 300,
    seconds: float = 60.0,
    seed: int = 0,
    simulator: str = "embedded",
    conditions: Mapping[str, float] = MappingProxyType({}),
    speed_limit: float | None = None,
    oob_tolerance: float | None = None,
) -> Callable[[TestFunction], TestFunction]:
    """Makes a function that returns a driver a test that the driver keeps its lane.

    The function may have fixtures and parameters as any test. Roads on which it failed once are
    driven first; then a search looks for others, shortens what it finds, and remembers it in
    `FOLDER` beside the test's file, to be committed. A failure tells the causes in words, the
    roads' files and pictures, and what drives them again.

    The same seed gives the same result. The time does not change what is driven: it only ends a
    search early, which then passes unless something failed by then, and says so.

    Args:
        roads: which roads may exist, as for ``--roads``, or a class's values.
        criteria: what fails beside leaving the lane, as for ``--criteria``, or a file's entries.
        simulations: most drives of the search.
        seconds: wall time after which it ends.
        seed: of the search.
        simulator: its name with options, as for ``--simulator``.
        conditions: amounts of conditions of the driver, as for ``--with``.
        speed_limit: km/h; by default the roads' limit.
        oob_tolerance: share of the car that may be out; 0.95 by default.

    Raises:
        TypeError: it was written without parentheses.
        ValueError: an argument is out of range.
        FreneticError: there are no such roads, criteria or simulator.
    """
    if function is not None:
        raise TypeError("keeps_lane is needed with parentheses: @keeps_lane()")
    require_count("simulations", simulations)
    if not seconds > 0.0:
        raise ValueError(f"seconds is {seconds}: a positive number is needed")
    classes = {"roads": roads, "criteria": criteria, "conditions": conditions}
    values: dict[str, Any] = {
        **{name: dict(v) if isinstance(v, Mapping) else v for name, v in classes.items()},
        "simulator": simulator,
        "speed_limit": speed_limit,
        "oob_tolerance": oob_tolerance,
        "simulations": simulations,
        "seed": seed,
    }
    spec = Spec(**values)
    spec.terms  # noqa: B018  # refused here, not when the test runs

    def decorated(function: TestFunction) -> TestFunction:
        @functools.wraps(function)
        def test(*arguments: Any, **named: Any) -> None:
            __tracebackhide__ = True
            driver = function(*arguments, **named)
            if isinstance(driver, type) or not all(
                callable(getattr(driver, name, None)) for name in ("reset", "act")
            ):
                raise DriverError(
                    f"{function.__name__} returned {driver!r}: a driver with reset and act is"
                    " needed, see frenetic.Driver"
                )
            file, name = Path(inspect.getfile(function)), _name_of(function)
            stem = memory_stem(file.stem, name)
            check = _Check(spec, seconds, driver, file.parent / FOLDER, name, stem)
            if text := check.failure():
                raise DriverFailedError(text)

        marked: TestFunction = _marked(test)
        return marked

    return decorated


def _marked(test: Callable[..., Any]) -> Any:
    """The test with pytest's mark, by which ``-m keeps_lane`` finds it, if there is pytest."""
    try:
        import pytest  # the test runs without it, too
    except ImportError:
        return test
    return pytest.mark.keeps_lane(test)


def _name_of(function: Callable[..., Any]) -> str:
    """The id of the test that runs, as pytest names it; or the function's name."""
    running = os.environ.get("PYTEST_CURRENT_TEST", "").rpartition(" ")[0]
    return running if function.__name__ in running else function.__qualname__


def memory_stem(module: str, name: str) -> str:
    """Return the beginning of the names of a test's road files, which no other test shares.

    It is ``bends_test-test_hasty`` for ``bends_test.py::test_hasty``. Where that leaves out a sign
    of the id, or letters differ in case only, a digest of the id follows.

    Args:
        module: name of the file that holds the test's function, without its suffix.
        name: id of the test, or outside pytest the name of its function.
    """
    path, separator, test = name.partition("::")
    if not separator:
        path, test = module, name
    elif Path(path).stem == module:  # whatever folder pytest was started in
        path = module
    if _PLAIN.fullmatch(stem := f"{path}-{test}"):
        return stem
    texts = (
        _UNSAFE.sub("-", text).strip("-.")[:_MOST_STEM] for text in (path.replace(".", "-"), test)
    )
    return "-".join([*texts, _digest(f"{path}::{test}", 12)])


NOTICES: Final[list[str]] = []
"""What the tests that ran since it was emptied have to say; the plug-in shows it."""


@dataclass(frozen=True)
class _Check:
    """The check of one driver."""

    spec: Spec
    seconds: float
    driver: Driver
    folder: Path
    name: str
    """Id of the test."""
    stem: str
    """Beginning of the names of the test's road files, from `memory_stem`."""

    def failure(self) -> str:
        """Return the failures as text; empty if nothing failed.

        Raises:
            FreneticError: the simulator broke, or a remembered road's file is damaged.
        """
        with self.spec.make_simulator() as simulator:
            tester = RoadTester(simulator, self.driver, self.spec.terms)
            known = list(self._again(tester))
            if known:
                title = f"It fails on {counted(len(known), 'road')} on which it failed before"
                return self._text(title, known)
            return self._search(tester)

    def _again(self, tester: RoadTester) -> Iterator[list[str]]:
        """Drive the remembered roads and yield those that fail, in lines."""
        terms = tester.terms
        paths = sorted(self.folder.glob(f"{self.stem}-????????.json"))
        for path in paths:
            loaded = read_road(path).road()
            road, verdict = loaded.placed(
                terms.map_size, terms.map_margin, road_class=terms.road_class
            )
            if road is None or not verdict.valid:
                self._notice(f"{path} is not driven: {verdict.message}")
                continue
            drive = tester.drive(road)
            result = judge(road, drive)
            if result.outcome is Outcome.ERROR:
                raise FreneticError(f"the simulator broke on {path}: {result.reason}")
            if result.outcome is Outcome.FAIL:
                self._draw(road, drive, path)
                yield _lines(_cause(road, drive, result), result, road, path)

    def _search(self, tester: RoadTester) -> str:
        """Search for failures and return them as text; empty if none."""
        strategy = self.spec.make_strategy()
        budget = self.spec.budget
        assert budget is not None
        with TemporaryDirectory(prefix="frenetic-") as folder:
            campaign = Campaign(
                strategy=strategy,
                simulator=tester.simulator,
                driver=tester.driver,
                # Without a limit of time, by which a search would depend on the machine's speed.
                budget=Budget(simulations=budget.simulations, failures=_FAILURES),
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
                raise FreneticError(summary.broken)
            if not summary.failed:
                if summary.interrupted:
                    self._notice(
                        f"stopped after {self.seconds:g} s and {summary.simulations} of"
                        f" {budget.simulations} simulations, none of which failed"
                    )
                return ""
            with CampaignStore.open(folder) as store:
                failing = list(self._remembered(store, tester))
            failures = counted(summary.failures, "failure")
            title = f"{failures} in {counted(summary.simulations, 'simulation')}"
            return self._text(title, failing, summary.not_repeatable)

    def _remembered(self, store: CampaignStore, tester: RoadTester) -> Iterator[list[str]]:
        """Yield a failure of each of the most frequent causes, shortened and written."""
        from frenetic.report.results import Findings  # imports slowly

        clusters = Findings.of(store).clusters
        causes = clusters.causes[:_CAUSES]
        drives = _MINIMISING * len(causes)
        shortened = dict(minimise_causes(store.folder, causes, tester, drives))
        for cause in causes:
            test, note = store.test(cause.example), ""
            smallest, answer = test, shortened.get(test.id)
            if isinstance(answer, Minimised):
                smallest = answer.smallest
            elif answer is not None:
                note = f"it was not shortened: {answer}"
            words = f"{cause.words} ({cause.failures} of {clusters.failures})"
            yield self._remember(smallest, words, note, test.road.length)

    def _remember(self, test: Test, words: str, note: str, length: float) -> list[str]:
        """Write the road of a test beside the test, and return its failure in lines."""
        road, result = test.road, test.result
        origin = {
            "test": self.name,
            "cause": words.partition(" (")[0],
            "reason": result.reason,
            "roads": COMPETITION if (c := self.spec.road_class) is None else c.name,
            "criteria": self.spec.rules.criteria.name,
        }
        entries = {name: value for name, value in entries_of(road).items() if name != "pose"}
        lines = [f"  {json.dumps(k)}: {json.dumps(v)}" for k, v in (origin | entries).items()]
        text = "{\n" + ",\n".join(lines) + "\n}\n"
        path = self.folder / f"{self.stem}-{_digest(json.dumps(entries))}.json"
        write_file(path, text, remedy=_REMEDY, parents=True)
        ignored = self.folder / ".gitignore"
        if not ignored.exists():
            write_file(ignored, "*.png\n", remedy=_REMEDY)
        if test.drive is not None:
            self._draw(road, test.drive, path)
        if road.length < length - 0.5:
            note = f"shortened from {length:.0f} m{f'; {note}' if note else ''}"
        return _lines(words, result, road, path, note)

    def _draw(self, road: Road, drive: Drive, path: Path) -> None:
        from frenetic.report.picture import draw_drive  # matplotlib imports slowly

        if len(drive.trajectory):
            draw_drive(road, drive, path.with_suffix(".png"), title=path.stem)

    def _text(self, title: str, failures: list[list[str]], note: str = "") -> str:
        spec = self.spec
        roads = COMPETITION if spec.road_class is None else spec.road_class.as_text()
        lines = [f"{title}; roads: {roads}; criteria: {spec.rules.criteria.name}"]
        for failure in failures:
            lines += ["", *failure]
        if note:
            lines += ["", f"Note: {note}"]
        lines += ["", f'Drive them again: pytest "{self.name}"']
        return "\n".join(lines)

    def _notice(self, text: str) -> None:
        NOTICES.append(f"{self.name}: {text}")


def _lines(cause: str, result: Result, road: Road, path: Path, note: str = "") -> list[str]:
    """Return a failure in lines, for the message."""
    remark = f", {note}" if note else ""
    lines = [f"The driver {cause}", f"  {result.reason}"]
    lines.append(f"  road      {_shown(path)}, {road.length:.0f} m{remark}")
    if (picture := path.with_suffix(".png")).exists():
        lines.append(f"  picture   {_shown(picture)}")
    return lines


def _cause(road: Road, drive: Drive, result: Result) -> str:
    """Return what the driver does wrong in a drive, in words."""
    if result.fault is not None:
        return str(result.fault)
    return as_text(*cause_of(segment_of(road, drive, result.finding)))


def _digest(text: str, length: int = 8) -> str:
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:length]


def _shown(path: Path) -> str:
    """Return a path relative to the current folder, if it lies within."""
    try:
        return str(path.resolve().relative_to(Path.cwd()))
    except ValueError:
        return str(path)
