"""The command that searches for a simulator that somebody else runs: ask-tell."""

from __future__ import annotations

import json
import secrets
import sys
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from frenetic.cli import echo
from frenetic.cli.options import DURATION, as_usage_error, folder_option
from frenetic.cli.parts import map_size_option, odd_option, part_choice
from frenetic.spec import Budget, Part, Spec

if TYPE_CHECKING:
    from frenetic.domain import Domain

DEFAULT_SIMULATIONS = 1000


@click.command(name="ask-tell")
@click.option("--simulations", type=int, metavar="N", help="Stop after N drives. [default: 1000]")
@click.option("--time", "seconds", type=DURATION, help="Stop after this time: 90s, 10m, 1h30m.")
@click.option("--failures", type=int, metavar="N", help="Stop after N failures.")
@part_choice("strategy", "How to search ('frenetic list strategies'). [default: frenetic]")
@click.option("--name", default="told", show_default=True, help="What drives, for the record.")
@odd_option
@map_size_option
@click.option("--seed", type=click.IntRange(0), help="Repeats a search. [default: a new one]")
@folder_option("Folder for the results; one that holds this search is gone on with.")
@click.pass_context
def ask_tell(
    context: click.Context,
    /,
    simulations: int | None,
    seconds: float | None,
    failures: int | None,
    name: str,
    domain: Domain | None,
    seed: int | None,
    out: Path | None,
    **_: Any,
) -> None:
    """Search for a simulator that you run: JSON lines on stdin and stdout.

    Write {"ask": {}} and read {"candidate": ..}, a road and, of a domain, conditions; drive it, and
    write {"tell": {"id": 1, "outcome": "FAIL", "moobd": -0.4}}. The campaign is stored and shown
    like any other. The page on ask-tell has all requests.
    """
    from frenetic.campaign import CampaignStore, new_folder
    from frenetic.campaign.asktell import ToldCampaign
    from frenetic.campaign.store import DATABASE

    if simulations is None and seconds is None and failures is None:
        simulations = DEFAULT_SIMULATIONS
    folder = new_folder() if out is None else out
    if seed is None and (folder / DATABASE).is_file():
        with CampaignStore.open(folder) as store:
            recorded = store.config.get("seed")
            seed = recorded if isinstance(recorded, int) else None
    seed = secrets.randbelow(2**31) if seed is None else seed
    answers = sys.stdout

    def answer(message: Any) -> None:
        print(json.dumps(message), file=answers, flush=True)

    with redirect_stdout(sys.stderr):  # a strategy's prints, say
        with as_usage_error():
            budget = Budget(simulations=simulations, time=seconds, failures=failures)
            given = {**context.params, "road_class": None if domain is None else domain.road_class}
            spec = Spec(strategy=Part("frenetic"), seed=seed).replaced(given)
            campaign = ToldCampaign(
                _lines(),
                answer,
                name=name,
                strategy=spec.make_strategy(),
                budget=budget,
                folder=folder,
                map_size=spec.map_size,
                rules=spec.rules,
            )
        summary = campaign.serve()
    echo(f"{summary.in_words()}, results in {folder}", err=True)


def _lines() -> Iterator[str]:
    """The lines of the input, whatever its encoding is: those that are no UTF-8 are no requests."""
    yield from (line.decode("utf-8", "surrogateescape") for line in sys.stdin.buffer)
