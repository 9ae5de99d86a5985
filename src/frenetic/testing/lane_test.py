"""Drivers' tests for pytest: a driver keeps its lane on roads that a search looks for, and well.

::

    @keeps_lane(roads="rural-80", simulations=300, margin={"delay": 0.1})
    def test_my_driver():
        return MyDriver()


    @steers_well(roads="rural-80", offset=0.3, jerk=2.0)
    def test_its_comfort():
        return MyDriver()

Roads on which the driver failed once lie beside the test, in `FOLDER`, and are driven first.
"""

from __future__ import annotations

import functools
import inspect
import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, TypeVar

from frenetic._support.bounds import require_count
from frenetic.conditions.condition import condition_named
from frenetic.criteria.criterion import LATERAL_JERK, LATERAL_OFFSET
from frenetic.errors import DriverError, FreneticError
from frenetic.rerun.margin_quantities import RequiredAmount
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
    margin: Mapping[str, float] = MappingProxyType({}),
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
        margin: name of a condition -> amount. After the search, which has found nothing, the driver
            must not fail up to this amount on 95 % of 80 random roads, see `frenetic.rerun.margin`.
            Each condition takes 560 drives, which ``seconds`` does not limit.

    Raises:
        TypeError: the decorator was written without parentheses.
        ValueError: an argument is out of range.
        FreneticError: the roads, the criteria, a condition or the simulator are unknown.
    """
    if function is not None:
        raise TypeError("keeps_lane is needed with parentheses: @keeps_lane()")
    required = [(name, condition_named(name).require(value)) for name, value in margin.items()]
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
    return _decorator(Spec(**entries), seconds, "keeps_lane", required)


def steers_well(
    function: None = None,
    /,
    *,
    offset: float | None = None,
    jerk: float | None = None,
    criteria: str | Mapping[str, Any] = "competition",
    roads: str | Mapping[str, Any] = "competition",
    simulations: int = 100,
    seed: int = 0,
    simulator: str = "embedded",
    conditions: Mapping[str, float] = MappingProxyType({}),
) -> Callable[[TestFunction], TestFunction]:
    """Decorate a function that returns a driver: it becomes a test that the driver steers well.

    The driver drives random roads, and fails on a road where it exceeds a limit or leaves its lane.
    As with `keeps_lane`, failing roads are shortened, written into `FOLDER`, and driven first.

    Args:
        offset: largest distance of the car's centre from the middle of its lane, in m.
        jerk: largest lateral jerk, the mean of 0.5 s, in m/s³.
        criteria: further limits, as for `keeps_lane`; ``offset`` and ``jerk`` win.
        roads: name of a road class, as for ``--roads``, or the values of a class.
        simulations: number of random roads; after 20 failures no further road is driven.
        seed: seed of the random roads.
        simulator: name of the simulator with options, as for ``--simulator``.
        conditions: name of a condition -> amount, as for ``--with``.

    Raises:
        TypeError: the decorator was written without parentheses.
        ValueError: an argument is out of range, or there is no limit.
        FreneticError: the roads, the criteria or the simulator are unknown.
    """
    if function is not None:
        raise TypeError("steers_well is needed with parentheses: @steers_well(offset=0.3)")
    require_count("simulations", simulations)
    limits = {
        name: limit
        for name, limit in ((LATERAL_OFFSET, offset), (LATERAL_JERK, jerk))
        if limit is not None
    }
    named = Spec(criteria=dict(criteria) if isinstance(criteria, Mapping) else criteria)
    limited = named.rules.criteria.with_limits(limits)
    if not limited:
        raise ValueError("steers_well has no limit: give it an offset, a jerk or criteria")
    entries: dict[str, Any] = {
        "strategy": "random",
        "criteria": limited.entry(),
        "roads": dict(roads) if isinstance(roads, Mapping) else roads,
        "conditions": dict(conditions) if isinstance(conditions, Mapping) else conditions,
        "simulator": simulator,
        "simulations": simulations,
        "seed": seed,
    }
    return _decorator(Spec(**entries), math.inf, "steers_well")


def _decorator(
    spec: Spec, seconds: float, mark: str, margin: Sequence[RequiredAmount] = ()
) -> Callable[[TestFunction], TestFunction]:
    """Return the decorator that makes a test of a function that returns a driver.

    Args:
        spec: spec of the search.
        seconds: wall time after which the search ends, in s.
        mark: name of pytest's mark.
        margin: amounts of conditions before which the driver must not begin to fail.
    """
    spec.terms  # noqa: B018  # a fault is refused when the test is decorated, not when it runs

    def decorate(function: TestFunction) -> TestFunction:
        @functools.wraps(function)
        def test(*args: Any, **kwargs: Any) -> None:
            __tracebackhide__ = True  # pytest leaves this frame out of tracebacks
            _check_driver(function, function(*args, **kwargs), spec, seconds, margin)

        marked: TestFunction = _marked(test, mark)
        return marked

    return decorate


def _check_driver(
    function: Callable[..., Any],
    driver: Any,
    spec: Spec,
    seconds: float,
    margin: Sequence[RequiredAmount],
) -> None:
    """Check that a driver keeps its lane.

    Args:
        function: function of the test, which returned the driver.
        driver: the driver, not checked yet.
        spec: spec of the search.
        seconds: wall time after which the search ends, in s.
        margin: amounts of conditions before which the driver must not begin to fail.

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
    check = LaneCheck(spec, seconds, driver, file.parent / FOLDER, name, stem, margin)
    try:
        text = check.failure_text()
    finally:
        NOTICES.extend(f"{name}: {notice}" for notice in check.notices)
    if text:
        raise DriverFailedError(text)


def _marked(test: Callable[..., Any], mark: str) -> Any:
    """Return a test with a mark, by which ``pytest -m keeps_lane`` finds it."""
    try:
        import pytest  # without pytest the test runs as well
    except ImportError:
        return test
    return getattr(pytest.mark, mark)(test)


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
