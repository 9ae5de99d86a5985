from __future__ import annotations

import pytest

from frenetic.campaign import Budget


def test_nearest_limit_counts() -> None:
    budget = Budget(simulations=100, time=50.0, failures=4)
    assert budget.spent(10, 1.0, 0) == pytest.approx(0.1)
    assert budget.spent(10, 25.0, 0) == pytest.approx(0.5)
    assert budget.spent(10, 25.0, 3) == pytest.approx(0.75)


def test_share_never_exceeds_one() -> None:
    assert Budget(time=1.0).spent(0, 7.0, 0) == 1.0


@pytest.mark.parametrize(
    "limits",
    [
        {},
        {"simulations": 0},
        {"simulations": -3},
        {"simulations": 2.5},
        {"simulations": True},
        {"failures": 0},
        {"time": 0.0},
        {"time": -1.0},
        {"time": float("nan")},
        {"time": float("inf")},
    ],
)
def test_budget_that_is_none_is_refused(limits: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"needed|has to be given"):
        Budget(**limits)  # type: ignore[arg-type]
