"""Recipes of users' own drivers and simulators, which the command's own process never makes.

What it needs to know of such a part it asks in a process that lives no longer than the answer, so
an import, a constructor or a destructor may do there what it likes.
"""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any, ClassVar, Final, Generic, NoReturn, TypeVar

from frenetic._support.interrupt import catch_interrupt
from frenetic.errors import DriverError, FreneticError
from frenetic.registry import DRIVERS, SIMULATORS, Registry
from frenetic.worker import LostWorkerError, RaisedError, StandIn, Worker, pack

LIMIT: Final = 60.0
"""Time that a part may take for its import, and again for its constructor, in s."""
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
        """The part, made in this process; its ``factory`` may be loaded already.

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
        answer: Any = None,
        preloads: Sequence[str] = (),
        meanwhile: Callable[[], None] = lambda: None,
    ) -> Any:
        """The answer to a question about the part, from another process.

        Args:
            question: a function of a module, called there with the part as a `Guest`.
            arguments: its other arguments.
            answer: type of the answer.
            preloads: modules that the server of processes imports beside the usual ones.
            meanwhile: called here while the process starts.

        Raises:
            FreneticError: the part cannot be made, or does not answer.
        """
        worker = Worker(
            f"{self.kind} {self.name!r}", pack(Guest(self, question, arguments)), preloads
        )
        step = "starting"
        try:
            with catch_interrupt() as interrupt:  # the server complains of half a request
                worker.start()
            if interrupt.requested:
                raise KeyboardInterrupt
            meanwhile()
            worker.answer()
            step = "importing"
            worker.call("load", limit=LIMIT)
            step = "making"
            return worker.call("answer", limit=LIMIT, answer=answer)
        except RaisedError as error:
            logger.debug("%s", error.trouble.traceback)
            raise FreneticError(str(error)) from None
        except LostWorkerError as error:
            is_late = time.monotonic() > worker.deadline
            loss = f"took more than {LIMIT:g} s" if is_late else f"ended its process: {error}"
            raise FreneticError(f"{self.kind} {self.name!r}: {step} it {loss}") from None
        finally:
            worker.kill()


class Guest:
    """A part in a process that makes it to ask it, and then has no time to throw it away."""

    factory: Callable[..., Any]
    """Its class."""

    def __init__(
        self, recipe: Recipe, question: Callable[..., Any], arguments: Sequence[object]
    ) -> None:
        self._recipe = recipe
        self._question = question
        self._arguments = arguments

    def start(self) -> None:
        """Has nothing to start."""

    def load(self) -> None:
        """Imports it."""
        self.factory = self._recipe.registry.load(self._recipe.name)

    @cached_property
    def part(self) -> Any:
        """The part itself."""
        return self._recipe.make(self.factory)

    def answer(self) -> Any:
        """The answer to the question."""
        return self._question(self, *self._arguments)


Attributes = TypeVar("Attributes")


@dataclass(frozen=True)
class Told(Generic[Attributes]):
    """A part's description, sources and attributes, as its process gives them."""

    described: dict[str, Any]
    """As `frenetic.description.describe` gives it."""
    sources: dict[str, str]
    """As `frenetic.description.sources_of` gives them."""
    attributes: Attributes
    """A dataclass with the part's attributes that are read in other processes."""


class Named(StandIn):
    """A user's own part by its name."""

    attributes_type: ClassVar[type]
    """Dataclass of its `Told.attributes`."""

    def __init__(self, recipe: Recipe, told: Told[Any]) -> None:
        self.recipe = recipe
        self.told = told
        vars(self).update(vars(told.attributes))

    @staticmethod
    def attributes_of(part: Any) -> Any:
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

    def refuse(self) -> NoReturn:
        """Raises an error: it is not here."""
        raise DriverError(
            f"the {self.recipe.kind} {self.recipe.name!r} drives in another process only: isolate"
            " it, or make it from its class"
        )
