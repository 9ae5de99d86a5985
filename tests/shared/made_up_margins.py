"""Made-up margins of a driver."""

from __future__ import annotations

import math
from pathlib import Path

from frenetic.rerun.margin_quantities import MarginQuantity
from frenetic.rerun.margin_results import ConditionMargin, Margins, RoadLimit

DELAY = MarginQuantity("delay", 0.0, 1.0, 0.0)
FRICTION = MarginQuantity("friction", 1.0, 0.01, 1.0)
VIEW = MarginQuantity("view", math.inf, 1.0, 500.0)


def limits(quantity: MarginQuantity, *shares: float) -> tuple[RoadLimit, ...]:
    """Return the limits of roads at shares of a quantity's range; above 1 there is none."""
    return tuple(
        RoadLimit(
            i,
            share,
            quantity.amount(share),
            quantity.usual if share > 0.0 else None,
            quantity.end if share > 0.0 else None,
            i,
        )
        if share <= 1.0
        else RoadLimit(i, math.inf, None, quantity.end, None, None)
        for i, share in enumerate(shares, 1)
    )


def margins(folder: Path = Path("c")) -> Margins:
    """Return margins of a driver that fails from 0.3 s of delay on, and as usual in a view."""
    part = {"class": "a:B"}
    measured = (
        ConditionMargin(DELAY, limits(DELAY, *[0.3] * 80), limits(DELAY, 0.2, 0.9)),
        ConditionMargin(FRICTION, limits(FRICTION, *[2.0] * 80), limits(FRICTION, 2.0, 2.0)),
        ConditionMargin(VIEW, limits(VIEW, *[0.0] * 80), limits(VIEW, 0.0, 0.5)),
    )
    return Margins(measured, "rural <80> $x$", part, part, seed=0, drives=9, folder=folder)
