"""Messages on stderr about mistakes on the command line."""

from __future__ import annotations

import os
import sys
from typing import NoReturn, TextIO

import click


def fail(message: str) -> NoReturn:
    """Ends the program with one line about a user's mistake."""
    complain(message)
    sys.exit(2)


def complain(message: str) -> None:
    """Prints one line about a user's mistake to stderr."""
    click.echo(f"frenetic: {' '.join(message.split())}", err=True)


def silence(stream: TextIO) -> None:
    """Discards a stream that nobody reads, so that nothing fails at exit either."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)
