"""The command `ask-tell`, which proposes roads to a simulator that the user runs."""

from __future__ import annotations

import json
import secrets
import sys
from collections.abc import Iterator
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import click

from frenetic.cli import echo
from frenetic.cli.command_options import CommandOptions
from frenetic.cli.entries import entry_options
from frenetic.cli.options import DEFAULT_SIMULATIONS, SEED_LIMIT, as_usage_error, folder_option
from frenetic.spec import Spec
from frenetic.spec.budget import LIMITS


@click.command(name="ask-tell")
@entry_options(*LIMITS, "strategy")
@click.option(
    "--name",
    default="client",
    show_default=True,
    help="Name of your simulator in the campaign's record.",
)
@entry_options("odd", "map_size", "seed")
@folder_option("Folder for the results; a folder that holds this search is resumed.")
@click.pass_context
def ask_tell(
    context: click.Context,
    /,
    name: str,
    out: Path | None,
    **_: Any,
) -> None:
    """Search for a simulator that you run: JSON lines on stdin and stdout.

    Write {"ask": {}} and read {"candidate": ..}: a road, with conditions if there is a domain.
    Drive it, and write {"tell": {"id": 1, "outcome": "FAIL", "moobd": -0.4}}. The campaign is
    stored and shown like any other. The page on ask-tell has all requests.
    """
    from frenetic.campaign import CampaignStore, new_folder
    from frenetic.campaign.ask_tell import ClientCampaign
    from frenetic.campaign.database import DATABASE

    spec = CommandOptions.of(context).over(Spec())
    if spec.budget is None:
        spec = Spec.of(spec, {"simulations": DEFAULT_SIMULATIONS})
    folder, seed = new_folder() if out is None else out, spec.seed
    if seed is None and (folder / DATABASE).is_file():  # a search that is resumed
        with CampaignStore.open(folder) as store:
            recorded_seed = store.config.get("seed")
            seed = recorded_seed if isinstance(recorded_seed, int) else None
    spec = Spec.of(spec, {"seed": secrets.randbelow(SEED_LIMIT) if seed is None else seed})
    client = sys.stdout

    def answer(message: Any) -> None:
        print(json.dumps(message), file=client, flush=True)

    with redirect_stdout(sys.stderr):  # what a strategy prints must not mix with the answers
        with as_usage_error():
            campaign = ClientCampaign(
                _request_lines(),
                answer,
                name=name,
                strategy=spec.make_strategy(),
                terms=spec.terms,
                budget=spec.budget,
                folder=folder,
                rules=spec.rules,
            )
        summary = campaign.serve()
    echo(f"{summary.as_text()}, results in {folder}", err=True)


def _request_lines() -> Iterator[str]:
    """Yield the lines of stdin; bytes that are no UTF-8 become surrogates."""
    yield from (line.decode("utf-8", "surrogateescape") for line in sys.stdin.buffer)
