"""Driving a campaign's roads again: a campaign in the folder ``again`` of the campaign's own.

Each has a folder of its own, named after a digest of what it drives with what. So the same call
goes on with an interrupted one, gives a complete one as it is, and never replaces another.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final, TypedDict, TypeVar, Unpack

from msgspec import ValidationError, convert, json

from frenetic.analysis.failures import Failure
from frenetic.campaign.campaign import Campaign
from frenetic.campaign.record import Test
from frenetic.campaign.store import DATABASE, CampaignStore
from frenetic.campaign.tester import RoadTester
from frenetic.drivers import Driver
from frenetic.errors import CampaignError
from frenetic.outcome import Outcome
from frenetic.redrive.conditions import Variation
from frenetic.redrive.record import Purpose, Redrive, Run
from frenetic.redrive.strategy import Again
from frenetic.simulators.simulator import Simulator
from frenetic.simulators.worlds import USUAL, Conditions, conditions_document
from frenetic.spec import Budget, describe, require_count, version_notes
from frenetic.versions import SHORT, comparison_key

T = TypeVar("T")

FOLDER: Final = "again"
"""Folder, in that of a campaign, of the campaigns that drove its roads again."""
FACT: Final = "again"
"""Entry of such a campaign's configuration, see `_Terms`."""

logger = logging.getLogger(__name__)


class RedriveOptions(TypedDict, total=False):
    """Options of all that drives roads again."""

    workers: int
    """Number of roads driven at once, as for `Campaign`; 1 by default."""
    drive_limit: float | None
    """Wall time in s, likewise."""
    out: Path | str | None
    """Folder of the campaign that drives them; by default one in the campaign's own."""
    on_start: Callable[[], None] | None
    """Called when the simulator has started."""
    on_interrupt: Callable[[], None] | None
    """Called at the first Ctrl-C, which ends it after the running drives."""


@dataclass(frozen=True)
class RedriveProgress:
    """Progress of driving a campaign's roads again."""

    test_id: int
    """Test of the last drive."""
    drives: int
    total: int
    failed: int

    @property
    def tests(self) -> int:
        """Number of drives, where each test is driven once."""
        return self.drives


@dataclass(frozen=True)
class _Terms:
    """Why roads were driven again, in the configuration of that campaign."""

    purpose: Purpose
    planned: int
    """Number of drives."""
    seed: int | None = None
    """Ranges of the drawn conditions, if any."""
    variations: tuple[Variation, ...] = ()
    digest: str = ""
    """See `_digest`."""


def campaign_tester(store: CampaignStore, simulator: Simulator, driver: Driver) -> RoadTester:
    """Drives a campaign's roads, possibly with other parts; warns of other versions of its own.

    Raises:
        CampaignError: the campaign's configuration is damaged.
    """
    setting = store.setting
    warn_of_versions(store, simulator, driver)
    return RoadTester(simulator, driver, setting.map_size, setting.margin, setting.lane_width)


def warn_of_versions(store: CampaignStore, simulator: Simulator, driver: Driver) -> None:
    """Logs a warning for each part that is another version of the campaign's."""
    for note in version_notes(store.config, simulator=simulator, driver=driver):
        logger.warning("%s", note)


def drive_again(
    folder: Path | str,
    purpose: Purpose,
    tester: RoadTester,
    tests: Sequence[Test],
    conditions: Sequence[Conditions] = (USUAL,),
    *,
    seed: int | None = None,
    variations: Sequence[Variation] = (),
    on_progress: Callable[[RedriveProgress], None] | None = None,
    **how: Unpack[RedriveOptions],
) -> Run:
    """Drives tests of a campaign again, each in all conditions, as far as that is not yet done.

    Args:
        folder: of the campaign.
        purpose: of the run.
        tester: see `campaign_tester`.
        tests: the tests.
        conditions: of the drives of each test.
        seed: from which the conditions were drawn, if they were.
        variations: ranges from which they were drawn.
        on_progress: called with every drive.
        how: see `RedriveOptions`.

    Returns:
        The run, with its drives in the order of tests and conditions; after Ctrl-C there are fewer.

    Raises:
        CampaignError: a test was not driven, nothing can be stored, ``out`` holds something else,
            or no worker can be started.
        ValueError: an option is out of range.
    """
    strategy = Again(
        folder, [test.id for test in tests], [conditions_document(one) for one in conditions]
    )
    simulator, driver = tester.simulator, tester.driver
    terms = _Terms(purpose, len(strategy), seed, tuple(variations))
    terms = replace(terms, digest=_digest(strategy, terms, tester))
    place = Path(how.get("out") or Path(folder) / FOLDER / terms.digest)
    workers = require_count("workers", how.get("workers", 1))
    if len(strategy) == 0:
        return Run(purpose, describe(driver), describe(simulator), simulator.rules, simulator.car)
    campaign = Campaign(
        strategy=strategy,
        simulator=simulator,
        driver=driver,
        budget=Budget(simulations=len(strategy)),
        folder=place,
        map_size=tester.map_size,
        margin=tester.margin,
        lane_width=tester.lane_width,
        workers=min(workers, len(strategy)),
        drive_limit=how.get("drive_limit"),
        description={FACT: json.decode(json.encode(terms))},
    )
    exists = (place / DATABASE).is_file()
    done = failed = 0
    if exists:
        with CampaignStore.open(place) as store:
            theirs = _terms_of(store)
        if theirs != terms:
            raise CampaignError(f"{place} holds another campaign: choose another --out")
        run = read_run(place, folder)
        if len(run.drives) == run.planned:
            return run
        done, failed = len(run.drives), sum(one.outcome is Outcome.FAIL for one in run.drives)

    def report(test: Test) -> None:
        nonlocal done, failed
        done, failed = done + 1, failed + (test.outcome is Outcome.FAIL)
        if on_progress is not None and test.candidate.source is not None:
            number = test.candidate.source.test
            on_progress(RedriveProgress(number, done, len(strategy), failed))

    search = campaign.resume if exists else campaign.run
    search(on_test=report, on_start=how.get("on_start"), on_interrupt=how.get("on_interrupt"))
    return read_run(place, folder)


def _digest(strategy: Again, terms: _Terms, tester: RoadTester) -> str:
    """Digits of what is driven with what, wherever the campaign lies."""
    parts = describe(tester.driver), describe(tester.simulator), asdict(tester.simulator.rules)
    what = json.encode([strategy.options, terms, parts], order="sorted")
    return hashlib.sha256(what).hexdigest()[:SHORT]


def _terms_of(store: CampaignStore) -> _Terms | None:
    """Why a campaign drove roads again; None if it did not.

    Raises:
        CampaignError: it is damaged.
    """
    if FACT not in store.config:
        return None
    try:
        return convert(store.config[FACT], _Terms)
    except ValidationError as error:
        raise CampaignError(f"{store.folder} is damaged: {FACT}: {error}") from None


def read_run(folder: Path | str, source: Path | str) -> Run:
    """The run in a folder, as far as it came.

    Args:
        folder: of the campaign that drove the roads.
        source: of the campaign whose roads they are.

    Raises:
        CampaignError: one of them is damaged, or roads were not driven again there.
    """
    with CampaignStore.open(folder) as store, CampaignStore.open(source) as original:
        terms = _terms_of(store)
        if terms is None:
            raise CampaignError(f"{folder} did not drive the roads of another campaign again")
        recorded: dict[int, tuple[Test, Failure | None]] = {}
        drives = []
        for test in sorted(store.tests(with_trajectory=True), key=lambda test: test.id):
            if test.candidate.source is None:
                raise CampaignError(f"{folder} is damaged: test {test.id} has no source")
            number = test.candidate.source.test
            if number not in recorded:
                own = original.test(number)
                recorded[number] = own, Failure.of_test(own)
            before, failure = recorded[number]
            again = Failure.of_test(test) if failure is not None else None
            difference = None if failure is None or again is None else failure.difference(again)
            drives.append(Redrive(before, test, difference))
        parts: Any = store.config
        return Run(
            terms.purpose,
            parts["driver"],
            parts["simulator"],
            store.setting.rules,
            store.setting.car,
            terms.planned,
            terms.seed,
            terms.variations,
            tuple(drives),
            Path(folder),
        )


def read_runs(folder: Path | str, purpose: Purpose) -> list[Run]:
    """The runs of a campaign for a purpose: interrupted ones first, then by their beginning.

    So whoever lets the last one count lets nothing interrupted replace anything complete.

    Raises:
        CampaignError: one of them is damaged.
    """
    found: list[tuple[bool, str, Run]] = []
    for place in sorted((Path(folder) / FOLDER).glob(f"*/{DATABASE}")):
        with CampaignStore.open(place.parent) as store:
            terms, made_at = _terms_of(store), str(store.fact("created_at"))
        if terms is not None and terms.purpose is purpose:
            run = read_run(place.parent, folder)
            found.append((len(run.drives) == run.planned, made_at, run))
    return [run for *_, run in sorted(found, key=lambda one: one[:2])]


def merged(runs: Iterable[Run]) -> list[Run]:
    """Runs with the same parts and rules as one: of each test, the last judged drives count."""
    found: dict[object, Run] = {}
    for run in runs:
        key = comparison_key(run.driver, run.simulator), run.rules
        drives = dict(by_test(found[key].drives)) if key in found else {}
        for test_id, own in by_test(run.drives).items():
            if test_id not in drives or any(drive.outcome.is_driven for drive in own):
                drives[test_id] = own
        planned = max(run.planned, sum(map(len, drives.values())))
        every = tuple(drive for own in drives.values() for drive in own)
        found[key] = replace(run, planned=planned, drives=every)
    return list(found.values())


def latest(items: Iterable[T], key: Callable[[T], Hashable]) -> tuple[T, ...]:
    """The last item with each key, in the order of the items."""
    last: dict[Hashable, T] = {}
    for item in items:
        last.pop(key(item), None)  # so that it stands where it was last driven
        last[key(item)] = item
    return tuple(last.values())


def by_test(drives: Iterable[Redrive]) -> Mapping[int, tuple[Redrive, ...]]:
    """Test -> its drives, in their order."""
    found: dict[int, list[Redrive]] = {}
    for drive in drives:
        found.setdefault(drive.test_id, []).append(drive)
    return {test_id: tuple(own) for test_id, own in found.items()}
