"""The trials of `frenetic rerun --trials`: their progress and their output."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from frenetic._support.words import counted
from frenetic.cli import echo
from frenetic.cli.console import Log
from frenetic.cli.failure_tables import print_causes
from frenetic.cli.rerun_options import interrupted, shown_driving

if TYPE_CHECKING:
    from frenetic.campaign import RoadTester
    from frenetic.rerun.campaigns import DrivingOptions, ReplayOptions


def try_causes(folder: Path, tester: RoadTester, options: ReplayOptions, *, as_json: bool) -> None:
    """Try a failure of each cause of a campaign, or some failures, and print what that shows.

    Args:
        folder: folder of the campaign.
        tester: drives the roads.
        options: tests, by default a failure of each cause; workers; folder of the drives.
        as_json: whether to print JSON.

    Raises:
        click.exceptions.Exit: drives are left after Ctrl-C.
    """
    from frenetic.analysis.clusters import distinct_failures
    from frenetic.analysis.explained import explained_causes
    from frenetic.campaign import CampaignStore
    from frenetic.rerun.cause_trials import examples_of, try_failures
    from frenetic.rerun.minimised_roads import minimised_drives

    with CampaignStore.open(folder) as store:
        clusters, counts = distinct_failures(store), store.counts()
    ids = options["tests"]
    chosen = examples_of(clusters.causes) if ids is None else list(ids)
    driving: DrivingOptions = {
        "workers": options["workers"],
        "isolate": options["isolate"],
        "out": options["out"],
    }
    log = Log()
    with shown_driving(log, "Trying") as on_event:
        driving["on_event"] = on_event
        tried = try_failures(folder, chosen, tester, **driving)
    if as_json:
        trials = {str(number): failure.as_json() for number, failure in tried.items()}
        echo(json.dumps({"campaign": str(folder), "tried": trials}))
    elif not counts.failed:
        echo(f"{folder} holds no failure")
    elif ids is None:
        with CampaignStore.open(folder) as store:
            causes = explained_causes(store, clusters)
            minimised = minimised_drives(store, [cause.group.example for cause in causes])
        print_causes(causes, clusters, counts, minimised)
    else:
        for number, failure in tried.items():
            echo(f"Test {number}: {failure.as_text()}")
    if chosen and not tried:
        raise interrupted(log, f"{counted(len(chosen), 'failure')} to go")
