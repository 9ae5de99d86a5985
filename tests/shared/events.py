"""Functions for ``on_event`` of `Campaign.run` that handle one kind of event."""

from __future__ import annotations

from collections.abc import Callable

from frenetic.campaign import Event, Summary, Test


def on_result(call: Callable[[Summary], object]) -> Callable[[Event], None]:
    """Return an ``on_event`` that calls with the summary after every result."""

    def on_event(event: Event) -> None:
        if event.kind == "result":
            call(event.summary)

    return on_event


def on_test(call: Callable[[Test], object]) -> Callable[[Event], None]:
    """Return an ``on_event`` that calls with the test of every result."""

    def on_event(event: Event) -> None:
        if event.test is not None:
            call(event.test)

    return on_event
