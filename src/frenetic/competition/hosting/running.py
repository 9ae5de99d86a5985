"""What the process does, from the first line that it is sent to the last that it sends."""

from __future__ import annotations

import logging
import os
import random
import sys
import threading
import traceback
from dataclasses import dataclass, replace
from typing import Any, BinaryIO, Final

import numpy as np

from frenetic.competition.hosting import offered
from frenetic.competition.hosting.assignment import Assignment
from frenetic.competition.hosting.executor import HostedExecutor
from frenetic.competition.hosting.loading import (
    GeneratorError,
    build,
    load_class,
    prepare_path,
    takes_time_budget,
)
from frenetic.competition.hosting.parent import Parent, leave_with_parent
from frenetic.errors import describe_error

MOST_LINES: Final = 20
"""Of a traceback that the bench is sent."""


@dataclass(frozen=True)
class End:
    """How a generator ended."""

    how: str
    """``over``: the budget was spent; ``returned`` or ``exit``, of its process: by itself before
    that; ``crashed``: it raised."""
    detail: str = ""
    """One line."""
    traceback: str = ""
    """Its last lines."""
    seconds: float = 0.0
    """Of wall time since ``start`` was called or the bench was last told of any."""


def serve(incoming: BinaryIO, outgoing: BinaryIO) -> None:
    """Run a generator; this ends the process."""
    leave_with_parent()
    parent = Parent(incoming, outgoing)
    end = run(Assignment.from_json(parent.receive()), parent)
    ours = {threading.current_thread(), parent.thread}
    threads = sum(thread not in ours for thread in threading.enumerate())
    logging.shutdown()
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    parent.send(
        {
            "kind": "end",
            "how": end.how,
            "detail": end.detail,
            "traceback": end.traceback,
            "threads": threads,
            "seconds": end.seconds,
        }
    )
    os._exit(0)  # without waiting for the generator's threads


def run(assignment: Assignment, parent: Parent) -> End:
    """Import, build and start a generator; return how it ended."""
    logging.basicConfig(
        level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s", stream=sys.stderr
    )
    prepare_path(assignment)
    offered.install()
    # Generators draw from the global generators; so a seed repeats what they do.
    random.seed(assignment.seed)
    np.random.seed(assignment.seed % 2**32)  # noqa: NPY002
    try:
        kind = load_class(assignment)
        executor = HostedExecutor(assignment, parent, remaining_as_number=takes_time_budget(kind))
        generator = build(kind, executor, assignment)
    except GeneratorError as error:
        return End("crashed", str(error), _printed(error.__cause__))
    parent.send({"kind": "ready"})
    executor.start()
    end = _started(generator, executor)
    return replace(end, seconds=executor.stop())


def _started(generator: Any, executor: HostedExecutor) -> End:
    try:
        generator.start()
    except SystemExit as error:
        if executor.has_spent_the_budget:
            return End("over")
        return End("exit", f"exit code {error.code}")
    except BaseException as error:
        return End("crashed", describe_error(error), _printed(error))
    return End("over" if executor.has_spent_the_budget else "returned")


def _printed(error: BaseException | None) -> str:
    """The last lines of an error's traceback, which is printed, too."""
    if error is None:
        return ""
    lines = traceback.format_exception(type(error), error, error.__traceback__)
    text = "".join(lines)
    sys.stderr.write(text)
    return "\n".join(text.splitlines()[-MOST_LINES:])
