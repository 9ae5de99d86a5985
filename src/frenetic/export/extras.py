"""What is installed only on request."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from frenetic.errors import FreneticError


@contextmanager
def needing_tables(what: str) -> Iterator[None]:
    """Says how to install the extra ``tables`` if an import fails for the lack of it."""
    try:
        yield
    except ImportError as error:
        raise FreneticError(
            f"{what} needs pandas and pyarrow, and {error.name or 'one of them'} is not installed:"
            ' pip install "frenetic-roads[tables]"'
        ) from error
