from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import pytest

from frenetic.campaign import Budget
from frenetic.spec import decode_budget


def test_nearest_limit_counts() -> None:
    budget = Budget(simulations=100, time=50.0, failures=4)
    assert budget.spent(10, 1.0, 0) == pytest.approx(0.1)
    assert budget.spent(10, 25.0, 0) == pytest.approx(0.5)
    assert budget.spent(10, 25.0, 3) == pytest.approx(0.75)


def test_share_never_exceeds_one() -> None:
    assert Budget(time=1.0).spent(0, 7.0, 0) == 1.0


MAKERS: tuple[Callable[[dict[str, Any]], Budget], ...] = (
    lambda limits: Budget(**limits),
    decode_budget,
)
WHOLE = "a whole number of at least 1 is needed"
SECONDS = "a positive number of seconds is needed"


@pytest.mark.parametrize(
    ("limits", "fault"),
    [
        ({}, "the budget limits nothing: simulations, time or failures has to be given"),
        ({"simulations": 0}, f"simulations is 0: {WHOLE}"),
        ({"simulations": -1}, f"simulations is -1: {WHOLE}"),
        ({"failures": 0}, f"failures is 0: {WHOLE}"),
        ({"time": -1.0}, f"time is -1.0: {SECONDS}"),
        ({"time": float("inf")}, f"time is inf: {SECONDS}"),
    ],
)
def test_what_is_none_is_refused_alike_from_python_and_from_a_record(
    limits: dict[str, Any], fault: str
) -> None:
    for make in MAKERS:
        with pytest.raises(ValueError, match=f"^{re.escape(fault)}"):
            make(limits)


@pytest.mark.parametrize(
    "limits", [{"simulations": 2.5}, {"simulations": "5"}, {"failures": True}, {"time": "10s"}]
)
def test_what_is_no_number_is_refused(limits: dict[str, Any]) -> None:
    for make in MAKERS:
        with pytest.raises(ValueError, match=r"is needed|^Expected .* - at `\$\.\w+`$"):
            make(limits)
