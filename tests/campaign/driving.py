"""Workers of all kinds at work, for their tests."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

from faulty import roads, straight
from pids import LIMIT

from frenetic.campaign.log import LOG
from frenetic.campaign.record import Attempt
from frenetic.campaign.workers import Workers


def events(folder: Path) -> list[dict[str, Any]]:
    """Lines of a campaign's log."""
    return [json.loads(line) for line in (folder / LOG).read_text().splitlines()]


def await_free(workers: Workers, count: int = 1) -> None:
    """Waits until so many candidates can be submitted, while nothing comes back."""
    deadline = time.monotonic() + LIMIT
    while workers.free < count:
        assert time.monotonic() < deadline
        assert not workers.wait(0.5)


def await_all(workers: Workers) -> None:
    """Waits until every worker is there and idle."""
    deadline = time.monotonic() + LIMIT
    while any(one.state != "idle" for one in workers.states().values()):
        assert time.monotonic() < deadline
        assert not workers.wait(0.5)


def await_attempts(workers: Workers, count: int = 1) -> list[Attempt]:
    """Waits for so many attempts."""
    attempts: list[Attempt] = []
    deadline = time.monotonic() + LIMIT
    while len(attempts) < count:
        assert time.monotonic() < deadline
        attempts += workers.wait(0.5)
    assert len(attempts) == count
    return attempts


def drive_one(workers: Workers, number: int = 1) -> Attempt:
    """Tests a straight road."""
    await_free(workers)
    workers.submit(straight(number))
    (attempt,) = await_attempts(workers)
    return attempt


def drive_all(workers: Workers, samples: list[int]) -> dict[int, Attempt]:
    """Tests straight roads of so many samples, each once; their attempts by candidate."""
    waiting = roads(samples)
    done: dict[int, Attempt] = {}
    deadline = time.monotonic() + LIMIT
    while len(done) < len(samples):
        assert time.monotonic() < deadline
        while waiting and workers.free:
            workers.submit(waiting.pop(0))
        for attempt in workers.wait(0.5):
            assert attempt.candidate_id not in done
            done[attempt.candidate_id] = attempt
    return done
