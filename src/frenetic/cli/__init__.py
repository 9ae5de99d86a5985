"""The command line: parses, calls the library, prints.

A command imports what it needs when it runs, so that ``frenetic --help`` is there at once.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Sequence
from typing import NoReturn

import click

from frenetic._support.interrupt import ending_in_order
from frenetic.cli.bench import bench
from frenetic.cli.check import check
from frenetic.cli.compare import compare
from frenetic.cli.confirm import confirm
from frenetic.cli.console import fail, silence
from frenetic.cli.doctor import doctor
from frenetic.cli.export import export
from frenetic.cli.export_road import export_road
from frenetic.cli.listings import drivers, simulators, strategies
from frenetic.cli.minimise import minimise
from frenetic.cli.regression import replay
from frenetic.cli.report import report
from frenetic.cli.roads import drive, validate
from frenetic.cli.robustness import rerun
from frenetic.cli.run import resume, run
from frenetic.cli.show import show
from frenetic.cli.watch import watch
from frenetic.errors import FreneticError

__all__ = ["cli", "main"]

logger = logging.getLogger(__name__)

CONTEXT = {"help_option_names": ["-h", "--help"], "max_content_width": 100}


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Runs the command line; a user's mistake is one line on stderr and exit code 2."""
    try:
        with ending_in_order():
            code = cli.main(args=arguments, prog_name="frenetic", standalone_mode=False)
    except click.exceptions.Exit as stop:
        code = stop.exit_code
    except click.ClickException as error:
        fail(error.format_message())
    except FreneticError as error:
        logger.debug("the error in full", exc_info=True)
        fail(str(error))
    except (KeyboardInterrupt, click.Abort):
        click.echo("frenetic: interrupted", err=True)
        code = 130
    except BrokenPipeError:
        # The reader of our output has gone; end quietly.
        silence(sys.stdout)
        code = 1
    sys.exit(code if isinstance(code, int) else 0)


@click.group(context_settings=CONTEXT, invoke_without_command=True)
@click.version_option(None, "--version", package_name="frenetic-roads", prog_name="frenetic")
@click.option("--debug", is_flag=True, help="Log what happens, with tracebacks, to stderr.")
@click.pass_context
def cli(context: click.Context, debug: bool) -> None:
    """Finds the roads on which an automated driver leaves its lane."""
    if context.invoked_subcommand is None:
        click.echo(context.get_help())
    if debug:
        logging.basicConfig(
            level=logging.INFO, format="%(asctime)s %(name)s %(levelname)s %(message)s"
        )
        logging.getLogger("frenetic").setLevel(logging.DEBUG)


for command in (run, resume, drive, validate, show, drivers, strategies, simulators):
    cli.add_command(command)
cli.add_command(watch)
cli.add_command(doctor)
cli.add_command(confirm)
cli.add_command(export_road)
cli.add_command(minimise)
cli.add_command(rerun)
cli.add_command(replay)
cli.add_command(compare)
cli.add_command(bench)
cli.add_command(check)
cli.add_command(export)
cli.add_command(report)
