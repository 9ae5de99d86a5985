"""Recipes of users' own drivers and simulators, which the command's own process never makes.

What it needs to know of such a part it asks in a process that lives no longer than the answer, so
an import, a constructor or a destructor may do there what it likes.
"""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

from frenetic.errors import FreneticError, describe_raised
from frenetic.registry import DRIVERS, SIMULATORS, Registry
from frenetic.worker import LostWorkerError, RaisedError, StandIn, Worker, pack

LIMIT: Final = 60.0
"""Time that a part may take for its import, its constructor and an answer each, in s."""
_REGISTRIES: Final[Mapping[str, Registry]] = {one.kind: one for one in (DRIVERS, SIMULATORS)}

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Recipe:
    """How a driver or simulator is made by name; it can be pickled where its part cannot."""

    kind: str
    name: str
    options: Mapping[str, Any] = field(default_factory=dict)
    available: Mapping[str, Any] = field(default_factory=dict)
    """Options that it gets if its class takes them."""

    @property
    def registry(self) -> Registry:
        """What knows its name."""
        return _REGISTRIES[self.kind]

    def make(self, factory: Callable[..., Any] | None = None) -> Any:
        """The part, made in this process, where its ``factory`` may be loaded already.

        Raises:
            FreneticError: it cannot be made.
        """
        return self.registry.make_from(self.name, self.options, self.available, factory)

    def make_in(self, folder: str) -> Any:
        """The part, made in a process whose folder another part may have left; likewise."""
        os.chdir(folder)
        return self.make()

    def ask(
        self,
        question: Callable[..., Any],
        *arguments: object,
        preloads: Sequence[str] = (),
        meanwhile: Callable[[], None] = lambda: None,
    ) -> Any:
        """The answer of the part, which is made in another process.

        Args:
            question: a function of a module, called there with the part.
            arguments: its other arguments.
            preloads: modules that the server of processes imports beside the usual ones.
            meanwhile: called here while the process starts.

        Raises:
            FreneticError: the part cannot be made, or does not answer.
        """
        return self._ask(_Guest(self, question, arguments), preloads, meanwhile)

    def ask_class(self, question: Callable[..., Any]) -> Any:
        """The same of the part's class."""
        return self._ask(_Guest(self, question, (), is_made=False))

    def _ask(
        self,
        guest: _Guest,
        preloads: Sequence[str] = (),
        meanwhile: Callable[[], None] = lambda: None,
    ) -> Any:
        worker = Worker(f"{self.kind} {self.name!r}", pack(guest), preloads)
        what = "starting"
        try:
            worker.start()
            meanwhile()
            answer = worker.answer()
            for what, method in guest.steps.items():  # noqa: B007 - told below
                answer = worker.call(method, limit=LIMIT)
        except RaisedError as error:
            logger.debug("%s", error.traceback)
            raise FreneticError(error.reason) from None
        except LostWorkerError as error:
            is_late = time.monotonic() > worker.deadline
            told = f"took more than {LIMIT:g} s" if is_late else f"broke its process: {error}"
            raise FreneticError(f"{self.kind} {self.name!r}: {what} it {told}") from None
        finally:
            worker.kill()
        return answer


class Told(NamedTuple):
    """What a part tells of itself."""

    described: Mapping[str, Any]
    """As `frenetic.spec.describe` gives it."""
    sources: Mapping[str, str]
    """As `frenetic.spec.sources_of` gives them."""
    attributes: Mapping[str, Any]
    """What is read of it where it is not made."""


class Named(StandIn):
    """A user's own part by its name."""

    def __init__(self, recipe: Recipe, told: Told) -> None:
        self.recipe = recipe
        self.told = told
        vars(self).update(told.attributes)

    @staticmethod
    def attributes_of(part: Any) -> dict[str, Any]:
        """The attributes of the part that it has, too."""
        raise NotImplementedError

    @property
    def maker(self) -> Callable[[], Any]:
        """Makes the part."""
        return partial(self.recipe.make_in, str(Path.cwd()))

    @property
    def class_name(self) -> str:
        """Name of its class."""
        return str(self.told.described["class"]).rpartition(":")[2]

    @property
    def options(self) -> Mapping[str, Any]:
        """Its options, described."""
        return dict(self.told.described.get("options", {}))


class _Guest:
    """A part in a process that makes it to ask it."""

    def __init__(
        self,
        recipe: Recipe,
        question: Callable[..., Any],
        arguments: Sequence[object],
        *,
        is_made: bool = True,
    ) -> None:
        self._recipe = recipe
        self._question = question
        self._arguments = arguments
        self._part: Any = None
        self.steps = {"importing": "load"} | ({"making": "make"} if is_made else {})
        self.steps["asking"] = "answer"

    def start(self) -> None:
        """Has nothing to start."""

    def load(self) -> None:
        with self._telling("importing"):
            self._part = self._recipe.registry.load(self._recipe.name)

    def make(self) -> None:
        with self._telling("making"):
            self._part = self._recipe.make(self._part)

    def answer(self) -> Any:
        with self._telling("asking"):
            return self._question(self._part, *self._arguments)

    @contextmanager
    def _telling(self, what: str) -> Iterator[None]:
        """Says of an error that is none of ours what raised it."""
        try:
            yield
        except FreneticError:
            raise
        except BaseException as error:  # a SystemExit, say
            who = f"{self._recipe.kind} {self._recipe.name!r}"
            raise FreneticError(f"{who}: {what} it raised {describe_raised(error)}") from error
