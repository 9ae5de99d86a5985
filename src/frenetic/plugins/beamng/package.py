"""The package BeamNGpy: its import, its connections, and its errors as `BeamngError`."""

from __future__ import annotations

import importlib
import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import version
from typing import Any, Final

from frenetic._support.words import pip_install
from frenetic.errors import FreneticError, describe_error

EXTRA: Final = pip_install("beamng")
"""Command that installs the package, in words."""
_CONNECT_LIMIT: Final = 10.0
"""Time after which a port that neither accepts nor refuses counts as unreachable, in s; our
choice."""
_ANOTHER_VERSION: Final = (
    "; install the version of beamngpy that belongs to this BeamNG.tech: 1.36 to 0.39, a newer"
    " one to a newer one"
)

logger = logging.getLogger(__name__)
_silence = logging.NullHandler()


class BeamngError(FreneticError):
    """BeamNG.tech cannot be started or reached, or it broke."""


def beamngpy() -> Any:
    """Return the package BeamNGpy, which is imported on use, since that takes seconds.

    Raises:
        BeamngError: BeamNGpy is not installed.
    """
    # BeamNGpy logs a lot, so its log is silent except with ours; what matters becomes an error.
    foreign_logger = logging.getLogger("beamngpy")
    foreign_logger.addHandler(_silence)
    foreign_logger.propagate = logger.isEnabledFor(logging.DEBUG)
    try:
        return importlib.import_module("beamngpy")
    except ModuleNotFoundError as error:
        if error.name != "beamngpy":
            raise
        raise BeamngError(f"BeamNG.tech needs the package beamngpy: {EXTRA}") from None


@contextmanager
def translated_errors(subject: str) -> Iterator[None]:
    """Turn every error of BeamNGpy into a `BeamngError` that names the activity.

    Args:
        subject: the activity, such as ``loading the road``.

    Raises:
        BeamngError: an error was raised.
    """
    from beamngpy.logging import BNGDisconnectedError, BNGError, BNGValueError  # an extra

    try:
        yield
    except BeamngError:
        raise
    except TimeoutError as error:
        raise BeamngError(f"BeamNG.tech did not answer in time, {subject}") from error
    except (BNGDisconnectedError, OSError) as error:
        raise BeamngError(
            f"the connection to BeamNG.tech was lost, {subject}: {describe_error(error)}"
        ) from error
    except (BNGError, BNGValueError) as error:
        text = " ".join(str(error).split())
        if "protocol versions" in text:
            text += _ANOTHER_VERSION
        raise BeamngError(f"BeamNG.tech reported an error, {subject}: {text}") from error
    except (
        AssertionError,
        AttributeError,
        ImportError,
        LookupError,
        TypeError,
        ValueError,
    ) as error:
        raise BeamngError(
            f"BeamNG.tech or beamngpy {version('beamngpy')} is not as Frenetic knows it, {subject}:"
            f" {describe_error(error)}; Frenetic is tested with beamngpy 1.36, which belongs to"
            " BeamNG.tech 0.39"
        ) from error


def beamngpy_module(name: str) -> Any:
    """Return a module of BeamNGpy, such as ``sensors``."""
    return importlib.import_module(f"beamngpy.{name}")


def new_connection(host: str, port: int, limit: float) -> Any:
    """Return a connection that is not open yet.

    A lost or silent connection raises an error at once. BeamNGpy alone would connect again, and
    wait there for the answer to a message that it has not sent there. So two methods are replaced.

    Args:
        host: host of BeamNG.tech.
        port: port of BeamNG.tech or of a vehicle.
        limit: time that an answer may take, in s.
    """
    connection = beamngpy_module("connection").Connection(host, port, timeout=_CONNECT_LIMIT)
    original_hello = connection.hello

    def refuse_to_reconnect() -> None:
        raise sys.exception() or ConnectionError("it is lost")

    def hello_within_limit() -> None:
        # The first call on a new socket: BeamNGpy makes the socket without a limit.
        connection.skt.skt.settimeout(limit)
        connection.skt.reconnect = refuse_to_reconnect
        original_hello()

    connection.hello = hello_within_limit
    return connection
