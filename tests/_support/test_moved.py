"""Modules that have moved."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module

import pytest

from frenetic._support.public_names import MOVED


@pytest.mark.parametrize("old", MOVED)
def test_an_old_path_gives_the_module_of_today(old: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, old, raising=False)
    with pytest.warns(DeprecationWarning, match=f"{old} is {MOVED[old]} now") as caught:
        module = import_module(old)
    assert module is import_module(MOVED[old])
    assert module.__name__ == MOVED[old]
    assert module.__spec__ is not None
    assert module.__spec__.name == MOVED[old]
    package, _, name = old.rpartition(".")
    assert getattr(import_module(package), name) is module
    assert len(caught) == 1


def test_a_module_of_a_package_that_has_moved_is_there_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("frenetic.campaign.checking", "frenetic.campaign.checking.report"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    with pytest.warns(DeprecationWarning, match="is frenetic.campaign.check.* now"):
        module = import_module("frenetic.campaign.checking.report")
    assert module is import_module("frenetic.campaign.check.report")


def test_the_warning_points_at_who_imports() -> None:
    code = "from frenetic.analysis.shrinking import shrink"
    ran = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert "<string>:1: DeprecationWarning: frenetic.analysis.shrinking is" in ran.stderr


def test_a_path_that_never_was_is_not_found() -> None:
    with pytest.raises(ModuleNotFoundError, match=r"frenetic\.analysis\.nothing"):
        import_module("frenetic.analysis.nothing")
