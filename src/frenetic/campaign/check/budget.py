"""The check of the shares of the budget.

Each share follows from the results told by then, the campaign's time and the budget. A resumed
campaign may have had several budgets, of which only the first and the last are known. So every
share must be that of the first budget up to some result, and that of the last budget from some
result on. Between these, where a campaign was extended and killed more than once, nothing is known.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt

from frenetic._support.arrays import FloatArray
from frenetic.campaign.check.database import Facts
from frenetic.campaign.check.report import FindingCollector, Subject
from frenetic.campaign.check.rows import Series
from frenetic.outcome import Outcome
from frenetic.spec import Budget

_SAME: Final = 1e-9


def check_budget(series: Series, facts: Facts, ended: bool, findings: FindingCollector) -> None:
    """Checks the spent share of the budget in each result.

    Args:
        series: the results.
        facts: the campaign's budgets.
        ended: whether the campaign ended by itself with its last budget.
        findings: collects the findings.
    """
    first = facts.first_budget
    last = facts.last_budget or first
    if first is None or last is None or not series.ids:
        return
    spent = np.array(series.spent)
    by_first, by_last = _shares(first, series), _shares(last, series)
    is_first, is_last = _agrees(spent, by_first), _agrees(spent, by_last)
    count = len(spent)
    # A share of 1 fits every spent budget, so it does not tell which one it was.
    until = _last_true(is_first & (by_first < 1.0)) + 1
    after = np.flatnonzero(is_last & (by_last < 1.0) & (np.arange(count) >= until))
    if ended:
        start = int(after[0]) if len(after) else until
        end = count
    else:
        start, end = (int(after[0]), int(after[-1]) + 1) if len(after) else (count, count)
    for k in range(count):
        agrees = is_first[k] or (k >= until and is_last[k])
        known = k < until or start <= k < end
        if known and not agrees and not math.isnan(spent[k]):
            share = by_first[k] if k < until else by_last[k]
            findings.add(
                Subject.BUDGET,
                f"test {series.ids[k]}: budget_spent is {spent[k]:.6g},"
                f" but {share:.6g} of the budget was spent by then",
            )


def _shares(budget: Budget, series: Series) -> FloatArray:
    """Spent share of a budget at each result, (n,); NaN where the time is unknown."""
    free = (Outcome.INVALID, Outcome.DROPPED)
    simulations = np.cumsum([outcome not in free for outcome in series.outcomes])
    failures = np.cumsum([outcome is Outcome.FAIL for outcome in series.outcomes])
    shares = np.zeros(len(series.ids))
    for done, limit in (
        (simulations, budget.simulations),
        (np.array(series.elapsed), budget.time),
        (failures, budget.failures),
    ):
        if limit is not None:
            shares = np.maximum(shares, done / limit)
    return np.minimum(shares, 1.0)


def _agrees(spent: FloatArray, shares: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether shares are equal, or one of them is unknown."""
    return ~(np.abs(spent - shares) > _SAME)


def _last_true(flags: npt.NDArray[np.bool_]) -> int:
    """Index of the last True, -1 without one."""
    places = np.flatnonzero(flags)
    return int(places[-1]) if len(places) else -1
