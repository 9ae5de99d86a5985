from __future__ import annotations

from pathlib import Path

from frenetic._support.kernel_cache import VARIABLE, ensure_kernel_cache


def test_a_writable_package_needs_no_other_cache() -> None:
    environment: dict[str, str] = {}
    ensure_kernel_cache(environment, lambda folder: True)
    assert environment == {}


def test_a_writable_home_needs_no_other_cache(tmp_path: Path) -> None:
    environment = {"XDG_CACHE_HOME": str(tmp_path / "not" / "yet"), "LOCALAPPDATA": str(tmp_path)}
    before = dict(environment)
    ensure_kernel_cache(environment, lambda folder: folder == tmp_path)
    assert environment == before


def test_where_nothing_can_be_written_there_is_a_temporary_cache() -> None:
    environment: dict[str, str] = {}
    ensure_kernel_cache(environment, lambda folder: False)
    assert Path(environment[VARIABLE]).is_dir()


def test_the_users_choice_stands() -> None:
    environment = {VARIABLE: "mine"}
    ensure_kernel_cache(environment, lambda folder: False)
    assert environment == {VARIABLE: "mine"}
