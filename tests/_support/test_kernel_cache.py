from __future__ import annotations

from pathlib import Path

from frenetic._support.kernel_cache import VARIABLE, ensure_kernel_cache


def cache(tmp_path: Path, *writable: Path, **chosen: str) -> str | None:
    environment = {"XDG_CACHE_HOME": str(tmp_path / "not yet"), "LOCALAPPDATA": str(tmp_path)}
    environment |= chosen
    ensure_kernel_cache(environment, lambda folder: not writable or folder in writable)
    return environment.get(VARIABLE)


def test_the_cache_is_elsewhere_only_if_neither_package_nor_home_takes_it(tmp_path: Path) -> None:
    assert cache(tmp_path) is None
    assert cache(tmp_path, tmp_path) is None
    nowhere = cache(tmp_path, tmp_path / "other")
    assert nowhere is not None
    assert Path(nowhere).is_dir()
    assert cache(tmp_path, tmp_path / "other", **{VARIABLE: "mine"}) == "mine"
