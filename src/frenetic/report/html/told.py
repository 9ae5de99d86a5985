"""The tests that a page speaks of, as columns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from frenetic.campaign.store import CampaignStore
from frenetic.outcome import Outcome
from frenetic.search.operators import DOES
from frenetic.search.records import Origin

LETTERS: Final[Mapping[Outcome, str]] = {outcome: str(outcome)[0] for outcome in Outcome}
"""An outcome in one letter."""


@dataclass(frozen=True, slots=True)
class Told:
    """What a page needs of any test."""

    id: int
    outcome: Outcome
    moobd: float | None
    """m."""
    elapsed: float | None
    """s of the campaign's time when it was told."""
    origin: Origin


def read_told(store: CampaignStore) -> list[Told]:
    """All tests in the order of telling.

    Raises:
        CampaignError: the campaign is damaged.
    """
    return [
        Told(
            record.candidate.id,
            record.outcome,
            record.moobd,
            record.elapsed,
            record.candidate.origin,
        )
        for record in store.tests()
    ]


@dataclass(frozen=True)
class TestTable:
    """Columns of equal length, a row per test."""

    __test__ = False  # not a test class, whatever a test runner may think

    ids: tuple[int, ...]
    outcomes: str
    """A letter per test, see `LETTERS`."""
    moobds: tuple[int | None, ...]
    """cm."""
    operators: tuple[str, ...]
    """All there are."""
    operators_do: tuple[str, ...]
    """What each of them does; empty where that is not known."""
    operator: tuple[int, ...]
    """Which of them, per test."""
    parents: tuple[tuple[int, ...], ...]

    @classmethod
    def of(cls, tests: Iterable[Told]) -> TestTable:
        """The table of some tests."""
        rows = list(tests)
        operators = sorted({test.origin.operator for test in rows})
        place = {name: i for i, name in enumerate(operators)}
        return cls(
            ids=tuple(test.id for test in rows),
            outcomes="".join(LETTERS[test.outcome] for test in rows),
            moobds=tuple(
                None if test.moobd is None else round(100.0 * test.moobd) for test in rows
            ),
            operators=tuple(operators),
            operators_do=tuple(DOES.get(name, "") for name in operators),
            operator=tuple(place[test.origin.operator] for test in rows),
            parents=tuple(tuple(test.origin.parents) for test in rows),
        )


def ancestors(tests: Mapping[int, Told], ids: Iterable[int]) -> list[int]:
    """Ids of all tests from which others descend, the nearest first."""
    found: dict[int, None] = {}
    waiting = [parent for i in ids if i in tests for parent in tests[i].origin.parents]
    while waiting:
        nearest = dict.fromkeys(i for i in waiting if i in tests and i not in found)
        found |= nearest
        waiting = [parent for i in nearest for parent in tests[i].origin.parents]
    return list(found)
