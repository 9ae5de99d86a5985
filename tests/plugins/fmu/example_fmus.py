"""FMUs that tests build, and observations for them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from frenetic import EmbeddedSimulator, Observation, Road
from frenetic.drivers import DriveSetup
from frenetic.plugins.fmu.example import build, compiler

LAWS = Path(__file__).with_name("laws.h")


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Builds an FMU, once for the same arguments."""
    if compiler() is None:
        pytest.skip("there is no compiler for C")
    files: dict[str, Path] = {}

    def call(**options: Any) -> Path:
        key = repr(options)
        if key not in files:
            folder = tmp_path_factory.mktemp("fmu")
            files[key] = build(folder / "controller.fmu", **options)
        return files[key]

    return call


@pytest.fixture
def faulty(built: Callable[..., Path]) -> Path:
    """FMU with the laws of ``laws.h``."""
    return built(law=LAWS)


@pytest.fixture
def setup() -> DriveSetup:
    return EmbeddedSimulator().setup(Road([0.0] * 8))


@pytest.fixture
def observe() -> Callable[..., Observation]:
    """Makes observations."""

    def call(time: float = 0.0, **values: Any) -> Observation:
        points = np.column_stack((2.0 * np.arange(40), 0.1 * np.arange(40)))
        usual = {
            "speed": 10.0,
            "yaw_rate": 0.1,
            "steering": 0.05,
            "lateral_offset": 0.3,
            "heading_error": 0.02,
            "ahead": points,
            "curvature_ahead": 0.001 * np.arange(40),
        }
        return Observation(time=time, **{**usual, **values})

    return call
