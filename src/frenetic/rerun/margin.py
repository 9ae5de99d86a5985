"""Margins: how far a driver is from failing, where it does not fail.

The margin of a quantity, such as the delay of the controls, is the amount at which a driver begins
to fail on 5 % of the roads. It is measured on random roads of a road class or domain: on each road
by a scan and a bisection, see `frenetic.rerun.margin_search`. The drives are a campaign::

    tester = RoadTester(EmbeddedSimulator(), MyDriver(), Terms.of_class(RoadClass.of("rural-80")))
    margins = measure_margins(tester, workers=4, out="margins")
    print(margins.as_text())
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final, Unpack

from frenetic._support.bounds import Index, check, require_count
from frenetic._support.files import require_list
from frenetic.campaign import MAX_IN_FLIGHT, Campaign, CampaignStore, Event, new_folder
from frenetic.campaign.replay import replay
from frenetic.campaign.tester import RoadTester
from frenetic.criteria.criterion import COMPETITION
from frenetic.errors import FreneticError
from frenetic.oracle.outcome import Outcome
from frenetic.rerun.campaigns import DrivingOptions, DrivingPlan, drive_missing, driving_campaign
from frenetic.rerun.margin_files import write_margins
from frenetic.rerun.margin_quantities import RADIUS, MarginQuantity, measured_quantities
from frenetic.rerun.margin_results import Margins, margins_of
from frenetic.rerun.margin_search import (
    MOST_DRIVES,
    MarginRoad,
    MarginSearch,
    draw_roads,
    in_any_size,
    with_class_profiles,
)
from frenetic.spec import Budget
from frenetic.spec.part_record import describe

ROADS: Final = 80
"""Default number of random roads; 72 are the fewest whose interval has two ends in the range."""
DEMANDING: Final = 10
"""Largest number of most demanding roads of a campaign; our choice."""
_EXTRA_DRIVES: Final = 1000
"""Drives in which the simulator broke that the budget allows beside all others; our choice."""


def measure_margins(
    tester: RoadTester,
    quantities: Sequence[MarginQuantity] | None = None,
    *,
    roads: int = ROADS,
    seed: Index = 0,
    campaign: Path | str | None = None,
    **options: Unpack[DrivingOptions],
) -> Margins:
    """Measure at which amounts of conditions a driver begins to fail.

    The drives are a campaign, whose folder keeps the margins, too, for reports. The same call
    continues an interrupted one and reads a complete one, if it has the same ``campaign`` or
    ``out``; without both, each call makes a new folder.

    Args:
        tester: drives on its terms; its simulator is not yet entered.
        quantities: what is measured, see `measured_quantities`, which has the default.
        roads: number of random roads.
        seed: seed of the random roads.
        campaign: folder of a campaign with this driver and these terms, which keeps the drives. Its
            passed roads of lowest MOOBD are the demanding roads.
        options: see `DrivingOptions`.

    Raises:
        KeyboardInterrupt: Ctrl-C came before the last drive.
        FreneticError: the simulator broke, simulator or driver cannot have a condition, or the
            margins cannot be written.
        CampaignError: see `frenetic.rerun.campaigns.driving_campaign`.
        ValueError: a number is out of range, no random road is valid, or nothing is measured.
    """
    roads = require_count("roads", roads)
    check({"seed": seed}, measure_margins)
    measured = measured_quantities(tester) if quantities is None else quantities
    quantities = require_list("quantities", measured, "quantities")
    if not quantities:
        raise ValueError("nothing is measured: name a condition")
    if campaign is None:
        options["out"] = options.get("out") or new_folder()
    random_roads = draw_roads(tester, roads, int(seed))
    demanding_roads, created_at = _demanding_roads(campaign, random_roads)
    domain_text, road_class = _domain_text(tester), tester.terms.road_class
    if road_class is not None and RADIUS.name in {each.condition for each in quantities}:
        random_roads = with_class_profiles(random_roads, road_class)
        demanding_roads = with_class_profiles(demanding_roads, road_class)
        tester = in_any_size(tester, road_class)
    search = MarginSearch(
        quantities,
        random_roads,
        demanding_roads,
        {
            "quantities": [f"{q.condition} {q.usual} to {q.end}" for q in quantities],
            "roads": roads,
            "seed": int(seed),
            "campaign": created_at,  # identifies the campaign, whose path may change
            "demanding": [road.test for road in demanding_roads],
        },
    )
    most = MOST_DRIVES * len(quantities) * (roads + len(demanding_roads)) + _EXTRA_DRIVES
    plan = DrivingPlan(
        search,
        Budget(simulations=most),
        identity=[describe(search), tester.terms],
        purpose={"margin": True},
        max_in_flight=MAX_IN_FLIGHT,  # a constant: the drives must not depend on the workers
    )
    driving = driving_campaign(campaign, plan, tester, options)
    _drive(driving, options)
    margins = _result(driving, search, plan, tester, domain_text)
    write_margins(margins)
    return margins


def _drive(driving: Campaign, options: DrivingOptions) -> None:
    """Make the missing drives of a campaign; stop at the first drive in which the simulator breaks.

    Raises:
        FreneticError: the simulator broke.
    """
    on_event = options.get("on_event")

    def stop_at_error(event: Event) -> None:
        if event.test is not None and event.test.outcome is Outcome.ERROR:
            raise FreneticError(
                f"the simulator broke, which says nothing of the driver: {event.test.reason}; the"
                f" drives so far are kept in {driving.folder}"
            )
        if on_event is not None:
            on_event(event)

    drive_missing(driving, stop_at_error)


def _demanding_roads(
    folder: Path | str | None, random_roads: Iterable[MarginRoad]
) -> tuple[list[MarginRoad], str]:
    """Return the roads of a campaign's passed tests of lowest MOOBD, and when the campaign began.

    The lowest MOOBD comes first. Each road has place and seed of a random road, in their order.
    Without a campaign there are no such roads.
    """
    if folder is None:
        return [], ""
    with CampaignStore.open(folder) as store:
        passed = store.tests(Outcome.PASS, order_by="moobd", limit=DEMANDING, with_repeats=False)
        roads = [
            road.at_test(test.candidate, str(folder))
            for test, road in zip(passed, random_roads, strict=False)
        ]
        return roads, str(store.fact("created_at"))


def _domain_text(tester: RoadTester) -> str:
    """Return the roads and conditions of a tester in words."""
    terms = tester.terms
    if terms.domain is not None:
        return terms.domain.name
    return COMPETITION if terms.road_class is None else terms.road_class.as_text()


def _result(
    driving: Campaign,
    search: MarginSearch,
    plan: DrivingPlan,
    tester: RoadTester,
    domain_text: str,
) -> Margins:
    """Return the margins from the drives of a campaign.

    Args:
        driving: campaign with the drives.
        search: strategy of the campaign, which proposed the drives unless they were there before.
        plan: plan of the campaign.
        tester: tester that drove.
        domain_text: roads and conditions in words.

    Raises:
        KeyboardInterrupt: drives are missing.
    """
    with CampaignStore.open(driving.folder) as store:
        if not search.is_begun:  # the campaign was complete
            replay(store, search, plan.budget, driving.objective)
        drives = store.counts().simulations
    if not search.is_complete:
        raise KeyboardInterrupt
    described = tester.described
    return Margins(
        margins_of(search),
        domain_text,
        described["driver"],
        described["simulator"],
        search.options["seed"],
        drives,
        driving.folder,
    )
