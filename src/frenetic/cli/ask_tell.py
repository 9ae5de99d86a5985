"""The command that searches for a simulator that somebody else runs: ask-tell."""

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
from frenetic.cli.options import as_usage_error, folder_option
from frenetic.spec import Spec

DEFAULT_SIMULATIONS = 1000


@click.command(name="ask-tell")
@entry_options("simulations", "time", "failures", "strategy")
@click.option(
    "--name", default="client", show_default=True, help="Name of what drives, for the record."
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

    Write {"ask": {}} and read {"candidate": ..}, a road and, of a domain, conditions; drive it, and
    write {"tell": {"id": 1, "outcome": "FAIL", "moobd": -0.4}}. The campaign is stored and shown
    like any other. The page on ask-tell has all requests.
    """
    from frenetic.campaign import CampaignStore, new_folder
    from frenetic.campaign.ask_tell import ClientCampaign
    from frenetic.campaign.database import DATABASE

    spec = CommandOptions.of(context).over(Spec())
    if spec.budget is None:
        spec = Spec.of(spec, {"simulations": DEFAULT_SIMULATIONS})
    folder, seed = new_folder() if out is None else out, spec.seed
    if seed is None and (folder / DATABASE).is_file():
        with CampaignStore.open(folder) as store:
            recorded = store.config.get("seed")
            seed = recorded if isinstance(recorded, int) else None
    spec = Spec.of(spec, {"seed": secrets.randbelow(2**31) if seed is None else seed})
    answers = sys.stdout

    def answer(message: Any) -> None:
        print(json.dumps(message), file=answers, flush=True)

    with redirect_stdout(sys.stderr):  # a strategy's prints, say
        with as_usage_error():
            campaign = ClientCampaign(
                _lines(),
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


def _lines() -> Iterator[str]:
    """Return the lines of stdin; bytes that are no UTF-8 become surrogates."""
    yield from (line.decode("utf-8", "surrogateescape") for line in sys.stdin.buffer)
