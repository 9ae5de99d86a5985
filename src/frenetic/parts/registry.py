"""Registries of strategies, drivers, simulators and objectives.

A registry finds a part by its name: built in, installed by others, or in a user's own file. Each
name stands for a target ``module:Class``, which is imported on use: listing names imports nothing.
Other packages add their parts with an entry point in the group ``frenetic.strategies``,
``frenetic.drivers``, ``frenetic.simulators`` or ``frenetic.objectives``.
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
from frenetic._support.option_text import COMMAND
from frenetic.criteria.criterion import SIGNALS
from frenetic.errors import FreneticError, UnknownNameError, describe_raised, place_of
from frenetic.parts.construction import (
    Construction,
    named_parameters,
    option_names,
    required_options,
)
from frenetic.parts.paths import absolute_files, path_in
from frenetic.parts.user_modules import load_own_module, load_user_file


@dataclass(frozen=True)
class Registry:
    """The known names of one kind of part."""

    kind: str
    """Word for the kind: strategy, driver, simulator or objective."""
    group: str
    """Group of the entry points with which other packages register their parts."""
    built_in: Mapping[str, tuple[str, str]]
    """Name -> (``module:Class``, summary)."""
    methods: tuple[str, ...]
    """Methods that an object of this kind must have."""
    target: str = "class"
    """Word for the code that a user's name refers to: class or function."""

    def entries(self) -> list[RegisteredPart]:
        """Return the built-in entries, then the installed ones in alphabetical order.

        Raises:
            FreneticError: an installed package claims a name that is already taken.
        """
        entries = {
            name: RegisteredPart(name, target, "built in", summary)
            for name, (target, summary) in self.built_in.items()
        }
        for entry in installed(self.group):
            if entry.name.startswith("."):  # a kind of file, see `files`
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
        """Suffix of a data file -> target ``module:Class`` of the part that is made of such a file.

        The class takes the file's path as its first argument. A package adds a kind of file with an
        entry point whose name is the suffix, such as ``.onnx``.
        """
        entries = installed(self.group)
        return {entry.name: entry.target for entry in entries if entry.name.startswith(".")}

    def summary_of(self, entry: RegisteredPart) -> str:
        """Return a part's summary; without one its docstring's first line, else its target."""
        if entry.summary:
            return entry.summary
        with suppress(FreneticError):
            text = inspect.getdoc(self.load(entry.name)) or ""
            return text.partition("\n")[0].rstrip(".") or entry.target
        return entry.target

    def is_own(self, name: str) -> bool:
        """Return whether a name stands for code outside the package `frenetic`; import nothing.

        A data file is no code.
        """
        target = {entry.name: entry.target for entry in self.entries()}.get(name, name)
        module, separator, _ = target.rpartition(":")
        if not separator or Path(name).suffix.lower() in self.files:
            return False
        return module.endswith(".py") or module.partition(".")[0] != "frenetic"

    def load(self, name: str) -> Callable[..., Any]:
        """Return the class or factory that a name, a target or a data file stands for.

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
            source, _, attribute = name.rpartition(":")
            if Path(source).suffix.lower() in self.files:
                raise FreneticError(
                    f"{self.kind} {name!r}: a file of data has no {self.target} {attribute!r}: name"
                    f" the file alone, {source}"
                )
            return self._import(name, name, is_users=True)
        word = self.target.capitalize()
        if name.endswith(".py"):
            raise UnknownNameError(
                f"{name} names no {self.target} in the file: add it, {name}:{word}"
            )
        raise UnknownNameError(
            f"unknown {self.kind} {name!r}{hint(name, known)} Known: {', '.join(known)};"
            f" your own goes as {self.own_names}"
        )

    @property
    def own_names(self) -> str:
        """Forms of a name that stands for a user's own part, in words."""
        word = self.target.capitalize()
        forms = [f"package.module:{word}", f"path/to/file.py:{word}"]
        forms += [f"path/to/file{suffix}" for suffix in self.files]
        forms += [f"{COMMAND}:./program"] if COMMAND in self.built_in else []
        return " or ".join(forms)

    def absolute(
        self, name: str, options: Mapping[str, Any], folder: Path | str
    ) -> tuple[str, dict[str, Any]]:
        """Return name and options of a part with absolute paths, for use in another folder.

        Args:
            name: name of the part.
            options: options of the part.
            folder: folder to which relative paths in the name and the options refer.

        Raises:
            FreneticError: the name is a module of the user's, which is not found from elsewhere.
        """
        options = absolute_files(options, folder)
        source, _, attribute = name.rpartition(":")
        if name in {entry.name for entry in self.entries()}:
            return name, options
        if source.endswith(".py"):
            return f"{path_in(folder, source).absolute()}:{attribute}", options
        if Path(name).suffix.lower() in self.files:
            return str(path_in(folder, name).absolute()), options
        raise FreneticError(
            f"the {self.kind} {name!r} is a module, which would be imported from {folder},"
            " and another part is loaded from another folder: name its file, such as"
            " path/to/file.py:Class"
        )

    def make(self, name: str, /, **options: Any) -> Any:
        """Make the part that a name stands for.

        Args:
            name: name of the part, as `load` takes it.
            options: options of the part's class.

        Raises:
            FreneticError: the name cannot be loaded, an option does not suit, or the part lacks a
                method.
        """
        return self._make(self.load(name), name, options)

    def _make(self, factory: Callable[..., Any], name: str, options: Mapping[str, Any]) -> Any:
        self._check_options(factory, name, options)
        try:
            with redirect_stdout(sys.stderr):  # stdout is for results
                part = factory(**options)
        except (TypeError, ValueError, ArithmeticError) as error:
            raise self._refusal(factory, name, options, error) from error
        except FreneticError:  # it says itself what is wrong
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

    def _refusal(
        self, factory: Callable[..., Any], name: str, options: Mapping[str, Any], error: Exception
    ) -> FreneticError:
        """Return the message for options that a factory refused with an error."""
        option_texts = ""
        if isinstance(error, TypeError):  # which seldom names the option
            if option_names(factory) is not None:
                self._require_types(factory, name, options, {"int", "float", "None"}, "a number")
            option_texts = ", ".join(f"{option}={value!r}" for option, value in options.items())
        which = f" with {option_texts}" if option_texts else ""
        where = f" ({place})" if (place := place_of(error)) else ""
        return FreneticError(f"{self.kind} {name!r}{which}: {_one_line(error)}{where}")

    def make_from(
        self, name: str, options: Mapping[str, Any], available: Mapping[str, object]
    ) -> Any:
        """Make a part with its user's options and those available options that its class takes.

        Args:
            name: name of the part, as `load` takes it.
            options: options that the user sets.
            available: options that follow from the campaign, such as the seed, by name.

        Raises:
            FreneticError: as for `make`, or the user sets an available option.
        """
        factory = self.load(name)
        return self._make(factory, name, self._arguments(factory, options, available))

    def construction(
        self, name: str, options: Mapping[str, Any], available: Mapping[str, object]
    ) -> Construction:
        """Return the call with which `make_from` makes a part, without making it.

        Raises:
            FreneticError: the name cannot be loaded, or the user sets an available option.
        """
        factory = self.load(name)
        arguments = self._arguments(factory, options, available)
        try:
            bound = inspect.signature(factory).bind(**arguments)
        except (TypeError, ValueError):  # the factory hides its parameters, or refuses these
            return Construction(factory, arguments)
        bound.apply_defaults()
        bound_arguments = {p.name: bound.arguments[p.name] for p in named_parameters(factory)}
        return Construction(factory, bound_arguments | arguments)

    def _arguments(
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
        names = option_names(factory)
        taken = {k: v for k, v in available.items() if names is None or k in names}
        return {**options, **taken}

    def _check_options(
        self, factory: Callable[..., Any], name: str, options: Mapping[str, Any]
    ) -> None:
        """Check that a factory has the options, that none is missing, and truth values.

        Raises:
            FreneticError: an option is unknown or missing, or no truth value where it has to be.
        """
        names = option_names(factory)
        for option in options:
            if names is not None and option not in names:
                raise FreneticError(
                    f"{self.kind} {name!r} has no option {option!r}{hint(option, names)}"
                    f" It has: {', '.join(names) or 'none'}"
                )
        if names is not None:
            self._require_types(factory, name, options, {"bool", "None"}, "true or false")
        if missing := [option for option in required_options(factory) if option not in options]:
            raise FreneticError(f"{self.kind} {name!r} needs the option {' and '.join(missing)}")

    def _require_types(
        self,
        factory: Callable[..., Any],
        name: str,
        options: Mapping[str, Any],
        types: set[str],
        expected: str,
    ) -> None:
        """Check the options whose annotations allow these types alone.

        Args:
            factory: factory that shows its parameters.
            name: name of the part, for the message.
            options: options of the factory.
            types: names of types, as annotations have them.
            expected: the types in words, for the message.

        Raises:
            FreneticError: an option is a text, or a number where a truth value is expected.
        """
        refused = (str, int) if "bool" in types else str
        parameters = inspect.signature(factory).parameters
        for option, value in options.items():
            # With `from __future__ import annotations` an annotation is a text.
            annotation = inspect.formatannotation(parameters[option].annotation).strip("'")
            if (
                types.issuperset(re.split(r"[ |]+", annotation))
                and isinstance(value, refused)
                and not isinstance(value, bool)
            ):
                raise FreneticError(
                    f"{self.kind} {name!r}: {option} is {value!r}: {expected} is needed"
                )

    def _import(self, target: str, name: str, *, is_users: bool = False) -> Callable[..., Any]:
        """Return the class or factory of a target.

        Args:
            target: ``module:Class`` or ``file.py:Class``.
            name: name of the part, for messages.
            is_users: whether the user named the target, whose module may lie in the current folder.
        """
        source, _, attribute = target.rpartition(":")
        try:
            with redirect_stdout(sys.stderr):  # stdout is for results
                if source.endswith(".py"):
                    module = load_user_file(source)
                elif is_users:
                    module = load_own_module(source)
                else:
                    module = importlib.import_module(source)
        except FreneticError:  # it says itself what is wrong
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
                f"{self.kind} {name!r}: {source} has {which} It defines:"
                f" {', '.join(names) or 'none'}"
            )
        factory: Callable[..., Any] = value
        return factory


def _defined_names(module: ModuleType, *, with_classes: bool) -> list[str]:
    """Return the public functions of a module, and its classes if asked, but no imported names."""
    return [
        name
        for name, value in vars(module).items()
        if (inspect.isfunction(value) or (with_classes and inspect.isclass(value)))
        and not name.startswith("_")
        and f"{value.__module__}.".startswith(f"{module.__name__}.")
    ]


def hint(name: str, known: Iterable[str]) -> str:
    """Return the end of a sentence about an unknown name.

    The end is ``; did you mean 'planner'?`` if a known name is close, else a full stop.
    """
    close = difflib.get_close_matches(name, list(known), n=1)
    return f"; did you mean {close[0]!r}?" if close else "."


def _one_line(error: BaseException) -> str:
    """Return the text of an error on one line; its class if it has no text."""
    return " ".join(str(error).split()) or type(error).__name__


STRATEGIES: Final = Registry(
    kind="strategy",
    group="frenetic.strategies",
    built_in={
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
        "sweep": ("frenetic.search:Sweep", "single bends over radius and speed limit, for a map"),
        "command": (
            "frenetic.search.command:CommandSearch",
            'a program in any language, command:"node search.mjs"',
        ),
    },
    methods=("ask", "tell"),
)

DRIVERS: Final = Registry(
    kind="driver",
    group="frenetic.drivers",
    built_in={
        "planner": (
            "frenetic.drivers:Planner",
            "knows the road ahead, speed from curvature, pure-pursuit steering; the default",
        ),
        "stanley": ("frenetic.drivers:Stanley", "the same speed plan, Stanley's steering law"),
        "beamng-ai": (
            "frenetic.drivers:BeamngAi",
            "a model of BeamNG.AI, fitted to recorded drives; in the simulator beamng, BeamNG.AI",
        ),
        "command": (
            "frenetic.drivers.command:CommandDriver",
            'a program in any language, command:"./controller --gain 2"',
        ),
    },
    methods=("reset", "act"),
)

OBJECTIVES: Final = Registry(
    kind="objective",
    group="frenetic.objectives",
    built_in={
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
    methods=(),
    target="function",
)

SIMULATORS: Final = Registry(
    kind="simulator",
    group="frenetic.simulators",
    built_in={
        "embedded": (
            "frenetic.simulators:EmbeddedSimulator",
            "a dynamic single-track car in compiled code, headless",
        ),
        "command": (
            "frenetic.simulators.command:CommandSimulator",
            'a program in any language that moves a car, command:"./simulator"',
        ),
    },
    methods=("drive", "__enter__", "__exit__"),
)

MANOEUVRES: Final = Registry(
    kind="manoeuvre",
    group="frenetic.manoeuvres",
    built_in={
        name: (f"frenetic.manoeuvres:{target}", summary)
        for name, target, summary in (
            ("step", "CurvatureStep", "a straight, then a bend: rise time, overshoot, settling"),
            ("lane-offset", "LaneOffset", "a start beside the lane's centre: the way back"),
            ("constant-radius", "ConstantRadius", "a steady bend: offset, understeer"),
            ("sine", "SweptSine", "bends that come ever faster: gain, phase and bandwidth"),
            ("slalom", "Slalom", "bends to both sides: largest offset, phase delay"),
        )
    },
    methods=("road", "conditions", "measure"),
)
