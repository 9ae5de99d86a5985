"""The command that writes a first driver of one's own: init."""

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

    FILE is the driver's, my_driver.py by default; its test lies beside it. Neither replaces a file.
    The driver works: it passes most roads, and a search finds where it fails.
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
