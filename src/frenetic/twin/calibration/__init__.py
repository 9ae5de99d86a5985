"""Calibration: a twin in the embedded simulator that drives as recorded drives do.

`read_recordings` reads them, `Model.of` names what is fitted, `calibrate` fits, cross-validates and
makes the profile.
"""

from __future__ import annotations

from frenetic.twin.calibration.calibrate import Calibration, calibrate
from frenetic.twin.calibration.parameters import Model, Parameter
from frenetic.twin.calibration.recordings import RecordedDrive, Recordings, Terms, read_recordings
from frenetic.twin.profile import Settings

__all__ = [
    "Calibration",
    "Model",
    "Parameter",
    "RecordedDrive",
    "Recordings",
    "Settings",
    "Terms",
    "calibrate",
    "read_recordings",
]
