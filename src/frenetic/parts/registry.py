"""Strategies, drivers and simulators by name: built in, installed by others, or a user's own.

A name stands for ``module:Class`` and is imported on use, so listing the names imports nothing.
Other packages add theirs with an entry point in the group ``frenetic.strategies``,
``frenetic.drivers`` or ``frenetic.simulators``.
"""

from __future__ import annotations

import difflib
import hashlib
import importlib
import importlib.machinery
import importlib.util
import inspect
import os
import re
import sys
import sysconfig
from collections.abc import Callable, Iterable, Mapping
from contextlib import redirect_stdout, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, Final, NamedTuple

from frenetic._support.entry_points import RegisteredPart, installed
from frenetic.criteria.criterion import QUANTITIES
from frenetic.errors import FreneticError, UnknownNameError, describe_raised, place_of
from frenetic.parts.source_imports import files_of, imported_names

USER_MODULE: Final = "frenetic_user_"
"""Prefix of the names of modules loaded from a user's file."""
_INSTALLED: Final = frozenset({"site-packages", "dist-packages"})
_STANDARD: Final = tuple({sysconfig.get_path("stdlib"), sysconfig.get_path("platstdlib")})


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

    def entries(self) -> list[RegisteredPart]:
        """All names: the built-in ones, then the installed ones in alphabetical order.

        Raises:
            FreneticError: an installed package claims a name that is already taken.
        """
        found = {
            name: RegisteredPart(name, target, "built in", summary)
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

    def about(self, entry: RegisteredPart) -> str:
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
                    module = _load_own_module(place)
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


_FOLDERS: Final[set[str]] = set()
"""Folders of users' parts that this process has added to the module path."""


def _add_folder(folder: Path) -> None:
    """Puts the folder of a user's part behind the module path, before those of earlier parts.

    So a module beside the part comes before one beside another part, but after all that is
    installed.
    """
    place = str(folder)
    if place in sys.path and place not in _FOLDERS:
        return
    _FOLDERS.add(place)
    earlier = [path for path in sys.path if path in _FOLDERS and path != place]
    sys.path[:] = [*(path for path in sys.path if path not in _FOLDERS), place, *earlier]


def user_folders() -> frozenset[str]:
    """Folders of users' parts that this process has added to the module path."""
    return frozenset(_FOLDERS)


def _load_own_module(name: str) -> Any:
    """A module the user named, which may lie in the current folder.

    Raises:
        FreneticError: Python would take another module for it or for what it imports.
    """
    place = Path.cwd()
    _add_folder(place)
    top = name.partition(".")[0]
    if (shadowed := _shadowed(top, place)) is None:
        _check_helpers(files_of(name, [place]), place)
    else:
        raise FreneticError(
            f"Python takes {shadowed.by} for the module {top!r}, not {shadowed.file}: rename that,"
            " or name a file in it, such as path/to/file.py:Class"
        )
    return importlib.import_module(name)


class _Shadowed(NamedTuple):
    """A module of a user's folder in whose place Python takes another of this name."""

    file: Path
    by: str
    """The other one's file; ``built-in`` or ``frozen`` if it is a part of Python without a file."""


def _check_helpers(files: Iterable[tuple[str, Path, Path]], folder: Path) -> None:
    """Checks that Python takes the modules beside a user's file for what that file imports.

    Args:
        files: name, file and folder of each module, as `files_of` gives them.
        folder: where modules beside them lie.

    Raises:
        FreneticError: it would take a standard, installed or other one for one of them.
    """
    waiting, sources = list(files), set[Path]()
    while waiting:
        module, file, _ = waiting.pop()
        if file in sources:
            continue
        sources.add(file)
        package = module if file.name == "__init__.py" else module.rpartition(".")[0]
        for imported in imported_names(file.read_text("utf-8", "replace"), package):
            top = imported.partition(".")[0]
            shadowed = _shadowed(top, folder)
            if shadowed is not None and shadowed.file not in sources:
                raise FreneticError(
                    f"{file} imports {top!r}: Python takes {shadowed.by} for it, not"
                    f" {shadowed.file}: rename that"
                )
            waiting += files_of(imported, [folder])


def _shadowed(name: str, folder: Path) -> _Shadowed | None:
    """The module of a folder if Python takes another of its name; None if there is no such pair.

    Args:
        name: of the module, without dots.
        folder: on the module path.
    """
    stems = (f"{name}/__init__", name) if name else ()
    suffixes = importlib.machinery.all_suffixes()
    files = [folder / f"{stem}{suffix}" for stem in stems for suffix in suffixes]
    file = next((file for file in files if file.is_file()), None)
    if file is None:
        return None
    try:
        spec = importlib.util.find_spec(name)
    except (ImportError, ValueError):  # `__main__` has no spec
        return None
    if spec is None or (spec.has_location and Path(spec.origin or "").resolve() == file.resolve()):
        return None
    return _Shadowed(file, spec.origin or f"another {name}")


def is_local(file: Path) -> bool:
    """Whether a module's file is neither installed nor of the standard library."""
    is_installed = not _INSTALLED.isdisjoint(file.parts)
    return not is_installed and not any(file.is_relative_to(place) for place in _STANDARD)


def user_files() -> list[str]:
    """The files of users' own modules that this process has loaded."""
    return [
        module.__file__
        for name, module in sys.modules.copy().items()  # another thread may be importing
        if name.startswith(USER_MODULE) and module.__file__ is not None
    ]


def load_user_file(name: str) -> Any:
    """The module in a user's file; loaded once, under the same name in every process.

    Raises:
        FreneticError: the file does not exist or is no Python, or Python would take another module
            for one beside it that it imports.
    """
    path = Path(name).expanduser()
    if not path.is_file():
        raise FreneticError(f"there is no file {name!r}")
    path = path.resolve()
    # The same name in every process, so that its objects can be sent between processes.
    digest = hashlib.sha256(os.fsencode(path)).hexdigest()[:12]
    module_name = f"{USER_MODULE}{path.stem}_{digest}"
    if module_name in sys.modules:
        return sys.modules[module_name]
    spec = importlib.util.spec_from_file_location(module_name, path)
    if spec is None or spec.loader is None:
        raise FreneticError(f"{name!r} cannot be read as Python")
    # The file may import its neighbours, but none of them in the place of an installed module.
    _add_folder(path.parent)
    _check_helpers([("", path, path.parent)], path.parent)
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[module_name]
        raise
    return module


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
