"""Command lines that load users' own modules anew, as processes of their own do."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from frenetic.registry import own_modules

if TYPE_CHECKING:
    from command_line import Answer, Frenetic


@pytest.fixture
def anew(frenetic: Frenetic) -> Frenetic:
    """Runs a command line in an empty folder; it leaves no module of a user's own loaded."""

    def call(*arguments: str) -> Answer:
        with own_modules():
            return frenetic(*arguments)

    return call
