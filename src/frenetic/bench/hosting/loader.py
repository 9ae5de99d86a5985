"""Import of a generator's class, and building of the generator."""

from __future__ import annotations

import difflib
import importlib
import importlib.machinery
import importlib.util
import inspect
import os
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import frenetic
from frenetic.bench.hosting import offered
from frenetic.bench.hosting.messages import Assignment
from frenetic.bench.hosting.validity import validity
from frenetic.errors import FreneticError, describe_error

_FRENETIC: Final = str(Path(frenetic.__file__).parent)


class GeneratorError(FreneticError):
    """A generator that cannot be imported or built; its cause is the generator's error, if any."""


def prepare_path(assignment: Assignment) -> None:
    """Put the generator's folders first on the module path, then the working directory."""
    folders = [] if assignment.path is None else [assignment.path]
    if assignment.is_file:
        folders.append(str(_file(assignment).parent))
    sys.path[:0] = [*folders, ""]
    _make_way([*folders, str(Path.cwd())], assignment.module)


def load_class(assignment: Assignment) -> Callable[..., Any]:
    """Return the generator's class.

    Raises:
        GeneratorError: Module or class is not there, or importing it fails.

    """
    try:
        module = _load_file(_file(assignment)) if assignment.is_file else _load(assignment.module)
    except GeneratorError:
        raise
    except BaseException as error:
        raise GeneratorError(
            f"importing {assignment.module} fails: {_reason(error, assignment)}"
        ) from error
    found = getattr(module, assignment.class_name, None)
    if not callable(found):
        raise GeneratorError(_no_such_class(module, assignment))
    return found  # type: ignore[no-any-return]


def takes_time_budget(kind: Callable[..., Any]) -> bool:
    """Return whether a class is built as in 2021: it takes the time budget by name."""
    try:
        parameter = inspect.signature(kind).parameters.get("time_budget")
    except (TypeError, ValueError):
        return False
    by_name = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return parameter is not None and parameter.kind in by_name


def build(kind: Callable[..., Any], executor: Any, assignment: Assignment) -> Any:
    """Return a generator, built as the pipeline of its year does it.

    Raises:
        GeneratorError: Building it fails, or it cannot be started.

    """
    arguments = {"executor": executor, "map_size": assignment.map_size}
    if takes_time_budget(kind):
        arguments["time_budget"] = assignment.time_budget
    try:
        generator = kind(**arguments)
    except BaseException as error:
        raise GeneratorError(
            f"building {assignment.class_name} fails: {_reason(error, assignment)}"
        ) from error
    if not callable(getattr(generator, "start", None)):
        raise GeneratorError(
            f"{assignment.class_name} is no generator: it has no method start; give the class that"
            " has"
        )
    return generator


def _make_way(folders: list[str], module: str) -> None:
    """Leave the name `frenetic` to a generator that brings a package or module of that name.

    All that this process needs of ours is imported before.
    """
    spec = importlib.machinery.PathFinder.find_spec("frenetic", folders)
    if spec is None or (spec.origin is not None and _is_ours(Path(spec.origin))):
        return
    # A folder without __init__.py may also be a clone of ours.
    if spec.origin is None and not _holds(spec.submodule_search_locations, module):
        return
    validity().check_validity([(0.0, 0.0), (0.0, 1.0)])  # what numba has compiled is loaded by name
    for name in [n for n in sys.modules if n == "frenetic" or n.startswith("frenetic.")]:
        _hidden.append(sys.modules.pop(name))
    if spec.origin is None:  # an installed package of that name would come first
        sys.modules["frenetic"] = importlib.util.module_from_spec(spec)


def _holds(folders: Iterable[str] | None, module: str) -> bool:
    """Whether a package of the name `frenetic`, in these folders, has a module."""
    package, _, rest = module.partition(".")
    places = [Path(folder, *rest.split(".")) for folder in folders or ()]
    return package == "frenetic" and any(
        place.is_dir() or place.with_suffix(".py").is_file() for place in places
    )


_hidden: Final[list[ModuleType]] = []


def _is_ours(place: Path) -> bool:
    ours = Path(_FRENETIC).resolve()
    return place.resolve() in (ours, ours / "__init__.py")


def _file(assignment: Assignment) -> Path:
    """The file of a generator; relative to the working directory or else to its path."""
    file = Path(assignment.module).expanduser()
    if not file.is_file() and assignment.path is not None:
        file = Path(assignment.path, file)
    return file.resolve()


def _load(name: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        missing = error.name or ""
        if name != missing and not name.startswith(missing + "."):
            raise
        raise GeneratorError(
            f"there is no module {missing!r}: looked for it in {_searched()} and what is installed"
            f" for {sys.executable}; give its folder as path"
        ) from None


def _searched() -> str:
    """The folders of the module path outside the interpreter."""
    installed = tuple(f"{Path(prefix)}{os.sep}" for prefix in (sys.prefix, sys.base_prefix))
    return ", ".join(
        entry or "the run's working directory"
        for entry in sys.path
        if not entry.startswith(installed)
    )


def _load_file(file: Path) -> ModuleType:
    if not file.is_file():
        raise GeneratorError(f"there is no file {str(file)!r}")
    # Others of its folder may import it by its name, unless that is taken.
    name = f"generator_{file.stem}" if file.stem in sys.modules else file.stem
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise GeneratorError(f"{str(file)!r} cannot be read as Python")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def _no_such_class(module: ModuleType, assignment: Assignment) -> str:
    classes = [
        name
        for name in dict.fromkeys([*vars(module), *getattr(module, "__all__", ())])
        for value in (getattr(module, name, None),)
        if inspect.isclass(value) and callable(getattr(value, "start", None))
    ]
    close = difflib.get_close_matches(assignment.class_name, classes, n=1)
    hint = f", did you mean {close[0]!r}?" if close else "."
    return (
        f"{assignment.module} has no class {assignment.class_name!r}{hint} Its classes with a"
        f" method start: {', '.join(classes) or 'none'}"
    )


def _reason(error: BaseException, assignment: Assignment) -> str:
    """One line about a generator's error while it was imported or built."""
    if isinstance(error, SystemExit):
        return f"it ends its process with exit code {error.code}"
    reason = describe_error(error)
    if isinstance(error, ModuleNotFoundError):
        missing = str(error.name)
        if missing.partition(".")[0] in offered.PACKAGES:
            return (
                f"{reason}; the bench offers {', '.join(offered.module_names())}; for others give"
                " the folder of a copy of the pipeline as path"
            )
        return f"{reason}; install it for {sys.executable}, or name another interpreter"
    if isinstance(error, ImportError) and "relative import" in reason and assignment.is_file:
        return f"{reason}; give it as package.module, with a path, instead of as a file"
    return reason
