"""Errors that a user can cause, each with a message for the reader."""

from __future__ import annotations


def describe_error(error: BaseException) -> str:
    """Class and text of an error in foreign code, in one line of at most 450 characters."""
    try:
        text = " ".join(str(error).split())
    except Exception:
        text = "an error without a readable text"
    return f"{type(error).__name__}: {text}"[:450] if text else type(error).__name__


class FreneticError(Exception):
    """A mistake or a circumstance that the user can fix.

    The message is one line: what was given, what is allowed, what to do. The command line prints it
    and exits with code 2.
    """


class RoadError(FreneticError, ValueError):
    """Values or points that do not describe a road."""


class CampaignError(FreneticError):
    """A campaign's folder or database that cannot be used as asked."""


class StrategyError(CampaignError):
    """A strategy that raised, or whose roads are all refused, which ends the search."""


class DriverError(FreneticError):
    """A driver that cannot be loaded, or that broke its contract during a drive."""


class UnknownNameError(FreneticError, LookupError):
    """The name of an unregistered strategy, driver or simulator."""


def reason_of(error: BaseException) -> str:
    """One line about an error of a simulator or driver; our own errors stay as they are."""
    return str(error) if isinstance(error, FreneticError) else describe_error(error)
