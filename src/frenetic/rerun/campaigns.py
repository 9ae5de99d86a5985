"""Campaigns beside another one: they drive its roads again, or how often its driver fails.

They lie in the folder ``again`` of that one's. Each has a folder of its own, named after a digest
of what it drives with what. So the same call goes on with an interrupted one, gives a complete one
as it is, and never replaces another.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, TypedDict

from msgspec import json, structs

from frenetic._support.bounds import require_count
from frenetic._support.json_value import JSONValue, plain
from frenetic.campaign import Budget, Campaign, CampaignStore, Event, RoadTester, Summary
from frenetic.campaign.configuration import Owner
from frenetic.campaign.counts import Counts
from frenetic.campaign.objective import MOOBD
from frenetic.campaign.status import stored_budget
from frenetic.campaign.store import DATABASE
from frenetic.errors import CampaignError, CampaignGoneError
from frenetic.parts.versions import SHORT
from frenetic.search import Strategy

FOLDER: Final = "again"
"""Folder, in that of a campaign, of the campaigns beside it."""
TERMS: Final = "again"
"""Entry of such a campaign's configuration: why it drives them."""

_OWNER: Final = Owner(
    summary="does not search",
    advice="the command that began it, 'frenetic rerun', 'minimise', 'compare' or 'estimate', goes"
    " on with it",
)


class How(TypedDict, total=False):
    """Options of all that drives roads again."""

    workers: int
    """Number of roads driven at once, as for `Campaign`; 1 by default."""
    isolate: bool
    """Whether a single worker drives in a process of its own, likewise; not by default."""
    out: Path | str | None
    """Folder of the campaign that drives them; by default one in the campaign's own."""
    on_event: Callable[[Event], object] | None
    """Called with each event of the campaign that drives, see `Campaign.run`."""


def campaign_again(
    folder: Path | str | None,
    strategy: Strategy,
    tester: RoadTester,
    budget: Budget,
    *,
    what: object,
    terms: Mapping[str, JSONValue],
    how: How,
    objective: str = MOOBD,
    named: str | None = None,
    lookahead: int | None = None,
) -> Campaign:
    """The campaign that drives roads of another one again, not yet run.

    Args:
        folder: of the campaign whose roads they are; None if they are no campaign's, then ``out``
            is needed.
        strategy: fresh.
        tester: drives.
        budget: of the driving campaign; a larger one than before lets it go on.
        what: what is driven, as JSON; with the terms and parts it tells the campaign from others.
        terms: why it is driven, for the campaign's configuration.
        how: see `How`.
        objective: what else its strategy is told of a drive.
        named: name of the strategy on a command line, if it has one.
        lookahead: as for `Campaign`.

    Raises:
        CampaignError: ``out`` holds something else, or the folder is gone.
        ValueError: an option is out of range.
    """
    if folder is not None and not Path(folder).is_dir():  # the new one must not make it again
        raise CampaignGoneError(f"{folder} was moved or deleted while its roads were driven again")
    parts, terms_of_drives = tester.described, {**vars(tester.terms), "domain": strategy.domain}
    driven = [parts["driver"], parts["simulator"], tester.simulator.rules, terms_of_drives]
    text = json.encode([what, terms, driven], order="sorted", enc_hook=plain)
    digest = hashlib.sha256(text).hexdigest()[:SHORT]
    place = Path(how.get("out") or Path(folder or "") / FOLDER / digest)
    workers = require_count("workers", how.get("workers", 1))
    if (place / DATABASE).is_file():
        with CampaignStore.open(place) as store:
            if terms_of(store).get("digest") != digest:
                raise CampaignError(f"{place} holds another campaign: choose another place")
    # Of the spec, only what it makes has been trusted (`frenetic.parts.trust`).
    spec = tester.spec and structs.replace(tester.spec, strategy=named, objective=objective)
    with tester.in_folder():
        return Campaign(
            strategy=strategy,
            simulator=tester.simulator,
            driver=tester.driver,
            terms=replace(tester.terms, domain=strategy.domain),
            budget=budget,
            folder=place,
            workers=min(workers, budget.simulations or workers),
            isolate=how.get("isolate", False),
            lookahead=lookahead,
            objective=objective,
            spec=spec,
            description={TERMS: {**terms, "digest": digest}, **_OWNER.entry()},
        )


def complete(campaign: Campaign, how: How) -> None:
    """Makes the drives of a `campaign_again` that are missing.

    Raises:
        CampaignError: nothing can be stored, no worker can be started, or no drive can be judged.
        CampaignGoneError: the folder was moved or deleted meanwhile.
    """
    try:
        _drive_missing(campaign, how.get("on_event"))
    except CampaignGoneError as error:
        if campaign.folder.parent.name != FOLDER:
            raise
        folder = campaign.folder.parents[1]  # of the campaign whose roads they are
        if folder.is_dir():
            raise
        fate = "deleted while its roads were driven again, and the drives with it: restore a copy"
        if error.place is not None:
            fate = (
                f"moved to {error.place.parents[1]} while its roads were driven again: the drives"
                " stand there, and the same command goes on with them there"
            )
        raise CampaignGoneError(f"{folder} was {fate}") from error


def _drive_missing(campaign: Campaign, on_event: Callable[[Event], object] | None) -> None:
    """Runs or resumes a campaign; one that is complete only says so, see `say_complete`."""
    if not (campaign.folder / DATABASE).is_file():
        campaign.run(on_event=on_event)
        return
    with CampaignStore.open(campaign.folder) as store:
        facts, before = store.facts, stored_budget(store).simulations
        counts = store.counts()
    assert campaign.budget is not None
    is_whole = facts.get("ended") or before == campaign.budget.simulations
    if "finished_at" not in facts or facts.get("interrupted") or not is_whole:
        campaign.resume(on_event=on_event)
    else:
        say_complete(campaign.folder, counts, on_event)


def say_complete(folder: Path, counts: Counts, on_event: Callable[[Event], object] | None) -> None:
    """Tell ``on_event`` that a campaign holds these drives, and that none is missing."""
    if on_event is not None:
        on_event(Event("complete", Summary.over(counts, folder=folder, budget_spent=1.0)))


def terms_of(store: CampaignStore) -> Mapping[str, Any]:
    """Why a campaign drives roads again, see `campaign_again`; empty if it does not."""
    terms = store.config.get(TERMS)
    return terms if isinstance(terms, Mapping) else {}


def driven_again(folder: Path | str) -> Iterator[Path]:
    """The folders of the campaigns that drove a campaign's roads again, the oldest first.

    Those that were interrupted come before all others. So whoever lets the last one count lets
    nothing interrupted replace anything complete.

    Raises:
        CampaignError: one of them is damaged.
    """
    found: list[tuple[bool, str, Path]] = []
    for database in sorted((Path(folder) / FOLDER).glob(f"*/{DATABASE}")):
        with CampaignStore.open(database.parent) as store:
            facts = store.facts
            is_whole = "finished_at" in facts and not facts.get("interrupted")
            found.append((is_whole, str(store.fact("created_at")), database.parent))
    return (place for *_, place in sorted(found))
