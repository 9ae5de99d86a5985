"""A strategy that is a program in any language; docs/programs.md lists the messages."""

from __future__ import annotations

from typing import Any, ClassVar, Final

import msgspec
import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic._support.bounds import Finite, Index, Positive, Text, check
from frenetic._support.option_text import PROGRAM
from frenetic.errors import StrategyError
from frenetic.processes.programs import (
    Answer,
    AnswerT,
    Program,
    ProgramError,
    command_files,
    command_words,
    text_of,
)
from frenetic.road import MAP_SIZE
from frenetic.search.records import Candidate, Evaluation, Origin
from frenetic.search.strategy import Ledger, SearchEnded, Strategy

PROTOCOL: Final = 1
"""Version of the messages."""


class SearchHello(Answer):
    """The answer of a strategy's program to the first message."""

    trace: bool = False
    """Whether results shall have the drive's offsets and speeds along the road."""


class ProposedRoad(msgspec.Struct, forbid_unknown_fields=True):
    """A road that the program wants driven."""

    curvatures: list[Finite] = []
    """Curvature values, in 1/m, positive to the left."""
    step: Positive = 10.0
    """Distance between two values, in m."""
    points: list[tuple[Finite, Finite]] | None = None
    """Points of the centre line on the map, in m, instead of curvatures."""
    conditions: dict[str, int | Finite] = {}
    """Conditions of the drive: name -> amount."""
    operator: Text = "program"
    """Name of the way in which the road was made."""
    parents: tuple[Index, ...] = ()
    """Ids of the roads from which it was made."""
    generation: Index = 0
    """Generation, 0 for a road without parents."""


class Proposal(Answer):
    """The answer to the question for a road."""

    candidate: ProposedRoad | None = None
    """The road; None if there is none now."""
    wait: bool = False
    """Whether the program needs a result first."""
    end: str = ""
    """Why the search is over; empty if it goes on."""


class CommandSearch(Strategy):
    """A program in any language that proposes roads and reads their results.

    The program runs in the current folder, without a shell, until it ends the search or the process
    of the search ends. A resumed search repeats all questions and results to a new program, which
    has to answer as before.

    Args:
        seed: A whole number of at least 0, for the program.
        program: The program with its arguments, split as a shell does.
        map_size: m, side of the square map.
        deadline: Wall time that the program has for each answer, in s; at least 60 for the first.

    Raises:
        ValueError: An option is out of range; the message says which and what is allowed.
        FreneticError: The program is missing.

    """

    BEHAVIOUR: ClassVar[int] = 1
    """Version of the messages' meaning; campaigns record it."""

    def __init__(
        self,
        *,
        seed: Index,
        program: str,
        map_size: Positive = MAP_SIZE,
        deadline: Positive = 60.0,
    ) -> None:
        self.options = {
            "seed": seed,
            PROGRAM: program,
            "map_size": map_size,
            "deadline": deadline,
        }
        check(self.options, CommandSearch.__init__)
        self._words = command_words(program)
        self._program = Program(self._words, deadline, self._greet)
        self._ledger = Ledger()
        self._hello = SearchHello()
        self._end = ""

    @property
    def version_files(self) -> tuple[str, ...]:
        """Files that belong to the version: the program, and arguments that are files."""
        return command_files(self._words)

    def ask(self) -> Candidate | None:
        """Return the program's next road, or None if it needs a result first.

        Raises:
            SearchEnded: The program has no more roads.
            StrategyError: The program ended, took too long, or answered something else.

        """
        if self._end:
            raise SearchEnded(self._end)
        proposal = self._call({"ask": {}}, Proposal)
        if proposal.end:
            self._program.close()
            self._end = text_of(proposal.end)
            raise SearchEnded(self._end)
        road = proposal.candidate
        if road is None:
            if not proposal.wait:
                raise StrategyError(
                    'the strategy\'s program answered {"ask": {}} without "candidate", "wait" or'
                    ' "end"'
                )
            if not len(self._ledger):
                raise StrategyError(
                    "the strategy's program waits for a result, and all results are told"
                )
            return None
        points: FloatArray | None = None
        if road.points is not None:
            points = np.array(road.points, np.float64).reshape(-1, 2)
        elif len(road.curvatures) < 2:
            raise StrategyError(
                f"the strategy's program proposed {len(road.curvatures)} curvatures: at least 2 are"
                " needed"
            )
        return self._ledger.issue(
            np.array(road.curvatures, np.float64),
            road.step,
            Origin(road.operator, road.parents, road.generation),
            points,
            conditions=road.conditions,
        )

    def tell(self, evaluation: Evaluation) -> None:
        """Send the program the result of a road.

        Raises:
            ValueError: The candidate was never asked, or was told already.
            StrategyError: The program ended, took too long, or answered something else.

        """
        self._ledger.settle(evaluation)
        if self._end:  # nobody listens any more
            return
        result = as_message(evaluation, with_trace=self._hello.trace)
        self._call({"tell": result}, Answer)

    def _greet(self) -> None:
        """Tell a new program its terms, and ask what its results shall have."""
        terms = {name: self.options[name] for name in ("seed", "map_size")}
        message = {"hello": {"part": "strategy", "protocol": PROTOCOL, **terms}}
        self._hello = self._program.ask(message, SearchHello)

    def _call(self, message: dict[str, Any], kind: type[AnswerT]) -> AnswerT:
        """Return the program's answer to a message."""
        try:
            return self._program.ask(message, kind)
        except ProgramError as error:
            raise StrategyError(f"the strategy's program {error}") from None


def as_message(evaluation: Evaluation, *, with_trace: bool) -> dict[str, Any]:
    """Return a result for JSON, by the names of ``frenetic ask-tell``; what is unknown is None."""
    finding = evaluation.finding
    message: dict[str, Any] = {
        "id": evaluation.candidate.id,
        "outcome": str(evaluation.outcome),
        "moobd": evaluation.moobd,
        "objective": evaluation.objective,
        "place": evaluation.place,
        "side": None if finding is None else finding.side,
        "duration": evaluation.duration,
        "budget_spent": evaluation.budget_spent,
    }
    trace = evaluation.trace if with_trace else None
    if trace is not None:
        names = ("distance", "lateral_offset", "speed")
        message["trace"] = {name: getattr(trace, name).tolist() for name in names}
    return message
