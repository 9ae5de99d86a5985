"""Strategies, drivers and simulators by name: built in, installed by others, or a user's own.

A name stands for ``module:Class`` and is imported on use, so listing the names imports nothing.
Other packages add theirs with an entry point in the group ``frenetic.strategies``,
``frenetic.drivers`` or ``frenetic.simulators``.
"""

from __future__ import annotations

import difflib
import importlib
import inspect
import re
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import redirect_stdout, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from frenetic._support.entry_points import Entry, installed
from frenetic.criteria.criterion import QUANTITIES
from frenetic.errors import FreneticError, UnknownNameError, describe_raised, place_of
from frenetic.parts.user_modules import load_own_module, load_user_file


def options_of(part: object) -> Mapping[str, Any] | None:
    """The options that a part was made with; None if it does not say."""
    options = getattr(part, "options", None)
    return options if isinstance(options, Mapping) else None


@dataclass(frozen=True)
class Made:
    """How a part of a name is made."""

    factory: Callable[..., Any]
    """Its class, or a function."""
    arguments: Mapping[str, Any]
    """Name -> value of each argument, defaults included."""


def arguments_of(part: object) -> dict[str, Any]:
    """The arguments of an object's constructor that it keeps as attributes.

    An attribute has the name of the argument, or this name after an underscore.
    """
    arguments = {}
    for name in (parameter.name for parameter in _parameters(type(part))):
        for attribute in (name, f"_{name}"):
            try:
                arguments[name] = getattr(part, attribute)
                break
            except Exception:  # noqa: S112  # a foreign attribute may raise anything
                continue
    return arguments


def _parameters(factory: Callable[..., Any]) -> list[inspect.Parameter]:
    """A factory's parameters that have a name and a kind of their own, as far as it shows them."""
    try:
        parameters = inspect.signature(factory).parameters.values()
    except (TypeError, ValueError):
        return []
    return [p for p in parameters if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY)]


@dataclass(frozen=True)
class Registry:
    """The known names of one kind of part."""

    kind: str
    """Word for the kind: strategy, driver, simulator."""
    group: str
    """Entry-point group."""
    built_in: Mapping[str, tuple[str, str]]
    """Name -> (``module:Class``, summary)."""
    methods: tuple[str, ...]
    """Methods that an object of this kind must have."""
    target: str = "class"
    """Word for what a user's own spec names: class or function."""

    def entries(self) -> list[Entry]:
        """All names: the built-in ones, then the installed ones in alphabetical order.

        Raises:
            FreneticError: an installed package claims a name that is already taken.
        """
        found = {
            name: Entry(name, target, "built in", summary)
            for name, (target, summary) in self.built_in.items()
        }
        for entry in installed(self.group):
            if entry.name.startswith("."):
                continue
            if entry.name in found:
                raise FreneticError(
                    f"two {self.kind} entries are named {entry.name!r}: one is"
                    f" {found[entry.name].origin}, one comes from {entry.origin}; uninstall one of"
                    " them"
                )
            found[entry.name] = entry
        return list(found.values())

    @property
    def files(self) -> Mapping[str, str]:
        """End of a file's name -> ``module:Class`` that is made of such a file.

        The file is its first argument. A package adds one by an entry point that is called like the
        end, such as ``.onnx``.
        """
        return {one.name: one.target for one in installed(self.group) if one.name.startswith(".")}

    def about(self, entry: Entry) -> str:
        """A line about a part: of an installed one the beginning of its docstring, or its place."""
        if entry.summary:
            return entry.summary
        with suppress(FreneticError):
            text = inspect.getdoc(self.load(entry.name)) or ""
            return text.partition("\n")[0].rstrip(".") or entry.target
        return entry.target

    def is_own(self, spec: str) -> bool:
        """Whether a name stands for code that is not ours; nothing is imported."""
        target = {entry.name: entry.target for entry in self.entries()}.get(spec, spec)
        module, separator, _ = target.rpartition(":")
        if not separator or Path(spec).suffix.lower() in self.files:
            return False
        return module.endswith(".py") or module.partition(".")[0] != "frenetic"

    def load(self, spec: str) -> Callable[..., Any]:
        """The class (or factory) of a name, ``module:Class``, ``file.py:Class`` or a file of data.

        Relative files and the user's modules go from the current folder.

        Raises:
            UnknownNameError: no such name; the message lists the known ones.
            FreneticError: the module, file or class cannot be loaded.
        """
        known = {entry.name: entry for entry in self.entries()}
        if spec in known:
            return self._import(known[spec].target, spec)
        if (suffix := Path(spec).suffix.lower()) in self.files:
            return partial(self._import(self.files[suffix], spec), spec)
        if ":" in spec:
            place, _, attribute = spec.rpartition(":")
            if Path(place).suffix.lower() in self.files:
                raise FreneticError(
                    f"{self.kind} {spec!r}: a file of data has no {self.target} {attribute!r}: name"
                    f" the file alone, {place}"
                )
            return self._import(spec, spec, own=True)
        files = "".join(f" or path/to/file{suffix}" for suffix in self.files)
        word = self.target.capitalize()
        if spec.endswith(".py"):
            raise UnknownNameError(
                f"{spec} names no {self.target} in the file: add it, {spec}:{word}"
            )
        raise UnknownNameError(
            f"unknown {self.kind} {spec!r}{hint(spec, known)} Known: {', '.join(known)};"
            f" your own goes as package.module:{word} or path/to/file.py:{word}{files}"
        )

    def absolute(
        self, name: str, options: Mapping[str, Any], folder: Path | str
    ) -> tuple[str, dict[str, Any]]:
        """Name and options of a part whose files go from a folder, for use in another folder.

        Raises:
            FreneticError: it is a module of the user's own, which no other folder finds.
        """
        options = absolute_files(options, folder)
        place, _, attribute = name.rpartition(":")
        if name in {entry.name for entry in self.entries()}:
            return name, options
        if place.endswith(".py"):
            return f"{_path_in(folder, place).absolute()}:{attribute}", options
        if Path(name).suffix.lower() in self.files:
            return str(_path_in(folder, name).absolute()), options
        raise FreneticError(
            f"the {self.kind} {name!r} is a module, which would be imported from {folder},"
            " and another part is loaded from another folder: name its file, such as"
            " path/to/file.py:Class"
        )

    def make(self, spec: str, /, **options: Any) -> Any:
        """An instance of the part that `spec` names, made with the given options.

        Args:
            spec: which part.
            options: of its class.

        Raises:
            FreneticError: as `load`; or the options do not suit, or it lacks a needed method.
        """
        return self._make(self.load(spec), spec, options)

    def _make(self, factory: Callable[..., Any], spec: str, options: Mapping[str, Any]) -> Any:
        self._check_options(factory, spec, options)
        if missing := [name for name in self.needs(factory) if name not in options]:
            raise FreneticError(f"{self.kind} {spec!r} needs the option {' and '.join(missing)}")
        try:
            with redirect_stdout(sys.stderr):  # stdout is for results
                made = factory(**options)
        except (TypeError, ValueError, ArithmeticError) as error:
            # An error about a type seldom names the option.
            if isinstance(error, TypeError) and self.option_names(factory) is not None:
                self._check_kinds(factory, spec, options, {"int", "float", "None"}, "a number")
            given = ", ".join(f"{name}={value!r}" for name, value in options.items())
            which = f" with {given}" if isinstance(error, TypeError) and given else ""
            place = f" ({at})" if (at := place_of(error)) else ""
            raise FreneticError(f"{self.kind} {spec!r}{which}: {_line(error)}{place}") from error
        except FreneticError:
            raise
        except (Exception, SystemExit) as error:
            raise FreneticError(
                f"{self.kind} {spec!r} cannot be made: {describe_raised(error)}"
            ) from error
        missing = [name for name in self.methods if not callable(getattr(made, name, None))]
        if missing:
            raise FreneticError(
                f"{spec!r} is no {self.kind}: it has no method {' and no method '.join(missing)}"
            )
        return made

    def make_from(
        self, spec: str, options: Mapping[str, Any], available: Mapping[str, object]
    ) -> Any:
        """An instance made with the given options and those available ones that its class takes.

        Args:
            spec: which part.
            options: given ones.
            available: others.

        Raises:
            FreneticError: as `make`; or an option is one of those that are available.
        """
        factory = self.load(spec)
        return self._make(factory, spec, self._taken(factory, options, available))

    def made(self, spec: str, options: Mapping[str, Any], available: Mapping[str, object]) -> Made:
        """How `make_from` makes a part; raises as it does before the part is made."""
        factory = self.load(spec)
        arguments = self._taken(factory, options, available)
        try:
            bound = inspect.signature(factory).bind(**arguments)
        except (TypeError, ValueError):  # it hides what it takes
            return Made(factory, arguments)
        bound.apply_defaults()
        named = {p.name: bound.arguments[p.name] for p in _parameters(factory)}
        return Made(factory, named | arguments)

    def _taken(
        self,
        factory: Callable[..., Any],
        options: Mapping[str, Any],
        available: Mapping[str, object],
    ) -> dict[str, Any]:
        """The given options and those available ones that a factory takes."""
        for name in options:
            if name in available:
                raise FreneticError(
                    f"the option {name} of the {self.kind} is not allowed: it follows from the"
                    " options of the command"
                )
        takes = self.option_names(factory)
        return {**options, **{k: v for k, v in available.items() if takes is None or k in takes}}

    def needs(self, factory: Callable[..., Any]) -> list[str]:
        """Names of the options without which a factory makes nothing, as far as it shows them."""
        return [p.name for p in _parameters(factory) if p.default is p.empty]

    def option_names(self, factory: Callable[..., Any]) -> list[str] | None:
        """Names of a factory's options, None if it takes any or hides them."""
        try:
            parameters = inspect.signature(factory).parameters.values()
        except (TypeError, ValueError):
            return None
        if any(p.kind is p.VAR_KEYWORD for p in parameters):
            return None
        return [p.name for p in _parameters(factory)]

    def _check_options(
        self, factory: Callable[..., Any], spec: str, options: Mapping[str, Any]
    ) -> None:
        names = self.option_names(factory)
        for given in options:
            if names is not None and given not in names:
                raise FreneticError(
                    f"{self.kind} {spec!r} has no option {given!r}{hint(given, names)}"
                    f" It has: {', '.join(names) or 'none'}"
                )
        if names is not None:
            self._check_kinds(factory, spec, options, {"bool", "None"}, "true or false")

    def _check_kinds(
        self,
        factory: Callable[..., Any],
        spec: str,
        options: Mapping[str, Any],
        kinds: set[str],
        needed: str,
    ) -> None:
        """Refuses texts, and numbers for truth values, where a parameter takes these kinds only."""
        refused = (str, int) if "bool" in kinds else str
        parameters = inspect.signature(factory).parameters
        for name, value in options.items():
            # A text where annotations are not evaluated.
            wanted = inspect.formatannotation(parameters[name].annotation).strip("'")
            if (
                kinds.issuperset(re.split(r"[ |]+", wanted))
                and isinstance(value, refused)
                and not isinstance(value, bool)
            ):
                raise FreneticError(
                    f"{self.kind} {spec!r}: {name} is {value!r}: {needed} is needed"
                )

    def _import(self, target: str, spec: str, own: bool = False) -> Callable[..., Any]:
        place, _, attribute = target.rpartition(":")
        try:
            with redirect_stdout(sys.stderr):  # stdout is for results
                if place.endswith(".py"):
                    module = load_user_file(place)
                elif own:
                    module = load_own_module(place)
                else:
                    module = importlib.import_module(place)
        except FreneticError:
            raise
        except ModuleNotFoundError as error:
            raise FreneticError(
                f"{self.kind} {spec!r}: there is no module {error.name!r}; is it installed, or in"
                " the current folder?"
            ) from error
        except (Exception, SystemExit) as error:
            raise FreneticError(
                f"{self.kind} {spec!r}: importing it raised {describe_raised(error)}"
            ) from error
        found = getattr(module, attribute, None)
        if not callable(found):
            names = _defined_names(module, with_classes=self.target == "class")
            which = f"no {self.target} {attribute!r}{hint(attribute, names)}"
            raise FreneticError(
                f"{self.kind} {spec!r}: {place} has {which} It defines:"
                f" {', '.join(names) or 'none'}"
            )
        made: Callable[..., Any] = found
        return made


def _defined_names(module: ModuleType, *, with_classes: bool) -> list[str]:
    """Public names of the functions, and classes, that a module or its package defines itself."""
    return [
        name
        for name, value in vars(module).items()
        if (inspect.isfunction(value) or (with_classes and inspect.isclass(value)))
        and not name.startswith("_")
        and f"{value.__module__}.".startswith(f"{module.__name__}.")
    ]


def hint(given: str, known: Iterable[str]) -> str:
    """The end of a sentence: a full stop, or a question for the close match."""
    close = difflib.get_close_matches(given, list(known), n=1)
    return f"; did you mean {close[0]!r}?" if close else "."


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _path_in(folder: Path | str, name: str) -> Path:
    """A user's file, from a folder."""
    return Path(folder, Path(name).expanduser())


def absolute_files(options: Mapping[str, Any], folder: Path | str) -> dict[str, Any]:
    """Options of a part, in which files that are there, from a folder, have absolute paths."""
    return {
        option: str(file.absolute())
        if isinstance(value, str) and value and (file := _path_in(folder, value)).exists()
        else value
        for option, value in options.items()
    }


STRATEGIES: Final = Registry(
    "strategy",
    "frenetic.strategies",
    {
        "frenetic": (
            "frenetic.search:Frenetic",
            "roads that fail as no known failure does, from an archive of what was driven;"
            " the default",
        ),
        "frenetic-2021": (
            "frenetic.search:Frenetic2021",
            "random roads, then mutants and crossovers of the worst (Castellano et al., 2021)",
        ),
        "random": ("frenetic.search:RandomSearch", "random roads only, the baseline"),
    },
    ("ask", "tell"),
)

DRIVERS: Final = Registry(
    "driver",
    "frenetic.drivers",
    {
        "planner": (
            "frenetic.drivers:Planner",
            "knows the road ahead, speed from curvature, pure-pursuit steering; the default",
        ),
        "stanley": ("frenetic.drivers:Stanley", "the same speed plan, Stanley's steering law"),
        "beamng-ai": (
            "frenetic.drivers:BeamngAi",
            "a model of BeamNG.AI, fitted to recorded drives; in the simulator beamng, BeamNG.AI",
        ),
    },
    ("reset", "act"),
)

OBJECTIVES: Final = Registry(
    "objective",
    "frenetic.objectives",
    {
        "moobd": ("frenetic.campaign.objective:moobd", "minimum oob distance, lower is worse"),
        "oob-share": (
            "frenetic.campaign.objective:oob_share",
            "largest share of the car outside its lane, higher is worse",
        ),
        "criteria": (
            "frenetic.campaign.objective:criteria",
            "least distance from the limits of the criteria, in shares, lower is worse; the default"
            " with --criteria",
        ),
        **{
            one.name.replace("_", "-"): (
                f"frenetic.campaign.objective:{one.name}",
                f"{one.about}, in {one.unit}, {'lower' if one.is_least else 'higher'} is worse",
            )
            for one in QUANTITIES.values()
        },
    },
    (),
    target="function",
)

SIMULATORS: Final = Registry(
    "simulator",
    "frenetic.simulators",
    {
        "embedded": (
            "frenetic.simulators:EmbeddedSimulator",
            "a dynamic single-track car in compiled code, headless",
        ),
    },
    ("drive", "__enter__", "__exit__"),
)


def part_name(described: object) -> str:
    """Return the name of a described part as the command line takes it.

    A driver made of a file has the file's name, and what is not ours that of its class.
    """
    part = described if isinstance(described, Mapping) else {}
    module, _, kind = str(part.get("class", "")).rpartition(":")
    for registry in (STRATEGIES, DRIVERS, SIMULATORS):
        named = {entry.name: entry.target for entry in registry.entries()}
        for name, target in {**named, **registry.files}.items():
            package, _, attribute = target.partition(":")
            if kind == attribute and f"{module}.".startswith(f"{package}."):
                options = part.get("options")
                texts = map(str, options.values()) if isinstance(options, Mapping) else ()
                made_of = (text for text in texts if text.lower().endswith(name))
                return name if name in named else re.split(r"[/\\]", next(made_of, kind))[-1]
    return kind or "unknown"
