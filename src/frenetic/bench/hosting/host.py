"""The work of the process: to import, build and start a generator, and to tell its end."""

from __future__ import annotations

import importlib
import importlib.machinery
import importlib.util
import inspect
import logging
import os
import random
import sys
import traceback
from collections.abc import Callable, Iterable
from dataclasses import asdict, replace
from pathlib import Path
from types import ModuleType
from typing import Any, BinaryIO, Final

import numpy as np

import frenetic
from frenetic.bench.hosting import pipeline
from frenetic.bench.hosting.executor import EXECUTORS, VirtualClock, make_executor
from frenetic.bench.hosting.messages import Assignment, End, Parent, leave_with_parent
from frenetic.bench.hosting.validity import validity
from frenetic.errors import FreneticError, describe_error

_FRENETIC: Final = Path(frenetic.__file__).resolve().parent


class GeneratorError(FreneticError):
    """A generator that cannot be imported or built; its cause is the generator's error, if any."""


def serve(incoming: BinaryIO, outgoing: BinaryIO) -> None:
    """Run a generator; this ends the process."""
    leave_with_parent()
    parent = Parent(incoming, outgoing)
    end = run(Assignment(**parent.receive()), parent)
    logging.shutdown()
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    parent.send(asdict(end))
    os._exit(0)  # without waiting for the generator's threads


def run(assignment: Assignment, parent: Parent) -> End:
    """Import, build and start a generator; return its end."""
    logging.basicConfig(
        level=logging.INFO, format="%(asctime)s %(levelname)s %(message)s", stream=sys.stderr
    )
    clock = VirtualClock(assignment.time_budget)
    try:
        _prepare(assignment)
        kind = _load_class(assignment)
        pipeline.quicken()
        generator = _build(kind, assignment, parent, clock)
    except GeneratorError as error:
        if error.__cause__ is not None:
            _print(error.__cause__)
        return End("crashed", str(error))
    parent.send({"kind": "ready"})
    clock.start()
    end = _started(generator, clock)
    return replace(end, seconds=clock.stop())


def _started(generator: Any, clock: VirtualClock) -> End:
    try:
        generator.start()
    except SystemExit as error:
        if clock.remaining() > 0.0:
            return End("exit", f"exit code {error.code}")
    except BaseException as error:
        _print(error)
        return End("crashed", describe_error(error))
    return End("returned" if clock.remaining() > 0.0 else "over")


def _print(error: BaseException) -> None:
    traceback.print_exception(type(error), error, error.__traceback__)


def _prepare(assignment: Assignment) -> None:
    """Put the generator's folders first on the module path, and the working directory.

    Raises:
        GeneratorError: The pipeline's own modules cannot be imported.

    """
    folders = [] if assignment.path is None else [assignment.path]
    if assignment.is_file:
        folders.append(str(_file(assignment).parent))
    sys.path[:0] = [*folders, ""]
    pipeline.offer(assignment.pipeline)
    try:
        importlib.import_module(EXECUTORS)
    except BaseException as error:
        place = assignment.pipeline
        raise GeneratorError(
            f"importing the pipeline in {place} fails: {_reason(error)}"
        ) from error
    _make_way([*folders, str(Path.cwd())], assignment.module)
    # Generators draw from the global random generators, so a seed repeats them.
    random.seed(assignment.seed)
    np.random.seed(assignment.seed % 2**32)  # noqa: NPY002


def _make_way(folders: list[str], module: str) -> None:
    """Leave the name `frenetic` to a generator that brings a package or module of that name.

    All that this process needs of ours is imported before.
    """
    spec = importlib.machinery.PathFinder.find_spec("frenetic", folders)
    if spec is None or (
        spec.origin is not None and Path(spec.origin).resolve().parent == _FRENETIC
    ):
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


def _file(assignment: Assignment) -> Path:
    """The file of a generator; relative to the working directory or else to its path."""
    file = Path(assignment.module).expanduser()
    if not file.is_file() and assignment.path is not None:
        file = Path(assignment.path, file)
    return file.resolve()


def _load_class(assignment: Assignment) -> Callable[..., Any]:
    """The generator's class.

    Raises:
        GeneratorError: Module or class is not there, or importing it fails.

    """
    try:
        module = _load_file(_file(assignment)) if assignment.is_file else _load(assignment.module)
    except GeneratorError:
        raise
    except BaseException as error:
        raise GeneratorError(f"importing {assignment.module} fails: {_reason(error)}") from error
    kind = getattr(module, assignment.class_name, None)
    if not callable(kind):
        raise GeneratorError(_no_such_class(module, assignment))
    return kind  # type: ignore[no-any-return]


def takes_time_budget(kind: Callable[..., Any]) -> bool:
    """Return whether a class is built as in 2021: it takes the time budget by name."""
    try:
        parameter = inspect.signature(kind).parameters.get("time_budget")
    except (TypeError, ValueError):
        return False
    by_name = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return parameter is not None and parameter.kind in by_name


def _build(
    kind: Callable[..., Any], assignment: Assignment, parent: Parent, clock: VirtualClock
) -> Any:
    """A generator with its executor, built as the pipeline of its year does it.

    Raises:
        GeneratorError: Building it fails, or it cannot be started.

    """
    of_2021 = takes_time_budget(kind)
    more = {"time_budget": assignment.time_budget} if of_2021 else {}
    try:
        executor = make_executor(assignment, parent, clock, remaining_as_number=of_2021)
        generator = kind(executor=executor, map_size=assignment.map_size, **more)
    except BaseException as error:
        raise GeneratorError(f"building {assignment.class_name} fails: {_reason(error)}") from error
    if not callable(getattr(generator, "start", None)):
        raise GeneratorError(
            f"{assignment.class_name} is no generator: it has no method start; give the class that"
            " has"
        )
    return generator


def _load(name: str) -> ModuleType:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        missing = error.name or ""
        if name != missing and not name.startswith(missing + "."):
            raise
        ours = (*{f"{Path(prefix)}{os.sep}" for prefix in (sys.prefix, sys.base_prefix)},)
        searched = (entry or "the run's working directory" for entry in sys.path)
        raise GeneratorError(
            f"there is no module {missing!r}: looked for it in"
            f" {', '.join(one for one in searched if not one.startswith(ours))} and what is"
            f" installed for {sys.executable}; give its folder as path"
        ) from None


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
    return (
        f"{assignment.module} has no class {assignment.class_name!r}. Its classes with a method"
        f" start: {', '.join(classes) or 'none'}"
    )


def _reason(error: BaseException) -> str:
    """One line about a generator's error while it was imported or built."""
    if isinstance(error, SystemExit):
        return f"it ends its process with exit code {error.code}"
    reason = describe_error(error)
    if not isinstance(error, ModuleNotFoundError):
        return reason
    if str(error.name).partition(".")[0] in pipeline.PACKAGES:
        return (
            f"{reason}; the bench has stand-ins for the pipeline's most used modules only: give the"
            " folder of a clone of the pipeline as pipeline"
        )
    return f"{reason}; install it for {sys.executable}, or name another interpreter"
