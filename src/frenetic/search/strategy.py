"""What a campaign needs of a search algorithm."""

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
    """The end of a search that has nothing left to propose; the message says why, in a few words.

    `ask` raises it, and the campaign ends when the running drives are finished.
    """


class Strategy(ABC):
    """A search algorithm: proposes the next road and learns its result.

    The contract, which `frenetic.testing.strategy_contract.StrategyContract` tests:

    - `ask` may be called any number of times before anything is told. It never blocks. It returns a
      candidate, or None if it has to be told a result first: only while one is outstanding, and
      without changing anything. A strategy that has no more candidates raises `SearchEnded`, from
      then on at every call.
    - Candidates have ids 1, 2, 3, .. in the order of asking. Their curvatures are read-only, finite
      and at least two, and are never changed after they were handed out.
    - Each candidate is told exactly once, in any order, whatever its outcome: INVALID, ERROR and
      DROPPED are told as well, with ``moobd=None``. MOOBD, place, side, duration and trace of a
      drive may be missing, also where it failed.
    - The same constructor arguments (the seed among them) and the same sequence of asks and tells
      give the same candidates, bit for bit. This is how a campaign is resumed: what was asked and
      told is replayed to a fresh strategy. So a strategy draws from a generator of its own and
      looks at no clock.
    - A strategy is used from one thread at a time.

    Only `ask` and `tell` are needed. Your own strategy can leave its bookkeeping to a `Ledger`. Two
    decisions remain: what to propose, and what to remember.
    """

    default_max_in_flight: ClassVar[int | None] = None
    """Candidates that `frenetic run` keeps outstanding; None for its default."""
    expects_failures: ClassVar[bool] = False
    """Whether the roads are known to fail: no failure is driven a second time, and a driver that
    breaks on every road does not end the campaign."""

    road_class: RoadClass | None = None
    """Class whose rules the roads keep; None for the competition's rules. A campaign with a class
    gives it to a strategy whose ``__init__`` has an argument of this name. Roads of another
    strategy that break a rule are INVALID."""

    domain: Domain | None = None
    """Domain whose conditions the candidates have; None for the usual conditions. A campaign with a
    domain gives it to a strategy whose ``__init__`` has an argument of this name; no other
    strategy can search a domain."""

    @abstractmethod
    def ask(self) -> Candidate | None:
        """Return the next road to try, None for "tell me first"."""

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
        """Return further facts about the search: a few names in words -> plain values.

        The campaign stores them; reports and `frenetic show` print them as they are.
        """
        return {}

    def is_wanted(self, candidate: Candidate) -> bool:  # noqa: ARG002
        """Return whether a candidate that was asked and not yet told is still worth a drive.

        A campaign asks before a candidate is driven. An unwanted one is told as DROPPED and not
        driven; it costs no simulation. The answer changes nothing, depends only on what was asked
        and told, and once False stays False.
        """
        return True

    def keep_map_margin(self, map_margin: float) -> None:  # noqa: B027 - most check no roads
        """Take only roads for valid whose centre line keeps ``map_margin`` m from the map's edge.

        A campaign with another map margin than the usual one calls it before it asks for a road. A
        strategy that checks no roads ignores it.
        """

    def require_valid_roads(self) -> None:  # noqa: B027 - most cannot know
        """Refuse options with which it can propose no valid road.

        A campaign that starts from nothing calls it once, before it makes its folder.

        Raises:
            ValueError: No road is valid; the message says why, and what is allowed.

        """

    def start_from(self, earlier: Sequence[Evaluation]) -> None:
        """Learn which roads failed in earlier campaigns, or came near failing.

        A campaign calls it once, before it asks for a road, also when it is resumed. The results
        come from another driver, or from another version of it: what a road does now takes a new
        drive. Stretches of real roads, which nobody has driven, come first and are DROPPED.
        All roads fit the map and have the step of the strategy's option ``step``, if there is one.
        The strategy has asked none of these candidates.
        """
        raise NotImplementedError(f"{type(self).__name__} starts from no earlier campaign")


def has_own(strategy: Strategy, name: str) -> bool:
    """Return whether a strategy overrides a method of `Strategy`."""
    return getattr(type(strategy), name) is not getattr(Strategy, name)


class Ledger:
    """The numbered candidates of a strategy: which of them wait to be told.

    A ledger remembers only candidates that were asked and not yet told.
    """

    def __init__(self) -> None:
        self._last_id = 0
        self._outstanding: dict[int, Candidate] = {}

    def __len__(self) -> int:
        """Return the number of candidates that were asked and not yet told."""
        return len(self._outstanding)

    @property
    def issued(self) -> int:
        """Number of candidates that were asked so far."""
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
            curvatures: (N,) 1/m; copied.
            step: m between two curvature samples.
            origin: How the road was made.
            points: (N, 2) m, where it lies on the map, if it is to stay there; copied.
            more: Other fields of the `Candidate`.

        """
        candidate = Candidate(self._last_id + 1, curvatures, step, origin, points, **more)
        self._last_id = candidate.id
        self._outstanding[candidate.id] = candidate
        return candidate

    def settle(self, evaluation: Evaluation) -> Candidate:
        """Return the candidate as it was issued; it is no longer outstanding.

        Only the id of the evaluation's candidate counts, so it may have been rebuilt from a log.

        Raises:
            ValueError: The candidate was never issued or was settled already, the MOOBD is not a
                finite number, or the budget spent is not a finite number of at least 0. A candidate
                that was outstanding stays outstanding.

        """
        candidate_id = evaluation.candidate.id
        if candidate_id not in self._outstanding:
            if 1 <= candidate_id <= self._last_id:
                raise ValueError(
                    f"candidate {candidate_id} was told already, each candidate is told once"
                )
            raise ValueError(
                f"candidate {candidate_id} was never asked, the last one asked is {self._last_id}"
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
    """Return the plain options among the arguments of an ``__init__``, for a campaign's record.

    Raises:
        ValueError: An option is not what its hint says.

    """
    values = {name: without_numpy(value) for name, value in arguments.items()}
    plain = {k: value for k, value in values.items() if isinstance(value, (bool, int, float, str))}
    check(plain, init)
    return plain
