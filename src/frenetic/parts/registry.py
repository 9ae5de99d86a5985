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

from frenetic._support.entry_points import RegisteredPart, installed
from frenetic.criteria.criterion import SIGNALS
from frenetic.errors import FreneticError, UnknownNameError, describe_raised, place_of
from frenetic.parts.user_modules import load_own_module, load_user_file


def options_of(part: object) -> Mapping[str, Any] | None:
    """Return the options of a part; None if the part does not keep them."""
    options = getattr(part, "options", None)
    return options if isinstance(options, Mapping) else None


@dataclass(frozen=True)
class Construction:
    """The call that makes a part of its name."""

    factory: Callable[..., Any]
    """Class of the part, or a function."""
    arguments: Mapping[str, Any]
    """Name -> value of each argument, with defaults."""


def arguments_of(part: object) -> dict[str, Any]:
    """Return the arguments of an object's constructor that it keeps as attributes.

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
    """Return a factory's named parameters, as far as its signature shows them."""
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
    """RegisteredPart-point group."""
    built_in: Mapping[str, tuple[str, str]]
    """Name -> (``module:Class``, summary)."""
    methods: tuple[str, ...]
    """Methods that an object of this kind must have."""
    target: str = "class"
    """Word for the code that a user's name refers to: class or function."""

    def entries(self) -> list[RegisteredPart]:
        """Return all entries: built-in ones, then installed ones in alphabetical order.

        Raises:
            FreneticError: an installed package claims a name that is already taken.
        """
        entries = {
            name: RegisteredPart(name, target, "built in", summary)
            for name, (target, summary) in self.built_in.items()
        }
        for entry in installed(self.group):
            if entry.name.startswith("."):
                continue
            if entry.name in entries:
                raise FreneticError(
                    f"two {self.kind} entries are named {entry.name!r}: one is"
                    f" {entries[entry.name].origin}, one comes from {entry.origin}; uninstall one"
                    " of them"
                )
            entries[entry.name] = entry
        return list(entries.values())

    @property
    def files(self) -> Mapping[str, str]:
        """End of a file's name -> ``module:Class`` that is made of such a file.

        The class takes the file as its first argument. A package adds a kind of file by an entry
        point with the name of the end, such as ``.onnx``.
        """
        entries = installed(self.group)
        return {entry.name: entry.target for entry in entries if entry.name.startswith(".")}

    def about(self, entry: RegisteredPart) -> str:
        """Return a line about a part: its summary, or its docstring's first line, or its target."""
        if entry.summary:
            return entry.summary
        with suppress(FreneticError):
            text = inspect.getdoc(self.load(entry.name)) or ""
            return text.partition("\n")[0].rstrip(".") or entry.target
        return entry.target

    def is_own(self, name: str) -> bool:
        """Return whether a name stands for code that is not ours; import nothing."""
        target = {entry.name: entry.target for entry in self.entries()}.get(name, name)
        module, separator, _ = target.rpartition(":")
        if not separator or Path(name).suffix.lower() in self.files:
            return False
        return module.endswith(".py") or module.partition(".")[0] != "frenetic"

    def load(self, name: str) -> Callable[..., Any]:
        """Return the class or factory of a name, ``module:Class``, ``file.py:Class`` or data file.

        Relative files and the user's modules are looked for in the current folder.

        Raises:
            UnknownNameError: no part has this name; the message lists the known names.
            FreneticError: the module, file or class cannot be loaded.
        """
        known = {entry.name: entry for entry in self.entries()}
        if name in known:
            return self._import(known[name].target, name)
        if (suffix := Path(name).suffix.lower()) in self.files:
            return partial(self._import(self.files[suffix], name), name)
        if ":" in name:
            place, _, attribute = name.rpartition(":")
            if Path(place).suffix.lower() in self.files:
                raise FreneticError(
                    f"{self.kind} {name!r}: a file of data has no {self.target} {attribute!r}: name"
                    f" the file alone, {place}"
                )
            return self._import(name, name, is_users=True)
        files = "".join(f" or path/to/file{suffix}" for suffix in self.files)
        word = self.target.capitalize()
        if name.endswith(".py"):
            raise UnknownNameError(
                f"{name} names no {self.target} in the file: add it, {name}:{word}"
            )
        raise UnknownNameError(
            f"unknown {self.kind} {name!r}{hint(name, known)} Known: {', '.join(known)};"
            f" your own goes as package.module:{word} or path/to/file.py:{word}{files}"
        )

    def absolute(
        self, name: str, options: Mapping[str, Any], folder: Path | str
    ) -> tuple[str, dict[str, Any]]:
        """Return name and options of a part with absolute paths, for use in another folder.

        Args:
            name: of the part.
            options: of the part.
            folder: from which relative paths go.

        Raises:
            FreneticError: the part is a module of the user's own, which no other folder finds.
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

    def make(self, name: str, /, **options: Any) -> Any:
        """Return a part of a name, made with the options.

        Args:
            name: of the part.
            options: of its class.

        Raises:
            FreneticError: as `load`; or the options do not suit, or the part lacks a method.
        """
        return self._make(self.load(name), name, options)

    def _make(self, factory: Callable[..., Any], name: str, options: Mapping[str, Any]) -> Any:
        self._check_options(factory, name, options)
        if missing := [option for option in self.needs(factory) if option not in options]:
            raise FreneticError(f"{self.kind} {name!r} needs the option {' and '.join(missing)}")
        try:
            with redirect_stdout(sys.stderr):  # stdout is for results
                part = factory(**options)
        except (TypeError, ValueError, ArithmeticError) as error:
            # An error about a type seldom names the option.
            if isinstance(error, TypeError) and self.option_names(factory) is not None:
                self._check_kinds(factory, name, options, {"int", "float", "None"}, "a number")
            texts = ", ".join(f"{option}={value!r}" for option, value in options.items())
            which = f" with {texts}" if isinstance(error, TypeError) and texts else ""
            place = f" ({at})" if (at := place_of(error)) else ""
            raise FreneticError(f"{self.kind} {name!r}{which}: {_line(error)}{place}") from error
        except FreneticError:
            raise
        except (Exception, SystemExit) as error:
            raise FreneticError(
                f"{self.kind} {name!r} cannot be made: {describe_raised(error)}"
            ) from error
        missing = [method for method in self.methods if not callable(getattr(part, method, None))]
        if missing:
            raise FreneticError(
                f"{name!r} is no {self.kind}: it has no method {' and no method '.join(missing)}"
            )
        return part

    def make_from(
        self, name: str, options: Mapping[str, Any], available: Mapping[str, object]
    ) -> Any:
        """Return a part made with options, and with those available options that its class takes.

        Args:
            name: of the part.
            options: of its user.
            available: further options, by name.

        Raises:
            FreneticError: as `make`; or the user sets an available option.
        """
        factory = self.load(name)
        return self._make(factory, name, self._taken(factory, options, available))

    def construction(
        self, name: str, options: Mapping[str, Any], available: Mapping[str, object]
    ) -> Construction:
        """Return the call with which `make_from` makes a part; raise what it raises before."""
        factory = self.load(name)
        arguments = self._taken(factory, options, available)
        try:
            bound = inspect.signature(factory).bind(**arguments)
        except (TypeError, ValueError):  # it hides its parameters
            return Construction(factory, arguments)
        bound.apply_defaults()
        bound_arguments = {p.name: bound.arguments[p.name] for p in _parameters(factory)}
        return Construction(factory, bound_arguments | arguments)

    def _taken(
        self,
        factory: Callable[..., Any],
        options: Mapping[str, Any],
        available: Mapping[str, object],
    ) -> dict[str, Any]:
        """Return the options, and those available options that a factory takes."""
        for option in options:
            if option in available:
                raise FreneticError(
                    f"the option {option} of the {self.kind} is not allowed: it follows from the"
                    " options of the command"
                )
        takes = self.option_names(factory)
        return {**options, **{k: v for k, v in available.items() if takes is None or k in takes}}

    def needs(self, factory: Callable[..., Any]) -> list[str]:
        """Return the names of options without a default, as far as the factory shows them."""
        return [p.name for p in _parameters(factory) if p.default is p.empty]

    def option_names(self, factory: Callable[..., Any]) -> list[str] | None:
        """Return the names of a factory's options; None if it takes any or hides them."""
        try:
            parameters = inspect.signature(factory).parameters.values()
        except (TypeError, ValueError):
            return None
        if any(p.kind is p.VAR_KEYWORD for p in parameters):
            return None
        return [p.name for p in _parameters(factory)]

    def _check_options(
        self, factory: Callable[..., Any], name: str, options: Mapping[str, Any]
    ) -> None:
        names = self.option_names(factory)
        for option in options:
            if names is not None and option not in names:
                raise FreneticError(
                    f"{self.kind} {name!r} has no option {option!r}{hint(option, names)}"
                    f" It has: {', '.join(names) or 'none'}"
                )
        if names is not None:
            self._check_kinds(factory, name, options, {"bool", "None"}, "true or false")

    def _check_kinds(
        self,
        factory: Callable[..., Any],
        name: str,
        options: Mapping[str, Any],
        kinds: set[str],
        needed: str,
    ) -> None:
        """Refuse texts, and numbers for truth values, where a parameter takes these kinds only."""
        refused = (str, int) if "bool" in kinds else str
        parameters = inspect.signature(factory).parameters
        for option, value in options.items():
            # A text where annotations are not evaluated.
            wanted = inspect.formatannotation(parameters[option].annotation).strip("'")
            if (
                kinds.issuperset(re.split(r"[ |]+", wanted))
                and isinstance(value, refused)
                and not isinstance(value, bool)
            ):
                raise FreneticError(
                    f"{self.kind} {name!r}: {option} is {value!r}: {needed} is needed"
                )

    def _import(self, target: str, name: str, is_users: bool = False) -> Callable[..., Any]:
        place, _, attribute = target.rpartition(":")
        try:
            with redirect_stdout(sys.stderr):  # stdout is for results
                if place.endswith(".py"):
                    module = load_user_file(place)
                elif is_users:
                    module = load_own_module(place)
                else:
                    module = importlib.import_module(place)
        except FreneticError:
            raise
        except ModuleNotFoundError as error:
            raise FreneticError(
                f"{self.kind} {name!r}: there is no module {error.name!r}; is it installed, or in"
                " the current folder?"
            ) from error
        except (Exception, SystemExit) as error:
            raise FreneticError(
                f"{self.kind} {name!r}: importing it raised {describe_raised(error)}"
            ) from error
        value: Any = getattr(module, attribute, None)
        if not callable(value):
            names = _defined_names(module, with_classes=self.target == "class")
            which = f"no {self.target} {attribute!r}{hint(attribute, names)}"
            raise FreneticError(
                f"{self.kind} {name!r}: {place} has {which} It defines:"
                f" {', '.join(names) or 'none'}"
            )
        factory: Callable[..., Any] = value
        return factory


def _defined_names(module: ModuleType, *, with_classes: bool) -> list[str]:
    """Return public names of the functions, and classes, that a module or its package defines."""
    return [
        name
        for name, value in vars(module).items()
        if (inspect.isfunction(value) or (with_classes and inspect.isclass(value)))
        and not name.startswith("_")
        and f"{value.__module__}.".startswith(f"{module.__name__}.")
    ]


def hint(name: str, known: Iterable[str]) -> str:
    """Return the end of a sentence: a full stop, or a question for the close match."""
    close = difflib.get_close_matches(name, list(known), n=1)
    return f"; did you mean {close[0]!r}?" if close else "."


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _path_in(folder: Path | str, name: str) -> Path:
    """Return the path of a user's file, which may be relative to a folder."""
    return Path(folder, Path(name).expanduser())


def absolute_files(options: Mapping[str, Any], folder: Path | str) -> dict[str, Any]:
    """Return options with absolute paths of the files that exist."""
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
            signal.name.replace("_", "-"): (
                f"frenetic.campaign.objective:{signal.name}",
                f"{signal.about}, in {signal.unit},"
                f" {'lower' if signal.is_least else 'higher'} is worse",
            )
            for signal in SIGNALS.values()
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


def part_name(record: object) -> str:
    """Return the name of a described part as the command line takes it.

    A driver made of a file has the file's name, another part of a user's own its class's name.
    """
    part = record if isinstance(record, Mapping) else {}
    module, _, kind = str(part.get("class", "")).rpartition(":")
    for registry in (STRATEGIES, DRIVERS, SIMULATORS):
        targets = {entry.name: entry.target for entry in registry.entries()}
        for name, target in {**targets, **registry.files}.items():
            package, _, attribute = target.partition(":")
            if kind == attribute and f"{module}.".startswith(f"{package}."):
                options = part.get("options")
                texts = map(str, options.values()) if isinstance(options, Mapping) else ()
                files = (text for text in texts if text.lower().endswith(name))
                return name if name in targets else re.split(r"[/\\]", next(files, kind))[-1]
    return kind or "unknown"
