"""The command line: it parses, calls the library, and prints.

A command is imported when it runs, so ``frenetic --help`` starts at once.
"""

from __future__ import annotations

import gc
import os
import re
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar, Final, NoReturn, TextIO

import click

from frenetic._support.entry_points import installed
from frenetic._support.printable import printable, shortened
from frenetic.errors import FreneticError
from frenetic.processes.interrupt import plain_interrupts, signals_act_like_ctrl_c

__all__ = ["cli", "main"]

INTERRUPTED: Final = 130
"""Exit code after Ctrl-C, by the convention of shells: 128 and the number of the signal."""
BLAS_THREADS: Final = "OPENBLAS_NUM_THREADS"
"""Environment variable with the number of threads of numpy's matrix library."""
_OPTIONS_IN_ADVICE: Final = (
    ("--out", "choose another place", "choose another place with --out"),
    ("--roads", "or the road class ", "or --roads "),
)
"""Option of a command, advice in the library's errors, and advice that names the option."""
_MAX_LINE: Final = 2_000
"""Largest number of characters of an error message, which may quote an argument (our choice)."""
_GARBAGE_THRESHOLD: Final = 50_000
"""New objects after which Python looks for garbage (our choice)."""
_CONTEXT_SETTINGS: Final = {"help_option_names": ["-h", "--help"], "max_content_width": 100}
"""Settings of click: names of the help's option, width of the help in characters."""


COMMANDS: Final = {
    "init": "init:init",
    "run": "run:run",
    "ask-tell": "ask_tell:ask_tell",
    "resume": "resume:resume",
    "show": "show:show",
    "report": "report:report",
    "check": "check:check",
    "export": "export:export",
    "rerun": "rerun:rerun",
    "minimise": "minimise:minimise",
    "estimate": "estimate:estimate",
    "margin": "margin:margin",
    "compare": "compare:compare",
    "drive": "drive:drive",
    "list": "list:list_parts",
    "doctor": "doctor:doctor",
}
"""Name of a command -> ``module:function`` in this package."""


def _commands() -> dict[str, str]:
    """Return name -> ``module:function`` of all commands, of plug-ins and other packages, too."""
    installed_commands = {entry.name: entry.target for entry in installed("frenetic.commands")}
    return installed_commands | {name: f"{__name__}.{target}" for name, target in COMMANDS.items()}


def _summary(target: str) -> str:
    """Return the first help line of a command from its source, since importing it takes long.

    The result is empty where the source cannot be read, or has another form.
    """
    module, _, name = target.partition(":")
    with suppress(ImportError, OSError, ValueError):  # the package is broken
        spec = find_spec(module)
        source = "" if spec is None or spec.origin is None else Path(spec.origin).read_text("utf-8")
        match = re.search(rf'^def {re.escape(name)}\(.*?"""(.*?)(?:"""|\n)', source, re.S | re.M)
        return "" if match is None else match[1]
    return ""


class CommandTable(click.Group):
    """A group whose commands are imported when they are used."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002  # click's
        """Return the names of all commands."""
        return sorted(_commands())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        """Import and return the command of a name; None if no command has this name."""
        target = _commands().get(cmd_name)
        if target is None:
            return None
        module, _, name = target.partition(":")
        command: click.Command = getattr(import_module(module), name)
        return command

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; where an error gives advice for Python, name the option instead."""
        try:
            return super().invoke(ctx)
        except FreneticError as error:
            command = self.get_command(ctx, ctx.invoked_subcommand or "")
            parameters = [] if command is None else command.params
            text = str(error)
            for option, advice, advice_with_option in _OPTIONS_IN_ADVICE:
                if any(option in parameter.opts for parameter in parameters):
                    text = text.replace(advice, advice_with_option)
            error.args = (text,)
            raise

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        """Write name and summary of each command into the help, without importing the commands."""
        summaries = {name: _summary(target) for name, target in _commands().items()}
        with formatter.section("Commands"):
            formatter.write_dl(sorted(summaries.items()))


class Invocation:
    """A command line, and the time since it began.

    Args:
        words: words of the command line, without the program's name.
    """

    clock: ClassVar[Callable[[], float]] = time.monotonic
    """Function that returns the time in s, from any zero."""

    def __init__(self, words: tuple[str, ...] = ()) -> None:
        self.words = words
        self._began = Invocation.clock()

    @property
    def seconds(self) -> float:
        """Wall time since the command line began, in s."""
        return Invocation.clock() - self._began

    def __str__(self) -> str:
        """Return the command line for pasting into a shell."""
        from frenetic.cli.console import shell  # imports too slowly for --help

        return " ".join(["frenetic", *map(shell, self.words)])


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line; a user's mistake is one line on stderr and exit code 2."""
    # Numpy reads the variable when it is imported. For our small matrices several threads cost many
    # times the processor's time, and other cores belong to workers.
    os.environ.setdefault(BLAS_THREADS, "1")
    # Imported modules stay in memory, so looking for garbage among them only delays the start.
    gc.set_threshold(_GARBAGE_THRESHOLD)
    invocation = Invocation(tuple(sys.argv[1:] if arguments is None else arguments))
    try:
        with signals_act_like_ctrl_c(), plain_interrupts():
            code = cli.main(
                args=[*invocation.words],
                prog_name="frenetic",
                standalone_mode=False,  # click raises, and does not end the program
                obj=invocation,
            )
    except click.exceptions.Exit as stop:
        code = stop.exit_code
    except click.ClickException as error:
        fail(error.format_message())
    except FreneticError as error:
        import logging  # imports too slowly for --help

        logging.getLogger(__name__).debug("the error in full", exc_info=True)
        fail(str(error))
    except (KeyboardInterrupt, click.Abort) as stop:
        if isinstance(stop.__cause__, EOFError):  # an error in our code; click takes it for Ctrl-D
            raise stop.__cause__ from None
        echo(f"frenetic: interrupted; to run it again: {invocation}", err=True)
        code = INTERRUPTED
    except BrokenPipeError:  # the reader of our output has gone
        silence(sys.stdout)
        code = 1
    except OSError as error:
        if error.filename is None:
            raise
        fail(f"{error.filename} cannot be used: {error.strerror}")
    sys.exit(code if isinstance(code, int) else 0)


def fail(message: str) -> NoReturn:
    """Print one line about a user's mistake to stderr, and end the program with exit code 2."""
    complain(message)
    sys.exit(2)


def complain(message: str) -> None:
    """Print one line about a user's mistake to stderr."""
    echo(f"frenetic: {shortened(' '.join(message.split()), _MAX_LINE)}", err=True)


def echo(text: object = "", *, err: bool = False, nl: bool = True) -> None:
    r"""Print a text with printable control characters, such as ``\x1b``.

    Commands print only by this function or by a console of `frenetic.cli.console`.

    Args:
        text: any text, such as the reason of a test in a foreign database.
        err: whether to print to stderr.
        nl: whether to end the line.
    """
    click.echo(printable(str(text)), err=err, nl=nl)  # noqa: TID251  # the only permitted call


def silence(stream: TextIO) -> None:
    """Discard what is written to a stream that nobody reads, so that flushing at exit succeeds."""
    null_device = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null_device, stream.fileno())
    os.close(null_device)


def _print_version(context: click.Context, _: click.Parameter, is_wanted: bool) -> None:
    """Print the version and the commit of Frenetic, and exit, if the option is there."""
    if is_wanted and not context.resilient_parsing:
        from frenetic.parts.program import program_text  # takes its time

        echo(program_text())
        context.exit()


@click.group(cls=CommandTable, context_settings=_CONTEXT_SETTINGS, invoke_without_command=True)
@click.option(
    "--version",
    is_flag=True,
    expose_value=False,
    is_eager=True,
    callback=_print_version,
    help="Show the version and exit.",
)
@click.option("--debug", is_flag=True, help="Log what happens, with tracebacks, to stderr.")
@click.pass_context
def cli(context: click.Context, debug: bool) -> None:
    """Finds the roads on which an automated driver leaves its lane."""
    if context.invoked_subcommand is None:
        echo(context.get_help())
    if debug:
        _log_to_stderr()


def _log_to_stderr() -> None:
    """Log all events to stderr, with printable control characters as in `echo`."""
    import logging

    class EscapingFormatter(logging.Formatter):
        def format(self, record: logging.LogRecord) -> str:
            return printable(super().format(record))

    handler = logging.StreamHandler()
    handler.setFormatter(EscapingFormatter("%(asctime)s %(name)s %(levelname)s %(message)s"))
    logging.basicConfig(level=logging.INFO, handlers=[handler])
    logging.getLogger("frenetic").setLevel(logging.DEBUG)
