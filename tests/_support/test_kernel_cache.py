"""The folder of the compiled kernels."""

from __future__ import annotations

from pathlib import Path

from frenetic._support.kernel_cache import VARIABLE, ensure_kernel_cache


def cache(tmp_path: Path, *writable: Path, **variables: str) -> str | None:
    """Return the cache that is chosen if only these folders are writable; none means all."""
    environment = {"XDG_CACHE_HOME": str(tmp_path / "not yet"), "LOCALAPPDATA": str(tmp_path)}
    environment |= variables
    ensure_kernel_cache(environment, lambda folder: not writable or folder in writable)
    return environment.get(VARIABLE)


def test_the_cache_is_elsewhere_only_if_package_and_home_are_not_writable(tmp_path: Path) -> None:
    assert cache(tmp_path) is None
    assert cache(tmp_path, tmp_path) is None
    fallback = cache(tmp_path, tmp_path / "other")
    assert fallback is not None
    assert Path(fallback).is_dir()
    assert cache(tmp_path, tmp_path / "other", **{VARIABLE: "mine"}) == "mine"
