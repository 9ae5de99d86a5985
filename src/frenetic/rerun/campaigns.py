"""Driving campaigns, which drive a source campaign's roads again, or measure its driver.

A driving campaign has a folder in the folder ``rerun`` of the source campaign's folder, named after
a digest of its roads and parts. So the same call continues an interrupted driving campaign, leaves
a complete driving campaign as it is, and never replaces another one.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, TypedDict

from msgspec import json, structs

from frenetic._support.bounds import require_count
from frenetic._support.json_value import JSONValue, plain
from frenetic.campaign import (
    MAX_IN_FLIGHT,
    Budget,
    Campaign,
    CampaignStore,
    Event,
    RoadTester,
    Summary,
)
from frenetic.campaign.configuration import Owner
from frenetic.campaign.counts import Counts
from frenetic.campaign.database import DATABASE
from frenetic.campaign.objective import MOOBD
from frenetic.campaign.stored_spec import stored_budget
from frenetic.errors import CampaignError, CampaignGoneError
from frenetic.parts.versions import SHORT
from frenetic.search import Strategy

FOLDER: Final = "rerun"
"""Subfolder of a source campaign's folder that holds the driving campaigns."""
PURPOSE: Final = "rerun"
"""Key of the entry in a driving campaign's configuration that says why it drives."""

_OWNER: Final = Owner(
    summary="does not search",
    advice="the command that began it, 'frenetic rerun', 'minimise', 'compare', 'estimate' or"
    " 'margin', goes on with it",
)


class DrivingOptions(TypedDict, total=False):
    """Options of every function that runs a driving campaign."""

    workers: int
    """Number of roads driven at once, see `Campaign`; 1 by default."""
    isolate: bool
    """Whether a single worker drives in a separate process, see `Campaign`; False by default."""
    out: Path | str | None
    """Folder of the driving campaign; by default a folder in the source campaign's folder."""
    on_event: Callable[[Event], object] | None
    """Called with each event of the driving campaign, see `Campaign.run`."""


class ReplayOptions(DrivingOptions, total=False):
    """Options of every function that drives tests of a campaign again."""

    tests: Iterable[int] | None
    """Ids of the tests; None for all failures."""
    instead: Iterable[str]
    """Conditions whose recorded amounts are ignored, because the simulator or the driver has other
    amounts of these conditions."""


@dataclass(frozen=True)
class DrivingPlan:
    """Plan of a driving campaign: what it drives, and why."""

    strategy: Strategy
    """Strategy that proposes the roads, and has proposed nothing yet."""
    budget: Budget
    """Budget of the driving campaign; a larger budget than before lets a complete one continue."""
    identity: object
    """JSON value that, with purpose, parts and terms, distinguishes the campaign from others."""
    purpose: Mapping[str, JSONValue]
    """Entry `PURPOSE` of the campaign's configuration, such as ``{"minimised": True}``."""
    objective: str = MOOBD
    """Name of the objective, whose value the strategy gets with each result."""
    strategy_name: str | None = None
    """Name of the strategy on a command line; None if it has no name."""
    max_in_flight: int | None = None
    """Largest number of candidates without a result at once, see `Campaign`; None for as many as
    are driven at once."""


def driving_campaign(
    folder: Path | str | None, plan: DrivingPlan, tester: RoadTester, options: DrivingOptions
) -> Campaign:
    """Return the driving campaign of a plan, not yet run.

    Args:
        folder: folder of the source campaign; None without a source campaign, then the options
            need ``out``.
        plan: what is driven, and why.
        tester: drives the roads.
        options: see `DrivingOptions`.

    Raises:
        CampaignError: ``out`` holds another campaign.
        CampaignGoneError: the source campaign's folder is gone.
        ValueError: an option is out of range, or there is neither a source campaign nor ``out``.
    """
    strategy, budget, out = plan.strategy, plan.budget, options.get("out")
    _require_place(folder, out)
    digest = _digest(plan, tester)
    driving_folder = Path(out or Path(folder or "") / FOLDER / digest)
    workers = require_count("workers", options.get("workers", 1))
    if (driving_folder / DATABASE).is_file():
        with CampaignStore.open(driving_folder) as store:
            if purpose_of(store).get("digest") != digest:
                raise CampaignError(
                    f"{driving_folder} holds another campaign: choose another place"
                )
    # Record the strategy and objective of this campaign instead of the tester's, so that trusting
    # the spec (`frenetic.parts.trust`) covers exactly the code that runs.
    spec = tester.spec and structs.replace(
        tester.spec, strategy=plan.strategy_name, objective=plan.objective
    )
    with tester.in_folder():  # the names of parts are looked up in the current folder
        return Campaign(
            strategy=strategy,
            simulator=tester.simulator,
            driver=tester.driver,
            terms=replace(tester.terms, domain=strategy.domain),
            budget=budget,
            folder=driving_folder,
            workers=min(workers, budget.simulations or workers),
            isolate=options.get("isolate", False),
            max_in_flight=plan.max_in_flight or _usual_in_flight(tester),
            objective=plan.objective,
            spec=spec,
            description={PURPOSE: {**plan.purpose, "digest": digest}, **_OWNER.entry()},
        )


def _usual_in_flight(tester: RoadTester) -> int | None:
    """Return how many candidates may be without a result; None for the default of `Campaign`."""
    return MAX_IN_FLIGHT if tester.drives_side_by_side else None


def _require_place(folder: Path | str | None, out: Path | str | None) -> None:
    """Check that a driving campaign has a place for its folder.

    Args:
        folder: folder of the source campaign; None without a source campaign.
        out: folder of the driving campaign; None for a folder in the source campaign's folder.

    Raises:
        CampaignGoneError: the source campaign's folder is gone.
        ValueError: there is neither a source campaign nor ``out``.
    """
    if folder is not None and not Path(folder).is_dir():  # `Campaign` would make the folder anew
        raise CampaignGoneError(f"{folder} was moved or deleted while its roads were driven again")
    if folder is None and not out:
        raise ValueError("the drives have no folder: give a source campaign, or out")


def _digest(plan: DrivingPlan, tester: RoadTester) -> str:
    """Return the digest that distinguishes a plan, driven with a tester, from others."""
    parts = tester.described
    terms = {**vars(tester.terms), "domain": plan.strategy.domain}
    setup = [parts["driver"], parts["simulator"], tester.simulator.rules, terms]
    text = json.encode([plan.identity, plan.purpose, setup], order="sorted", enc_hook=plain)
    return hashlib.sha256(text).hexdigest()[:SHORT]


def drive_missing(campaign: Campaign, on_event: Callable[[Event], object] | None = None) -> None:
    """Make the drives that a driving campaign still lacks.

    Args:
        campaign: campaign of `driving_campaign`.
        on_event: called with each event.

    Raises:
        CampaignError: nothing can be stored, no worker can be started, or no drive can be judged.
        CampaignGoneError: the folder was moved or deleted meanwhile.
    """
    try:
        _run_or_resume(campaign, on_event)
    except CampaignGoneError as error:
        if campaign.folder.parent.name != FOLDER:
            raise
        folder = campaign.folder.parents[1]  # of the source campaign
        if folder.is_dir():
            raise  # only the driving campaign is gone
        fate = "deleted while its roads were driven again, and the drives with it: restore a copy"
        if error.place is not None:
            fate = (
                f"moved to {error.place.parents[1]} while its roads were driven again: the drives"
                " are kept there, and the same command continues them there"
            )
        raise CampaignGoneError(f"{folder} was {fate}") from error


def _run_or_resume(campaign: Campaign, on_event: Callable[[Event], object] | None) -> None:
    """Run or resume a campaign; if it is complete, only report that."""
    if not (campaign.folder / DATABASE).is_file():
        campaign.run(on_event=on_event)
        return
    with CampaignStore.open(campaign.folder) as store:
        facts, old_simulations = store.facts, stored_budget(store).simulations
        counts = store.counts()
    assert campaign.budget is not None
    # A finished campaign has drives to make if its budget has grown, unless its strategy had
    # nothing left to propose ("ended").
    has_old_budget = old_simulations == campaign.budget.simulations
    is_complete = _has_finished(facts) and (facts.get("ended") or has_old_budget)
    if is_complete:
        report_complete(campaign.folder, counts, on_event)
    else:
        campaign.resume(on_event=on_event)


def _has_finished(facts: Mapping[str, Any]) -> bool:
    """Return whether a campaign came to its end without an interruption, by its stored facts."""
    return "finished_at" in facts and not facts.get("interrupted")


def report_complete(
    folder: Path, counts: Counts, on_event: Callable[[Event], object] | None
) -> None:
    """Report to ``on_event`` that a campaign has all its drives, with their counts."""
    if on_event is not None:
        on_event(Event("complete", Summary.from_counts(counts, folder=folder, budget_spent=1.0)))


def purpose_of(store: CampaignStore) -> Mapping[str, Any]:
    """Return the purpose of a driving campaign; an empty mapping for other campaigns."""
    purpose = store.config.get(PURPOSE)
    return purpose if isinstance(purpose, Mapping) else {}


def rerun_folders(folder: Path | str) -> Iterator[Path]:
    """Return the folders of a campaign's driving campaigns, interrupted campaigns first.

    Each kind, interrupted and finished, comes oldest first. So a reader in which later campaigns
    replace earlier ones prefers finished campaigns, and of these the latest.

    Raises:
        CampaignError: a driving campaign is damaged.
    """
    rows: list[tuple[bool, str, Path]] = []
    for database in sorted((Path(folder) / FOLDER).glob(f"*/{DATABASE}")):
        with CampaignStore.open(database.parent) as store:
            has_finished = _has_finished(store.facts)
            rows.append((has_finished, str(store.fact("created_at")), database.parent))
    return (driving_folder for *_, driving_folder in sorted(rows))
