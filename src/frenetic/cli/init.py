"""The command `init`, which writes a first driver for the user to edit."""

from __future__ import annotations

import json
from pathlib import Path

import click

from frenetic.cli import echo
from frenetic.cli.console import print_facts, shell
from frenetic.cli.options import json_option


@click.command()
@click.argument("file", default="my_driver.py", type=click.Path(path_type=Path))
@json_option
def init(file: Path, as_json: bool) -> None:
    """Write a driver file with a test, ready to edit.

    FILE is for the driver, my_driver.py by default; its test is written beside it. Existing files
    are not replaced. The driver works: it passes most roads, and a search finds where it fails.
    """
    from frenetic.testing.first_driver import write_driver

    driver, test, name = write_driver(file)
    if as_json:
        echo(json.dumps({"driver": str(driver), "test": str(test), "class": name}))
        return
    print_facts(
        [
            ("Driver", f"{driver}, class {name}"),
            ("Test it", f"pytest {shell(test)}"),
            ("Search", f"frenetic run --driver {shell(f'{driver}:{name}')}"),
        ]
    )
