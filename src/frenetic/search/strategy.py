"""The interface between a campaign and a search algorithm."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import check
from frenetic._support.scalars import without_numpy
from frenetic.search.records import Candidate, Evaluation, Origin

if TYPE_CHECKING:
    from frenetic.conditions.domain import Domain
    from frenetic.road.classes import RoadClass


class SearchEnded(Exception):  # noqa: N818 - it is no error
    """Raised by `Strategy.ask` when the search has nothing left to propose.

    The message says why, in a few words. The campaign ends when the running drives are finished.
    """


class Strategy(ABC):
    """A search algorithm: proposes the next road and learns its result.

    The contract, which `frenetic.testing.strategy_contract.StrategyContract` tests:

    - `ask` may be called any number of times before any result is told. It never blocks. It returns
      a candidate, or None if it needs a result first. It may return None only while a candidate is
      outstanding, and None changes nothing. A strategy that has no more candidates raises
      `SearchEnded`, and does so at every later call.
    - Candidates have the ids 1, 2, 3 and so on in the order of asking. They have at least two
      curvatures, which are finite and read-only, and never change.
    - The result of each candidate is told exactly once, in any order, whatever the outcome:
      INVALID, ERROR and DROPPED are told, too, with ``moobd=None``. MOOBD, place, finding, duration
      and trace of a drive may be missing, even if the drive failed.
    - The same constructor arguments (the seed among them) and the same sequence of asks and tells
      give the same candidates, bit for bit. This is how a campaign is resumed: all asks and tells
      are repeated to a fresh strategy. So a strategy draws only from its own random generator and
      looks at no clock.
    - A strategy is used from one thread at a time.

    Only `ask` and `tell` are needed. Your own strategy can leave its bookkeeping to a `Ledger`. Two
    decisions remain: what to propose, and what to remember.
    """

    default_max_in_flight: ClassVar[int | None] = None
    """Candidates that `frenetic run` keeps outstanding; None for its default."""
    expects_failures: ClassVar[bool] = False
    """Whether the roads are known to fail. Then no failure is driven a second time, and a driver
    that breaks on every road does not end the campaign."""

    road_class: RoadClass | None = None
    """Class whose rules the roads keep; None for the competition's rules. A campaign with a class
    passes it to a strategy whose ``__init__`` has an argument of this name. Another strategy may
    propose roads that break a rule; they are INVALID."""

    domain: Domain | None = None
    """Domain whose conditions the candidates have; None for the usual conditions. A campaign with a
    domain passes it to a strategy whose ``__init__`` has an argument of this name; no other
    strategy can search a domain."""

    @abstractmethod
    def ask(self) -> Candidate | None:
        """Return the next road to try, or None if a result has to be told first.

        Raises:
            SearchEnded: There are no more candidates.
        """

    @abstractmethod
    def tell(self, evaluation: Evaluation) -> None:
        """Learn the result of a candidate.

        Raises:
            ValueError: The candidate was never asked, or was told already; nothing has changed.

        """

    @property
    def notice(self) -> str | None:
        """Warning about the search for its user: a sentence without a full stop, or None.

        It depends only on what was asked and told.
        """
        return None

    def facts(self) -> Mapping[str, Any]:
        """Return further facts about the search, such as ``{"new failures": 4}``.

        The campaign stores them; reports and `frenetic show` print names and values as they are.
        """
        return {}

    def is_wanted(self, candidate: Candidate) -> bool:  # noqa: ARG002
        """Return whether a candidate that was asked and not yet told is still worth a drive.

        A campaign asks before it drives a candidate. An unwanted candidate is not driven, costs no
        simulation and is told as DROPPED. The answer depends only on what was asked and told, and
        once False stays False. Answering changes nothing.
        """
        return True

    def keep_map_margin(self, map_margin: float) -> None:  # noqa: B027 - most check no roads
        """Refuse roads whose centre line comes nearer than ``map_margin`` m to the map's edge.

        A campaign whose map margin is not the default calls it before it asks for a road. A
        strategy that does not check its roads ignores it.
        """

    def require_valid_roads(self) -> None:  # noqa: B027 - most cannot know
        """Refuse options with which the strategy can propose no valid road.

        A campaign without a warm start calls it once, before it makes its folder.

        Raises:
            ValueError: No road is valid; the message says why, and what is allowed.

        """

    def start_from(self, earlier: Sequence[Evaluation]) -> None:
        """Learn which roads failed in earlier campaigns, or came near failing.

        A campaign calls it once, before it asks for a road, also when it is resumed. The results
        may come from another driver or another version of the driver: only a new drive tells what
        happens on a road now. Stretches of real roads, which nobody has driven, come first and are
        DROPPED. All roads fit the map and have the step of the strategy's option ``step``, if there
        is one. These candidates do not come from this strategy's `ask`.

        Args:
            earlier: Results of the earlier campaigns.

        Raises:
            NotImplementedError: The strategy cannot start from earlier campaigns.
        """
        raise NotImplementedError(f"{type(self).__name__} starts from no earlier campaign")


def has_own(strategy: Strategy, name: str) -> bool:
    """Return whether a strategy overrides a method of `Strategy`."""
    return getattr(type(strategy), name) is not getattr(Strategy, name)


class Ledger:
    """Numbers the candidates of a strategy, and knows which of them still lack a result.

    A candidate is outstanding from the time it is issued until it is settled. A ledger remembers
    only outstanding candidates.
    """

    def __init__(self) -> None:
        self._last_id = 0
        self._outstanding: dict[int, Candidate] = {}

    def __len__(self) -> int:
        """Return the number of outstanding candidates."""
        return len(self._outstanding)

    @property
    def issued(self) -> int:
        """Number of candidates that were issued so far."""
        return self._last_id

    def issue(
        self,
        curvatures: FloatArray,
        step: float,
        origin: Origin,
        points: FloatArray | None = None,
        **more: Any,
    ) -> Candidate:
        """Return a new candidate that carries the next id.

        Args:
            curvatures: Curvatures, (N,) in 1/m; they are copied.
            step: Distance between two curvature samples, in m.
            origin: How the road was made.
            points: Points on the map, (N, 2) in m, if the road is to stay there; they are copied.
            more: Other fields of the `Candidate`.

        """
        candidate = Candidate(self._last_id + 1, curvatures, step, origin, points, **more)
        self._last_id = candidate.id
        self._outstanding[candidate.id] = candidate
        return candidate

    def settle(self, evaluation: Evaluation) -> Candidate:
        """Return the candidate of a result as it was issued; it is no longer outstanding.

        Only the id of the evaluation's candidate matters: a resumed campaign reads it from the
        database.

        Raises:
            ValueError: The candidate was never issued or was settled already, the MOOBD is not a
                finite number, or the budget spent is not a finite number of at least 0. Nothing
                has changed.

        """
        candidate_id = evaluation.candidate.id
        if candidate_id not in self._outstanding:
            if 1 <= candidate_id <= self._last_id:
                raise ValueError(
                    f"candidate {candidate_id} was told already: tell each candidate once"
                )
            raise ValueError(
                f"candidate {candidate_id} was never asked: the last candidate is {self._last_id}"
            )
        if evaluation.moobd is not None and not math.isfinite(evaluation.moobd):
            raise ValueError(
                f"candidate {candidate_id}: the MOOBD must be a finite number of m,"
                f" got {evaluation.moobd}"
            )
        if not 0.0 <= evaluation.budget_spent < math.inf:
            raise ValueError(
                f"candidate {candidate_id}: the budget spent must be a finite number "
                f"of at least 0, got {evaluation.budget_spent}"
            )
        return self._outstanding.pop(candidate_id)


def checked_options(
    arguments: Mapping[str, Any], init: Callable[..., None]
) -> dict[str, int | float | str | bool]:
    """Check the arguments of an ``__init__``; return the numbers, texts and Booleans among them.

    A campaign records what is returned as the options of a strategy.

    Args:
        arguments: The arguments by name, as ``locals()`` gives them.
        init: The ``__init__``, whose type hints hold the bounds.

    Raises:
        ValueError: An option is out of bounds; the message says which and what is allowed.

    """
    values = {name: without_numpy(value) for name, value in arguments.items()}
    options = {
        name: value for name, value in values.items() if isinstance(value, (bool, int, float, str))
    }
    check(options, init)
    return options
