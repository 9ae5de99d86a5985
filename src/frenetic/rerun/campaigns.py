"""Driving campaigns, which drive a source campaign's roads again or estimate its failure rate.

A driving campaign has a folder in the folder ``rerun`` of the source campaign's folder, named after
a digest of its roads and parts. So the same call continues an interrupted driving campaign, leaves
a complete one as it is, and never replaces another.
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
"""Subfolder of a source campaign's folder that holds the driving campaigns."""
PURPOSE: Final = "rerun"
"""Key in a driving campaign's configuration, which says why it drives."""

_OWNER: Final = Owner(
    summary="does not search",
    advice="the command that began it, 'frenetic rerun', 'minimise', 'compare' or 'estimate', goes"
    " on with it",
)


class RerunOptions(TypedDict, total=False):
    """Options of every function that drives roads again."""

    workers: int
    """Number of roads driven at once, see `Campaign`; 1 by default."""
    isolate: bool
    """Whether a single worker drives in a separate process, see `Campaign`; False by default."""
    out: Path | str | None
    """Folder of the driving campaign; by default a folder in the source campaign's folder."""
    on_event: Callable[[Event], object] | None
    """Called with each event of the driving campaign, see `Campaign.run`."""


@dataclass(frozen=True)
class RerunPlan:
    """Plan of a driving campaign: what it drives, and why."""

    strategy: Strategy
    """Strategy that has proposed nothing yet."""
    budget: Budget
    """Budget of the driving campaign; a larger budget than before lets a complete one continue."""
    identity: object
    """JSON value that, with purpose, parts and terms, tells the campaign from others."""
    purpose: Mapping[str, JSONValue]
    """Entry `PURPOSE` of the campaign's configuration, such as ``{"minimised": True}``."""
    objective: str = MOOBD
    """Name of the objective that the strategy gets a value of with each result."""
    strategy_name: str | None = None
    """Name of the strategy on a command line; None if it has no name."""
    max_in_flight: int | None = None
    """Largest number of candidates without a result at once, see `Campaign`."""


def rerun_campaign(
    folder: Path | str | None, plan: RerunPlan, tester: RoadTester, options: RerunOptions
) -> Campaign:
    """Return the driving campaign of a plan, not yet run.

    Args:
        folder: folder of the source campaign; None without one, then ``out`` is needed.
        plan: what is driven, and why.
        tester: drives the roads.
        options: see `RerunOptions`.

    Raises:
        CampaignError: ``out`` holds another campaign.
        CampaignGoneError: the source campaign's folder is gone.
        ValueError: an option is out of range.
    """
    strategy, budget = plan.strategy, plan.budget
    if folder is not None and not Path(folder).is_dir():  # else `Campaign` would make it anew
        raise CampaignGoneError(f"{folder} was moved or deleted while its roads were driven again")
    digest = _digest(plan, tester)
    driving_folder = Path(options.get("out") or Path(folder or "") / FOLDER / digest)
    workers = require_count("workers", options.get("workers", 1))
    if (driving_folder / DATABASE).is_file():
        with CampaignStore.open(driving_folder) as store:
            if purpose_of(store).get("digest") != digest:
                raise CampaignError(
                    f"{driving_folder} holds another campaign: choose another place"
                )
    # The recorded spec names the strategy and objective that drive here: only the code of a spec's
    # parts is trusted (`frenetic.parts.trust`).
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
            folder=driving_folder,
            workers=min(workers, budget.simulations or workers),
            isolate=options.get("isolate", False),
            max_in_flight=plan.max_in_flight,
            objective=plan.objective,
            spec=spec,
            description={PURPOSE: {**plan.purpose, "digest": digest}, **_OWNER.entry()},
        )


def _digest(plan: RerunPlan, tester: RoadTester) -> str:
    """Return the digest that tells a plan, driven with a tester, from others."""
    parts = tester.described
    terms = {**vars(tester.terms), "domain": plan.strategy.domain}
    driven = [parts["driver"], parts["simulator"], tester.simulator.rules, terms]
    text = json.encode([plan.identity, plan.purpose, driven], order="sorted", enc_hook=plain)
    return hashlib.sha256(text).hexdigest()[:SHORT]


def drive_missing(campaign: Campaign, on_event: Callable[[Event], object] | None = None) -> None:
    """Make the drives that a driving campaign still lacks.

    Args:
        campaign: campaign of `rerun_campaign`.
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
    """Run or resume a campaign; only report it if it is complete."""
    if not (campaign.folder / DATABASE).is_file():
        campaign.run(on_event=on_event)
        return
    with CampaignStore.open(campaign.folder) as store:
        facts, old_simulations = store.facts, stored_budget(store).simulations
        counts = store.counts()
    assert campaign.budget is not None
    is_spent = facts.get("ended") or old_simulations == campaign.budget.simulations
    if "finished_at" not in facts or facts.get("interrupted") or not is_spent:
        campaign.resume(on_event=on_event)
    else:
        report_complete(campaign.folder, counts, on_event)


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
    """Return the folders of a campaign's driving campaigns, interrupted ones first, then by age.

    So a reader that lets the last one win prefers complete campaigns, and of these the latest.

    Raises:
        CampaignError: a driving campaign is damaged.
    """
    rows: list[tuple[bool, str, Path]] = []
    for database in sorted((Path(folder) / FOLDER).glob(f"*/{DATABASE}")):
        with CampaignStore.open(database.parent) as store:
            facts = store.facts
            is_complete = "finished_at" in facts and not facts.get("interrupted")
            rows.append((is_complete, str(store.fact("created_at")), database.parent))
    return (driving_folder for *_, driving_folder in sorted(rows))
