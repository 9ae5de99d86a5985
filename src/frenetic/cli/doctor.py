"""The command `doctor`, which checks the simulators on this machine."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from frenetic._support.option_text import read_part
from frenetic.cli import echo
from frenetic.cli.console import Log, announced_compilation
from frenetic.cli.entries import entry_option
from frenetic.cli.options import as_usage_error, json_option

if TYPE_CHECKING:
    from frenetic.simulators.checks import SimulatorCheck
    from frenetic.simulators.doctor import Examination
    from frenetic.spec import Spec


@click.command()
@entry_option(
    "simulator",
    "Check only this simulator, in full. [default: all installed simulators, in short]",
)
@json_option
def doctor(simulator: Spec | None, as_json: bool) -> None:
    """Check the simulators on this machine and say what is wrong and what to do.

    A simulator that needs a licence or an address is checked with --simulator NAME and its options.
    The exit code is 0 if all checks pass, 1 otherwise.
    """
    from frenetic.simulators.doctor import Health, examine, examine_all

    name, options = (None, {}) if simulator is None else read_part(simulator.simulator or "")
    if name is None and options:
        raise click.UsageError("--simulator needs a name before the options: NAME,OPTION=VALUE")
    examinations: list[Examination] = []
    with announced_compilation(Log()) as compiled, as_usage_error():
        if name is not None:

            def show(check: SimulatorCheck) -> None:
                compiled()
                if not as_json:
                    _print(check)

            examinations.append(examine(name, options, on_check=show))
        else:
            for examination in examine_all():
                compiled()
                examinations.append(examination)
                if not as_json:
                    _print_short(examination)
    if as_json:
        echo(
            json.dumps([asdict(result) | {"health": str(result.health)} for result in examinations])
        )
    elif name is not None:
        failed = len(examinations[0].failed)
        echo(f"{name}: {f'{failed} of the checks failed' if failed else 'all is well'}")
    if any(examination.health is Health.BROKEN for examination in examinations):
        raise click.exceptions.Exit(1)


def _print(check: SimulatorCheck, indent: str = "") -> None:
    echo(f"{indent}{'ok   ' if check.is_ok else 'WRONG'} {check.name}: {check.state}")
    if check.remedy:
        echo(f"{indent}      {check.remedy}")


def _print_short(examination: Examination) -> None:
    detail = examination.note or f"{len(examination.checks)} checks"
    echo(f"{examination.simulator}: {examination.health} ({detail})")
    for check in examination.failed:
        _print(check, "  ")
