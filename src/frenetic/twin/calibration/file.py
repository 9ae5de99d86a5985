"""A calibration as a TOML file: what `frenetic calibrate` says, and what only a file says."""

from __future__ import annotations

from frenetic._support.bounds import Count
from frenetic._support.words import read_part
from frenetic.errors import FreneticError
from frenetic.twin.calibration.parameters import Model
from frenetic.twin.calibration.recordings import Terms
from frenetic.twin.profile import Settings


class CalibrationFile(Settings, frozen=True, kw_only=True):
    """The entries of a calibration's file."""

    recordings: tuple[str, ...] = ()
    """Files and folders."""
    terms: Terms = Terms()
    """What holds of all drives, whatever their recording says."""
    driver: str = ""
    """The twin's, with its options, as on the command line."""
    fit: tuple[str, ...] = ()
    """Parameters, as `Model.of` takes them."""
    vehicle: str | dict[str, float | str] | None = None
    """Name of the car that the fit begins with, or its parameters, see `Model`."""
    out: str = "profile.json"
    workers: Count | None = None

    def model(self) -> Model:
        """What is fitted.

        Raises:
            FreneticError: see `Model.of`.
            ValueError: the driver's options are none.
        """
        name, options = read_part(self.driver)
        if not name:
            raise FreneticError("the twin has no driver: name one, such as planner")
        return Model.of(name, self.fit, driver_options=options, vehicle=self.vehicle)
