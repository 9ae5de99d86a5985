"""A driver's test for pytest: the driver keeps its lane on roads that a search looks for.

::

    @keeps_lane(roads="rural-80", criteria="after-iso-11270", simulations=300)
    def test_my_driver():
        return MyDriver()

Roads on which the driver failed once lie beside the test, in `FOLDER`, and are driven first.
"""

from __future__ import annotations

import functools
import inspect
import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, TypeVar

from frenetic._support.bounds import require_count
from frenetic.errors import DriverError, FreneticError
from frenetic.spec import Spec
from frenetic.testing.lane_check import LaneCheck, short_digest

FOLDER: Final = "failing-roads"
"""Name of the folder beside a test's file for the roads on which it failed."""
_MAX_NAME: Final = 60
"""Largest number of characters of a module's or test's name in a road file's name; our choice."""
_PLAIN_STEM: Final = re.compile(rf"[a-z0-9_]{{1,{_MAX_NAME}}}-[a-z0-9_]{{1,{_MAX_NAME}}}")
"""Module and test in a form in which they can stand in file names on all systems."""
_UNSAFE: Final = re.compile(r"[^A-Za-z0-9_.]+")
"""Characters that are replaced in file names."""

TestFunction = TypeVar("TestFunction", bound=Callable[..., Any])


class DriverFailedError(AssertionError):
    """The driver failed; the message says why, on which roads, and how to drive them again."""


SHOWN: Final = (DriverFailedError, FreneticError)
"""Errors that the plug-in shows without a traceback."""


def keeps_lane(
    function: None = None,
    /,
    *,
    roads: str | Mapping[str, Any] = "competition",
    criteria: str | Mapping[str, Any] = "competition",
    simulations: int = 300,
    seconds: float = 60.0,
    seed: int = 0,
    simulator: str = "embedded",
    conditions: Mapping[str, float] = MappingProxyType({}),
    speed_limit: float | None = None,
    oob_tolerance: float | None = None,
) -> Callable[[TestFunction], TestFunction]:
    """Decorate a function that returns a driver: it becomes a test that the driver keeps its lane.

    The function may have fixtures and parameters as any test. Roads on which the driver failed once
    are driven first. Then a search looks for other failing roads, shortens one of each cause and
    writes it into `FOLDER` beside the test's file, to be committed. The message of a failure says
    the causes in words, names the roads' files and pictures, and the command that drives them
    again.

    The same seed gives the same result. The limit of wall time does not change which roads are
    driven. It ends a search early: the test then passes if nothing has failed so far, and a notice
    says so.

    Args:
        roads: name of a road class, as for ``--roads``, or the values of a class.
        criteria: name of a set of criteria, as for ``--criteria``, or the entries of a file of
            criteria: they fail a drive beside leaving the lane.
        simulations: most drives of the search.
        seconds: wall time after which the search ends, in s.
        seed: seed of the search.
        simulator: name of the simulator with options, as for ``--simulator``.
        conditions: name of a condition -> amount, as for ``--with``.
        speed_limit: speed limit in km/h; by default the roads' limit.
        oob_tolerance: share of the car that may be outside its lane; 0.95 by default.

    Raises:
        TypeError: the decorator was written without parentheses.
        ValueError: an argument is out of range.
        FreneticError: the roads, the criteria or the simulator are unknown.
    """
    if function is not None:
        raise TypeError("keeps_lane is needed with parentheses: @keeps_lane()")
    require_count("simulations", simulations)
    if not seconds > 0.0:
        raise ValueError(f"seconds is {seconds}: a positive number is needed")
    named = {"roads": roads, "criteria": criteria, "conditions": conditions}
    entries: dict[str, Any] = {
        **{key: dict(v) if isinstance(v, Mapping) else v for key, v in named.items()},
        "simulator": simulator,
        "speed_limit": speed_limit,
        "oob_tolerance": oob_tolerance,
        "simulations": simulations,
        "seed": seed,
    }
    spec = Spec(**entries)
    spec.terms  # noqa: B018  # a fault is refused when the test is decorated, not when it runs

    def decorate(function: TestFunction) -> TestFunction:
        @functools.wraps(function)
        def test(*args: Any, **kwargs: Any) -> None:
            __tracebackhide__ = True  # pytest leaves this frame out of tracebacks
            _check_driver(function, function(*args, **kwargs), spec, seconds)

        marked: TestFunction = _marked(test)
        return marked

    return decorate


def _check_driver(function: Callable[..., Any], driver: Any, spec: Spec, seconds: float) -> None:
    """Check that a driver keeps its lane.

    Args:
        function: function of the test, which returned the driver.
        driver: the driver, not checked yet.
        spec: spec of the search.
        seconds: wall time after which the search ends, in s.

    Raises:
        DriverError: the function returned no driver.
        DriverFailedError: the driver failed.
    """
    __tracebackhide__ = True  # pytest leaves this frame out of tracebacks
    if isinstance(driver, type) or not all(
        callable(getattr(driver, name, None)) for name in ("reset", "act")
    ):
        raise DriverError(
            f"{function.__name__} returned {driver!r}: a driver with reset and act is"
            " needed, see frenetic.Driver"
        )
    file, name = Path(inspect.getfile(function)), _name_of(function)
    stem = memory_stem(file.stem, name)
    check = LaneCheck(spec, seconds, driver, file.parent / FOLDER, name, stem)
    try:
        text = check.failure_text()
    finally:
        NOTICES.extend(f"{name}: {notice}" for notice in check.notices)
    if text:
        raise DriverFailedError(text)


def _marked(test: Callable[..., Any]) -> Any:
    """Return a test with the mark by which ``pytest -m keeps_lane`` finds it."""
    try:
        import pytest  # without pytest the test runs as well
    except ImportError:
        return test
    return pytest.mark.keeps_lane(test)


def _name_of(function: Callable[..., Any]) -> str:
    """Return pytest's id of the running test; outside pytest the name of its function."""
    # pytest sets the variable to the id and the phase, such as "test_a.py::test_b (call)".
    test_id = os.environ.get("PYTEST_CURRENT_TEST", "").rpartition(" ")[0]
    return test_id if function.__name__ in test_id else function.__qualname__


def memory_stem(module: str, name: str) -> str:
    """Return the beginning of the names of a test's road files, which no other test shares.

    The beginning is ``bends_test-test_hasty`` for ``bends_test.py::test_hasty``. A digest of the id
    follows if the id has other characters than lower-case letters, digits and underscores, which
    file names of some systems would lose.

    Args:
        module: name of the file that holds the test's function, without its suffix.
        name: id of the test, or outside pytest the name of its function.
    """
    path, separator, test = name.partition("::")
    if not separator:
        path, test = module, name
    elif Path(path).stem == module:  # the id's path depends on the folder in which pytest started
        path = module
    if _PLAIN_STEM.fullmatch(stem := f"{path}-{test}"):
        return stem
    texts = (
        _UNSAFE.sub("-", text).strip("-.")[:_MAX_NAME] for text in (path.replace(".", "-"), test)
    )
    return "-".join([*texts, short_digest(f"{path}::{test}", length=12)])


NOTICES: Final[list[str]] = []
"""Notices of the tests that ran since the list was emptied; the plug-in shows them."""
