"""Which values of a twin's parameters a fit passes over, and which errors it reports."""

from __future__ import annotations

from typing import NoReturn

import numpy as np
import pytest

from frenetic._support.arrays import FloatArray
from frenetic.errors import CampaignError
from frenetic.oracle.drive import Rules
from frenetic.plugins.twin import fitting
from frenetic.plugins.twin.fitting import Fitter, UnusableValuesError
from frenetic.plugins.twin.model import Parameter, TwinModel
from frenetic.plugins.twin.recorded_drive import RecordedDrive
from frenetic.road import Road

BRAKING = Parameter("driver", "braking", low=-1.0, high=3.0, start=1.0)
FRICTION = Parameter("vehicle", "friction", low=-1.0, high=1.0, start=1.0)
REFUSED, ACCEPTED = np.array([0.0]), np.array([1.0])
"""Unit values of either parameter."""


def fitter_of(parameter: Parameter) -> Fitter:
    return Fitter(TwinModel("planner", {}, {}, (parameter,)), Rules())


@pytest.fixture
def recorded_drives() -> list[RecordedDrive]:
    road = Road.from_points(np.array([[10.0, 100.0], [60.0, 100.0], [110.0, 105.0]]))
    states: FloatArray = np.array([np.zeros(20), np.full(20, 10.0)])
    return [RecordedDrive(road=road, states=states)]


@pytest.mark.parametrize("parameter", [BRAKING, FRICTION], ids=str)
def test_refused_values_have_no_residuals(
    parameter: Parameter, recorded_drives: list[RecordedDrive]
) -> None:
    fitter = fitter_of(parameter)
    with pytest.raises(UnusableValuesError):
        fitter.parts(REFUSED)
    assert fitter.try_residuals(REFUSED, recorded_drives) is None
    assert fitter.try_residuals(ACCEPTED, recorded_drives) is not None


@pytest.mark.parametrize("error", [CampaignError("no process"), ValueError("a wrong shape")])
def test_an_error_of_the_simulator_or_of_our_code_does_not_count_as_refused_values(
    error: Exception, recorded_drives: list[RecordedDrive], monkeypatch: pytest.MonkeyPatch
) -> None:
    def driving(*_: object, **__: object) -> NoReturn:
        raise error

    monkeypatch.setattr(fitting, "driving", driving)
    with pytest.raises(type(error), match=str(error)):
        fitter_of(BRAKING).try_residuals(ACCEPTED, recorded_drives)
