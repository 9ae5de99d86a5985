"""The console announces that kernels are compiled only where they are."""

from __future__ import annotations

import io
import threading

import numba
import pytest
from numba.core import event
from rich.console import Console

from frenetic._support import compiled
from frenetic.cli import console
from frenetic.cli.console import announced_compilation


@pytest.mark.parametrize("is_compiling", [True, False])
def test_compiling_is_announced_only_where_it_happens(
    monkeypatch: pytest.MonkeyPatch, is_compiling: bool
) -> None:
    looks = 0
    looked_often, announced = threading.Event(), threading.Event()

    def look() -> bool:
        nonlocal looks
        looks += 1
        if looks == 5:
            looked_often.set()
        return is_compiling

    class Log(Console):
        def print(self, *texts: object, **options: object) -> None:
            super().print(*texts)
            announced.set()

    monkeypatch.setattr(console, "ANNOUNCE_AFTER", 0.002)
    monkeypatch.setattr(console, "LOOK_INTERVAL", 0.001)
    monkeypatch.setattr(compiled, "is_compiling", look)
    log = Log(file=io.StringIO())
    with announced_compilation(log):
        assert (announced if is_compiling else looked_often).wait(60.0)
    assert announced.is_set() is is_compiling


def test_is_compiling_is_true_only_while_a_kernel_is_compiled() -> None:
    states = []

    class Noticing(event.Listener):  # type: ignore[misc]
        def on_start(self, _: object) -> None:
            states.append(compiled.is_compiling())

        def on_end(self, _: object) -> None:
            pass

    kernel = numba.njit(lambda x: x + 1)
    assert not compiled.is_compiling()
    with event.install_listener("numba:compile", Noticing()):
        assert kernel(1) == 2
        assert kernel(2) == 3
    assert states == [True]
    assert not compiled.is_compiling()
