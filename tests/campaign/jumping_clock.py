"""A campaign while the clock of the machine jumps; run as a script.

    python jumping_clock.py FOLDER steady|jumping

The clock that budgets are measured by goes on by 10 ms in each drive. Prints how many simulations
the budget of time has allowed.
"""

from __future__ import annotations

import datetime
import itertools
import sys
import time
from pathlib import Path

HOUR = 3600.0

jumps = itertools.cycle([0.0, -HOUR, 24.0 * HOUR, 25.0 * HOUR])
real = time.time


class Jumping(datetime.datetime):
    """An hour back, a day on."""

    @classmethod
    def now(cls, tz: datetime.tzinfo | None = None) -> Jumping:
        return cls.fromtimestamp(real() + next(jumps), tz)


if __name__ == "__main__":
    folder, kind = sys.argv[1:]
    if kind == "jumping":
        datetime.datetime = Jumping  # type: ignore[misc]
        time.time = lambda: real() + next(jumps)

    from campaigns import campaign
    from faulty import bend

    from frenetic.campaign import Budget
    from frenetic.testing import DummySimulator

    class Timed(DummySimulator):
        drives = 0

        def drive(self, *arguments):  # type: ignore[no-untyped-def]
            self.drives += 1
            return super().drive(*arguments)

    simulator = Timed(bend)
    time.perf_counter = lambda: 0.01 * simulator.drives
    summary = campaign(Path(folder), simulator=simulator, budget=Budget(time=0.505)).run()
    print(summary.simulations)  # noqa: T201
