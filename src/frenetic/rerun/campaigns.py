"""Campaigns beside another one, which drive its roads again or estimate how often its driver fails.

They lie in the folder ``rerun`` of the other campaign's folder. Each has a folder named after a
digest of its roads and parts. So the same call continues an interrupted campaign, returns a
complete one as it is, and never replaces another.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, TypedDict

from msgspec import json, structs

from frenetic._support.bounds import require_count
from frenetic._support.json_value import JSONValue, plain
from frenetic.campaign import Budget, Campaign, CampaignStore, Event, RoadTester, Summary
from frenetic.campaign.configuration import Owner
from frenetic.campaign.counts import Counts
from frenetic.campaign.database import DATABASE
from frenetic.campaign.objective import MOOBD
from frenetic.campaign.stored_spec import stored_budget
from frenetic.errors import CampaignError, CampaignGoneError
from frenetic.parts.versions import SHORT
from frenetic.search import Strategy

FOLDER: Final = "rerun"
"""Subfolder of a campaign's folder that holds the campaigns beside it."""
PURPOSE: Final = "rerun"
"""Configuration key of a campaign beside another one: why it drives."""

_OWNER: Final = Owner(
    summary="does not search",
    advice="the command that began it, 'frenetic rerun', 'minimise', 'compare' or 'estimate', goes"
    " on with it",
)


class RerunOptions(TypedDict, total=False):
    """Options of every function that drives roads again."""

    workers: int
    """Number of roads driven at once, as for `Campaign`; 1 by default."""
    isolate: bool
    """Whether a single worker drives in its own process, as for `Campaign`; False by default."""
    out: Path | str | None
    """Folder of the campaign that drives; by default a new one in the other campaign's folder."""
    on_event: Callable[[Event], object] | None
    """Called with each event of the campaign that drives, see `Campaign.run`."""


@dataclass(frozen=True)
class RerunPlan:
    """What a campaign beside another one drives, and why."""

    strategy: Strategy
    """Strategy that has proposed nothing yet."""
    budget: Budget
    """Budget of the driving campaign; a larger one than before lets it go on."""
    identity: object
    """JSON that tells the campaign from others, together with the purpose and the parts."""
    purpose: Mapping[str, JSONValue]
    """Entry `PURPOSE` of the campaign's configuration, such as ``{"minimised": True}``."""
    objective: str = MOOBD
    """Objective whose values the strategy gets beside the result of each drive."""
    strategy_name: str | None = None
    """Name of the strategy on a command line; None if it has no name."""
    max_in_flight: int | None = None
    """Candidates in flight at once, as for `Campaign`."""


def rerun_campaign(
    folder: Path | str | None, plan: RerunPlan, tester: RoadTester, options: RerunOptions
) -> Campaign:
    """Return the campaign that drives a plan beside another campaign, not yet run.

    Args:
        folder: folder of the other campaign; None without one, then ``out`` is needed.
        plan: what is driven.
        tester: drives the roads.
        options: see `RerunOptions`.

    Raises:
        CampaignError: ``out`` holds another campaign, or the folder is gone.
        ValueError: an option is out of range.
    """
    strategy, budget = plan.strategy, plan.budget
    if folder is not None and not Path(folder).is_dir():  # the new campaign must not recreate it
        raise CampaignGoneError(f"{folder} was moved or deleted while its roads were driven again")
    parts, terms_of_drives = tester.described, {**vars(tester.terms), "domain": strategy.domain}
    driven = [parts["driver"], parts["simulator"], tester.simulator.rules, terms_of_drives]
    identity = [plan.identity, plan.purpose, driven]
    text = json.encode(identity, order="sorted", enc_hook=plain)
    digest = hashlib.sha256(text).hexdigest()[:SHORT]
    place = Path(options.get("out") or Path(folder or "") / FOLDER / digest)
    workers = require_count("workers", options.get("workers", 1))
    if (place / DATABASE).is_file():
        with CampaignStore.open(place) as store:
            if purpose_of(store).get("digest") != digest:
                raise CampaignError(f"{place} holds another campaign: choose another place")
    # Only the parts that the spec makes are trusted (`frenetic.parts.trust`).
    spec = tester.spec and structs.replace(
        tester.spec, strategy=plan.strategy_name, objective=plan.objective
    )
    with tester.in_folder():
        return Campaign(
            strategy=strategy,
            simulator=tester.simulator,
            driver=tester.driver,
            terms=replace(tester.terms, domain=strategy.domain),
            budget=budget,
            folder=place,
            workers=min(workers, budget.simulations or workers),
            isolate=options.get("isolate", False),
            max_in_flight=plan.max_in_flight,
            objective=plan.objective,
            spec=spec,
            description={PURPOSE: {**plan.purpose, "digest": digest}, **_OWNER.entry()},
        )


def drive_missing(campaign: Campaign, on_event: Callable[[Event], object] | None = None) -> None:
    """Make the missing drives of a `rerun_campaign`.

    Raises:
        CampaignError: nothing can be stored, no worker can be started, or no drive can be judged.
        CampaignGoneError: the folder was moved or deleted meanwhile.
    """
    try:
        _run_or_resume(campaign, on_event)
    except CampaignGoneError as error:
        if campaign.folder.parent.name != FOLDER:
            raise
        folder = campaign.folder.parents[1]  # of the other campaign
        if folder.is_dir():
            raise
        fate = "deleted while its roads were driven again, and the drives with it: restore a copy"
        if error.place is not None:
            fate = (
                f"moved to {error.place.parents[1]} while its roads were driven again: the drives"
                " stand there, and the same command goes on with them there"
            )
        raise CampaignGoneError(f"{folder} was {fate}") from error


def _run_or_resume(campaign: Campaign, on_event: Callable[[Event], object] | None) -> None:
    """Run or resume a campaign; report a complete one as such."""
    if not (campaign.folder / DATABASE).is_file():
        campaign.run(on_event=on_event)
        return
    with CampaignStore.open(campaign.folder) as store:
        facts, before = store.facts, stored_budget(store).simulations
        counts = store.counts()
    assert campaign.budget is not None
    is_spent = facts.get("ended") or before == campaign.budget.simulations
    if "finished_at" not in facts or facts.get("interrupted") or not is_spent:
        campaign.resume(on_event=on_event)
    else:
        report_complete(campaign.folder, counts, on_event)


def report_complete(
    folder: Path, counts: Counts, on_event: Callable[[Event], object] | None
) -> None:
    """Report to ``on_event`` that a campaign holds all of its drives, with their counts."""
    if on_event is not None:
        on_event(Event("complete", Summary.from_counts(counts, folder=folder, budget_spent=1.0)))


def purpose_of(store: CampaignStore) -> Mapping[str, Any]:
    """Return why a campaign drives beside another one; an empty mapping for other campaigns."""
    purpose = store.config.get(PURPOSE)
    return purpose if isinstance(purpose, Mapping) else {}


def rerun_folders(folder: Path | str) -> Iterator[Path]:
    """Return the folders of the campaigns beside a campaign, the oldest first.

    Interrupted campaigns come before complete ones, so a later complete one wins.

    Raises:
        CampaignError: one of these campaigns is damaged.
    """
    rows: list[tuple[bool, str, Path]] = []
    for database in sorted((Path(folder) / FOLDER).glob(f"*/{DATABASE}")):
        with CampaignStore.open(database.parent) as store:
            facts = store.facts
            is_complete = "finished_at" in facts and not facts.get("interrupted")
            rows.append((is_complete, str(store.fact("created_at")), database.parent))
    return (place for *_, place in sorted(rows))
