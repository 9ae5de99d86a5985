"""The work of the process, from its first message to its last."""

from __future__ import annotations

import logging
import os
import random
import sys
import threading
import traceback
from dataclasses import asdict, replace
from typing import Any, BinaryIO, Final

import numpy as np

from frenetic.bench.hosting import offered
from frenetic.bench.hosting.executor import HostedExecutor
from frenetic.bench.hosting.loader import (
    GeneratorError,
    build,
    load_class,
    prepare_path,
    takes_time_budget,
)
from frenetic.bench.hosting.messages import Assignment, End, Parent, leave_with_parent
from frenetic.bench.hosting.validity import validity
from frenetic.errors import describe_error

MOST_LINES: Final = 20
"""Most lines of a traceback sent to the bench."""


def serve(incoming: BinaryIO, outgoing: BinaryIO) -> None:
    """Run a generator; this ends the process."""
    leave_with_parent()
    parent = Parent(incoming, outgoing)
    end = run(Assignment(**parent.receive()), parent)
    ours = {threading.current_thread(), parent.thread}
    threads = sum(thread not in ours for thread in threading.enumerate())
    logging.shutdown()
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    parent.send(asdict(replace(end, threads=threads)))
    os._exit(0)  # without waiting for the generator's threads


def run(assignment: Assignment, parent: Parent) -> End:
    """Import, build and start a generator; return its end."""
    logging.basicConfig(
        level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s", stream=sys.stderr
    )
    prepare_path(assignment)
    offered.install()
    # Generators draw from the global random generators, so a seed repeats them.
    random.seed(assignment.seed)
    np.random.seed(assignment.seed % 2**32)  # noqa: NPY002
    try:
        kind = load_class(assignment)
        executor = HostedExecutor(assignment, parent, remaining_as_number=takes_time_budget(kind))
        generator = build(kind, executor, assignment)
    except GeneratorError as error:
        return End("crashed", str(error), _printed(error.__cause__))
    if assignment.counts_computing:
        validity()  # its import is not the generator's time
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
    """The last lines of an error's traceback, which is also printed."""
    if error is None:
        return ""
    lines = traceback.format_exception(type(error), error, error.__traceback__)
    text = "".join(lines)
    sys.stderr.write(text)
    return "\n".join(text.splitlines()[-MOST_LINES:])
