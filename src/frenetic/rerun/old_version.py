"""Drive the old version of a driver, as its campaign recorded it, on fresh random roads.

It drives them in the campaign's conditions, and then disturbed.

Two versions of one module never run in one process. So if the user has edited the driver since, its
old version is made in a separate process, from the source that the campaign keeps.
"""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import chdir, contextmanager
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, Unpack

from msgspec import structs

from frenetic._support.bounds import require_count
from frenetic._support.json_value import JSONValue
from frenetic._support.option_text import part_word
from frenetic.campaign.counts import Counts
from frenetic.campaign.database import DATABASE
from frenetic.campaign.reader import SOURCES
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.stored_spec import signed_spec
from frenetic.campaign.summary import Event, EventKind, Progress, Summary
from frenetic.campaign.tester import RoadTester
from frenetic.errors import CampaignError
from frenetic.oracle.outcome import Outcome
from frenetic.parts.named_code import NOT_DRIVING, REGISTRIES
from frenetic.parts.paths import absolute_files
from frenetic.parts.registry import DRIVERS
from frenetic.parts.trust import require_trusted
from frenetic.parts.user_modules import user_folders
from frenetic.parts.versions import sources_named
from frenetic.processes.interrupt import catch_interrupt
from frenetic.processes.object_host import report
from frenetic.processes.object_process import LostProcessError, ObjectProcess, pack, ready
from frenetic.rerun.campaigns import (
    DrivingOptions,
    DrivingPlan,
    drive_missing,
    driving_campaign,
    report_complete,
)
from frenetic.rerun.disturbances import UNDISTURBED, QualityPlan, disturbed_conditions
from frenetic.rerun.replay import ReplayRoads
from frenetic.rerun.rerun import drive_roads
from frenetic.search import RandomSearch
from frenetic.spec import Budget, Spec

DEFAULT_FRESH_ROADS: Final = 200
"""Default number of fresh roads; our choice."""
_INTERRUPT_POLL_INTERVAL: Final = 0.2
"""Time between two checks whether Ctrl-C was pressed, in s; our choice."""


@dataclass(frozen=True)
class FreshRoads:
    """Fresh random roads that the old version has driven."""

    campaign: Path
    """Folder of the old version's campaign."""
    folder: Path
    """Folder of the campaign of random search that drove these roads."""
    count: int
    """Number of planned roads."""
    seed: int
    """Seed of the random search."""
    driver: Mapping[str, JSONValue]
    """Old version, as `frenetic.spec.part_record.describe` records it."""
    tests: tuple[int, ...]
    """Ids of the driven tests in `folder`; Ctrl-C leaves fewer than `count`."""
    quality_plan: QualityPlan = UNDISTURBED
    """How both versions are compared where both pass."""
    campaign_tests: tuple[int, ...] = ()
    """Ids of the driven tests of the campaign's own roads."""
    disturbed: tuple[Path, ...] = ()
    """Folder of the old version's drives in each disturbance; Ctrl-C leaves fewer, and in the last
    folder fewer drives."""

    @property
    def quality_roads(self) -> tuple[Path, tuple[int, ...]]:
        """Folder and ids of the driven tests on whose roads quality is compared."""
        if self.quality_plan.on_own_roads:
            return self.campaign, self.campaign_tests
        return self.folder, self.tests

    @property
    def quality_count(self) -> int:
        """Planned number of roads on which quality is compared."""
        return len(self.campaign_tests) if self.quality_plan.on_own_roads else self.count


def fresh_roads(
    campaign: Path | str,
    tester: RoadTester,
    *,
    fresh: int = DEFAULT_FRESH_ROADS,
    quality_plan: QualityPlan = UNDISTURBED,
    strategy_name: str | None = "random",
    **options: Unpack[DrivingOptions],
) -> FreshRoads:
    """Let the old version drive fresh random roads, as far as it has not yet done so.

    The roads are drawn by random search with the least seed that the campaign did not use.

    Args:
        campaign: folder of a campaign of the old version.
        tester: drives with the old version on the campaign's terms.
        fresh: number of roads.
        quality_plan: in which disturbances it drives which roads again.
        strategy_name: name of the strategy in the recorded spec. None records no spec, so that
            nothing is signed.
        options: see `DrivingOptions`.

    Raises:
        CampaignError: the campaign does not exist, or see
            `frenetic.rerun.campaigns.driving_campaign`.
        ValueError: an option is out of range.
    """
    require_count("fresh", fresh)
    with CampaignStore.open(campaign) as store:
        seed = _fresh_seed(store)
    terms, budget = tester.terms, Budget(simulations=fresh)
    strategy = RandomSearch(
        seed=seed, map_size=terms.map_size, road_class=terms.road_class, domain=terms.domain
    )
    if tester.spec is not None:
        tester = replace(tester, spec=structs.replace(tester.spec, seed=seed).with_budget(budget))
    driving_plan = DrivingPlan(
        strategy,
        budget,
        identity=["fresh", seed],
        purpose={"fresh": True},
        strategy_name=strategy_name,
    )
    driving = driving_campaign(campaign, driving_plan, tester, options)
    on_event = options.get("on_event")
    tests = _driven_tests(driving.folder)
    if len(tests) < fresh:
        drive_missing(driving, on_event)
    else:
        outcomes = Counter(test.outcome for test in tests[:fresh])
        report_complete(driving.folder, Counts.of(outcomes), on_event)
    ids = tuple(test.id for test in _driven_tests(driving.folder)[:fresh])
    roads = FreshRoads(
        Path(campaign),
        driving.folder,
        fresh,
        seed,
        tester.described["driver"],
        ids,
        quality_plan,
        campaign_tests(campaign),
    )
    return replace(roads, disturbed=tuple(_drive_disturbed(roads, tester, options)))


def _drive_disturbed(
    roads: FreshRoads, tester: RoadTester, options: DrivingOptions
) -> Iterator[Path]:
    """Let the old version drive fresh roads disturbed; yield the folder for each disturbance.

    After Ctrl-C nothing more is driven.
    """
    folder, ids = roads.quality_roads
    if len(roads.tests) < roads.count or not ids:
        return
    for disturbance in roads.quality_plan.disturbances or ():
        conditions = disturbed_conditions(folder, ids, disturbance)
        strategy = ReplayRoads(folder, ids, conditions)
        disturbed = drive_roads(folder, tester, strategy, (), options)
        yield disturbed
        if len(_driven_tests(disturbed)) < len(ids):
            return


def recorded_driver(store: CampaignStore) -> Mapping[str, JSONValue]:
    """Return the driver of a campaign as the campaign records it."""
    driver = store.config["driver"]
    return driver if isinstance(driver, Mapping) else {}


def _fresh_seed(store: CampaignStore) -> int:
    """Return the least seed that a campaign did not use."""
    used_seed = store.config.get("seed")
    return next(seed for seed in count() if seed != used_seed)


def fresh_roads_as_recorded(
    campaign: Path | str,
    spec: Spec,
    *,
    fresh: int = DEFAULT_FRESH_ROADS,
    quality_plan: QualityPlan = UNDISTURBED,
    is_trusted: bool = False,
    **options: Unpack[DrivingOptions],
) -> FreshRoads:
    """Let a campaign's driver, in its recorded version, drive fresh random roads.

    A user's driver drives in a separate process. If its file was edited since, it is made from the
    source that the campaign keeps.

    Args:
        campaign: folder of the campaign.
        spec: spec of the campaign.
        fresh: number of roads.
        quality_plan: in which disturbances the driver drives which roads again.
        is_trusted: whether the user trusts the campaign and the sources that it keeps.
        options: see `DrivingOptions`.

    Raises:
        CampaignError: the source was edited and the campaign keeps none, or see `fresh_roads`.
        FreneticError: the user has not trusted the code, see `frenetic.parts.trust`.
    """
    with as_recorded(campaign, spec, is_trusted=is_trusted) as old:
        recorded = old.spec
        if not DRIVERS.is_own(recorded.part("driver").name):
            tester = old.tester()
            return fresh_roads(campaign, tester, fresh=fresh, quality_plan=quality_plan, **options)
        return _drive_in_process(old, fresh, quality_plan, options)


def _drive_in_process(
    old: OldVersion, fresh: int, quality_plan: QualityPlan, options: DrivingOptions
) -> FreshRoads:
    """Let an old version drive fresh roads in a separate process, which Ctrl-C ends.

    The process reports events, which are passed on. Their folders are first the folder of the fresh
    roads, then the folder of each disturbance.

    Raises:
        CampaignError: the process was lost, or its call raised an error.
    """
    on_event = options.get("on_event") or (lambda _: None)
    with CampaignStore.open(old.campaign) as store:
        seed, driver = _fresh_seed(store), recorded_driver(store)
    summary, folders = Summary(), dict[Path, None]()
    worker = ObjectProcess("the old version", pack(old), files=())

    def on_interrupt() -> None:
        on_event(Event("interrupted", summary))

    with catch_interrupt(on_interrupt) as interrupt:
        try:
            worker.start()
            workers, isolate = options.get("workers", 1), options.get("isolate", False)
            worker.send(
                *("drive", fresh, quality_plan, workers, isolate),
                limit=math.inf,
                report=tuple[EventKind, Progress],
            )
            while len(worker) and not interrupt.requested:  # its answer is awaited
                for _ in ready([worker], _INTERRUPT_POLL_INTERVAL):
                    for kind, progress in filter(None, worker.receive()):
                        summary = progress.summary()
                        folders[summary.folder] = None
                        on_event(Event(kind, summary))
        except LostProcessError as error:
            raise CampaignError(f"the old version did not drive: {error}") from None
        finally:
            worker.kill()
    folder, *disturbed = folders or [old.campaign]  # nothing was driven: see the ids
    ids = tuple(test.id for test in _driven_tests(folder)[:fresh]) if folders else ()
    return FreshRoads(
        *(old.campaign, folder, fresh, seed, driver, ids),
        quality_plan=quality_plan,
        campaign_tests=campaign_tests(old.campaign),
        disturbed=tuple(disturbed),
    )


@dataclass(frozen=True)
class OldVersion:
    """Recorded version of a campaign's driver: what a separate process needs to let it drive."""

    campaign: Path
    """Folder of the campaign."""
    spec: Spec
    """Spec of the campaign; its parts are loaded from `sources` if that is set."""
    code_folder: Path
    """Folder from which the campaign's code is loaded."""
    sources: Path | None
    """Temporary folder with the recorded sources; None if the code was not edited."""
    others: frozenset[str] = field(default_factory=user_folders)
    """Folders with other versions of the modules, which the process must not search."""

    def start(self) -> None:
        """Prepare the process: put the recorded sources before all other folders of `sys.path`."""
        path = [folder for folder in sys.path if folder not in self.others]
        sys.path[:] = path if self.sources is None else [str(self.sources), *path]

    def tester(self) -> RoadTester:
        """Return a tester with the old version on the campaign's terms."""
        with CampaignStore.open(self.campaign) as store, chdir(self.sources or self.code_folder):
            return RoadTester.of(self.spec, store.setting.terms)

    def drive(self, fresh: int, quality_plan: QualityPlan, workers: int, isolate: bool) -> None:
        """Drive fresh roads and report events.

        Args:
            fresh: number of roads.
            quality_plan: in which disturbances the driver drives which roads again.
            workers: see `DrivingOptions`.
            isolate: see `DrivingOptions`.
        """

        def on_event(event: Event) -> None:
            report((event.kind, Progress.of_summary(event.summary)))

        # A spec is signed as trusted. That must not outlive sources in a temporary folder, so a
        # campaign of such sources records no spec.
        fresh_roads(
            self.campaign,
            self.tester(),
            fresh=fresh,
            quality_plan=quality_plan,
            strategy_name="random" if self.sources is None else None,
            workers=workers,
            isolate=isolate,
            on_event=on_event,
        )

    def close(self) -> None:
        """Do nothing: an old version holds nothing open."""


def campaign_tests(campaign: Path | str) -> tuple[int, ...]:
    """Return the ids of a campaign's tests that were judged, without repeated roads."""
    with CampaignStore.open(campaign) as store:
        tests = [*store.tests(Outcome.PASS), *store.tests(Outcome.FAIL, with_repeats=False)]
    return tuple(sorted(test.id for test in tests))


def _driven_tests(folder: Path) -> list[Test]:
    """Return the driven tests of a campaign by their ids; an empty list without a campaign."""
    if not (folder / DATABASE).exists():
        return []
    with CampaignStore.open(folder) as store:
        driven = [test for test in store.tests() if test.outcome.is_simulated]
        return sorted(driven, key=lambda test: test.id)


@contextmanager
def as_recorded(
    folder: Path | str, spec: Spec, *, is_trusted: bool = False
) -> Iterator[OldVersion]:
    """Yield a campaign's driver in its recorded version.

    If the user has edited the source since, the source that the campaign keeps is written into a
    temporary folder, which is removed when the context ends.

    Args:
        folder: folder of the campaign.
        spec: spec of the campaign.
        is_trusted: whether the user trusts the campaign and the sources that it keeps.

    Raises:
        CampaignError: the source was edited, and the campaign keeps none.
        FreneticError: the user has not trusted the code, see `frenetic.parts.trust`.
    """
    with CampaignStore.open(folder) as store:
        sources: Any = store.fact(SOURCES)
        driving_parts = {kind: part for kind, part in spec.parts.items() if kind not in NOT_DRIVING}
        claim = signed_spec(store).code_claim(sources=sources)
        code_folder = require_trusted(
            folder, claim, needed=driving_parts, is_trusted=is_trusted, optional=()
        )
    sources = sources if isinstance(sources, Mapping) else {}
    driver = spec.part("driver")
    with chdir(code_folder):
        present = sources_named(driver.name)
    is_edited = not sources.items() >= present.items() or bool(sources and not present)
    if not (is_edited and DRIVERS.is_own(driver.name)):
        yield OldVersion(Path(folder), spec, code_folder, None)
        return
    if not sources:
        raise CampaignError(
            f"{folder} keeps no source of its driver {driver.name!r}: bring the old version"
            " back first"
        )
    with TemporaryDirectory() as temporary_name:
        temporary = Path(temporary_name).resolve()
        _write_sources(sources, temporary, folder)
        restored = _with_sources_in(temporary, spec, code_folder)
        yield OldVersion(Path(folder), restored, code_folder, temporary)


def _write_sources(sources: Mapping[str, Any], target: Path, campaign: Path | str) -> None:
    """Write recorded sources into a folder.

    Args:
        sources: file name -> text.
        target: the folder.
        campaign: folder of the campaign that keeps the sources.

    Raises:
        CampaignError: a file name leads out of the folder.
    """
    for name, text in sources.items():
        file = (target / name).resolve()
        if not file.is_relative_to(target):
            raise CampaignError(f"{campaign} is damaged: it keeps the source of {name!r}")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(str(text), encoding="utf-8", newline="\n")


def _with_sources_in(sources: Path, spec: Spec, code_folder: Path) -> Spec:
    """Return a spec that loads a user's driver and simulator from recorded sources.

    Args:
        sources: folder with the recorded sources, under the file names in the campaign.
        spec: spec of the campaign.
        code_folder: folder to which the other paths of the parts are relative.
    """
    words = {}
    for kind in ("driver", "simulator"):
        (name, options), registry = spec.part(kind), REGISTRIES[kind]
        module, _, attribute = name.rpartition(":")
        if not (module and registry.is_own(name)):
            words[kind] = part_word(*registry.absolute(name, options, code_folder))
            continue
        if module.endswith(".py"):
            name = f"{sources / Path(module).name}:{attribute}"
        words[kind] = part_word(name, absolute_files(options, code_folder))
    return structs.replace(spec, **words)
