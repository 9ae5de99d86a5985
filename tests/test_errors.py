"""Lines about errors in foreign code."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from frenetic.errors import (
    DriverError,
    Fault,
    Trouble,
    describe_error,
    describe_raised,
    place_of,
    reason_of,
    traceback_of,
)
from frenetic.road import Road

HERE = Path(__file__).name


def raised(call: Callable[[], object]) -> Exception:
    with pytest.raises(Exception) as caught:
        call()
    return caught.value


def line_of(call: Callable[[], object]) -> int:
    return call.__code__.co_firstlineno + 1


def singular() -> object:
    return np.linalg.solve(np.zeros((2, 2)), np.ones(2))


def no_road() -> object:
    return Road(np.zeros((2, 2)))


def unlucky() -> object:
    return 1 / len("".join(str(number) for number in range(100) if number > 1000)) + 100000


@pytest.mark.parametrize("call", [singular, no_road])
def test_the_place_of_an_error_is_the_users_deepest_call(call: Callable[[], object]) -> None:
    """The place is neither in numpy nor in our code."""
    place = place_of(raised(lambda: call()))
    source = Path(__file__).read_text().splitlines()[line_of(call) - 1].strip()
    assert place == f"{HERE}:{line_of(call)}: {source}"


def test_a_long_text_is_cut() -> None:
    place = place_of(raised(unlucky))
    assert place.startswith(f'{HERE}:{line_of(unlucky)}: return 1 / len("".join(')
    assert place.endswith("...")
    assert len(place) < 120

    def shout() -> None:
        raise ValueError("x" * 1_000_000)

    text = reason_of(raised(shout))
    assert len(text) == 450
    assert text.endswith(f'x ({HERE}:{line_of(shout)}: raise ValueError("x" * 1_000_000))')
    trace = traceback_of(raised(shout))
    assert len(trace) < 21_000
    assert "in shout\n" in trace


def test_a_files_name_begins_at_its_import_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "gearing").mkdir()
    (tmp_path / "gearing" / "steering.py").write_text("def steer():\n    return [][1]\n")
    monkeypatch.syspath_prepend(tmp_path)
    steering = __import__("gearing.steering").steering
    assert place_of(raised(steering.steer)) == "gearing/steering.py:2: return [][1]"
    monkeypatch.setattr(sys, "path", [])
    assert place_of(raised(steering.steer)).startswith(f"{tmp_path}/gearing/steering.py:2: "[-100:])


def test_an_error_in_an_installed_driver_has_a_place_in_its_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    packages = tmp_path / "site-packages"
    for name, text in {
        "lanes/__init__.py": "",
        "lanes/laws.py": "from solver import solve\n\ndef steer():\n    return solve()\n",
        "solver.py": "def solve():\n    return [][1]\n",
    }.items():
        (packages / name).parent.mkdir(parents=True, exist_ok=True)
        (packages / name).write_text(text)
    monkeypatch.syspath_prepend(packages)
    from lanes.laws import steer  # type: ignore[import-not-found]

    error = raised(lambda: exec(compile("steer()", "<frozen call>", "exec"), {"steer": steer}))
    error = error.with_traceback(_without_this_file(error))
    assert place_of(error) == "lanes/laws.py:4: return solve()"


def _without_this_file(error: Exception):  # type: ignore[no-untyped-def]
    """Return the traceback without the frames of this file."""
    trace = error.__traceback__
    while trace is not None and trace.tb_frame.f_code.co_filename == __file__:
        trace = trace.tb_next
    return trace


def test_an_error_that_was_never_raised_has_no_place() -> None:
    error = ValueError("never raised")
    assert place_of(error) == ""
    assert describe_raised(error) == describe_error(error) == "ValueError: never raised"


def test_the_traceback_of_a_frenetic_error_shows_its_cause() -> None:
    def steer() -> None:
        try:
            singular()
        except Exception as error:
            raise DriverError("the driver raised something") from error

    trace = traceback_of(raised(steer))
    assert trace.startswith("Traceback (most recent call last):\n")
    assert "in singular\n" in trace
    assert trace.endswith("LinAlgError: Singular matrix\n")
    assert traceback_of(DriverError("the driver returned nothing")) == ""


def test_trouble_has_reason_traceback_and_fault() -> None:
    def steer() -> None:
        raise ValueError("no lane ahead")

    error = raised(steer)
    trouble = Trouble.of(error, "driver")
    assert trouble.reason == reason_of(error)
    assert trouble.traceback == traceback_of(error)
    assert trouble.fault == Fault.of("driver", error)
    assert Trouble.of(error, "simulator", "it stopped").reason == "it stopped"
