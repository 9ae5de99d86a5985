"""The values of a campaign's objective: in words, and the test with the worst value."""

from __future__ import annotations

from collections.abc import Mapping

from frenetic.campaign.objective import CRITERIA, MOOBD, OOB_SHARE, Objective, nearest_margin
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.criteria.criterion import SIGNALS, signal_named
from frenetic.parts.registry import OBJECTIVES


def objective_values(store: CampaignStore) -> dict[int, float]:
    """Return the objective's value of each test by the test's id, lowest id first.

    There are no values if the campaign minimises the MOOBD.
    """
    select = "SELECT id, objective FROM test WHERE objective IS NOT NULL ORDER BY id"
    return dict(store.rows(select))


def worst_test(store: CampaignStore, objective: Objective) -> Test | None:
    """Return the stored test that is worst for the driver, by an objective; None before a drive.

    Raises:
        CampaignError: the campaign is damaged.
    """
    if values := objective_values(store):
        return store.test(_worst_id(values, higher_is_worse=objective.higher_is_worse))
    lowest = next(store.tests(order_by="moobd", limit=1, with_trajectory=True), None)
    return None if lowest is None or lowest.moobd is None else lowest


def _worst_id(values: Mapping[int, float], *, higher_is_worse: bool) -> int:
    """Return the id of the first test with the worst value."""
    worst = max if higher_is_worse else min
    return worst(values, key=lambda test_id: values[test_id])


def _is_higher_worse(store: CampaignStore) -> bool:
    return store.config.get("higher_is_worse") is True


# In words


def objective_text(store: CampaignStore) -> str:
    """Return a campaign's objective, its worst value for the driver, and the test with this value.

    An example is ``gap: lower is worse; worst gap 0.31, in test 7``.
    """
    name = str(store.config.get("objective", MOOBD))
    is_higher_worse = _is_higher_worse(store)
    built_in = OBJECTIVES.built_in.get(name)
    order = f"{'higher' if is_higher_worse else 'lower'} is worse"
    text = f"{name}: {built_in[1] if built_in else order}"
    values = objective_values(store)
    if not values:
        return text
    test_id = _worst_id(values, higher_is_worse=is_higher_worse)
    worst = worst_value_text(name, values[test_id])
    return f"{text}; {worst}{worst_criterion_text(store)}, in test {test_id}"


def value_text(name: str, value: float) -> str:
    """Return an objective's value for a drive, with its unit: ``largest lateral jerk 9.60 m/s³``.

    Args:
        name: name of the objective, which is not the MOOBD.
        value: value as the objective gives it, not turned for a strategy that minimises.
    """
    if name == CRITERIA:
        return f"worst margin to a criterion {value:.3g}"
    if name == OOB_SHARE:
        return f"at most {100.0 * value:.0f} % of the car outside its lane"
    signal_name = name.replace("-", "_")
    if signal_name in SIGNALS:
        signal = signal_named(signal_name)
        return f"{'least' if signal.is_least else 'largest'} {signal.words} {signal.text(value)}"
    return f"{name} {value:.3g}"


def worst_value_text(name: str, value: float) -> str:
    """Return the worst value of an objective among several drives, in words; see `value_text`."""
    text = value_text(name, value)
    return text if name in OBJECTIVES.built_in else f"worst {text}"


def worst_criterion_text(store: CampaignStore) -> str:
    """Return the criterion with the worst margin: ``: lateral jerk 9.60 m/s³ (at most 5 m/s³)``.

    Empty if the campaign does not minimise the margin to its criteria, or before a drive.
    """
    if store.config.get("objective") != CRITERIA:
        return ""
    values = objective_values(store)
    if not values:
        return ""
    test = store.test(_worst_id(values, higher_is_worse=_is_higher_worse(store)))
    if test.drive is None:
        return ""
    return f": {nearest_margin(test.road, test.drive).text}"
