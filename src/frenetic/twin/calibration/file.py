"""A calibration as a TOML file: what `frenetic calibrate` says, and what only a file says."""

from __future__ import annotations

import tomllib
from pathlib import Path

from msgspec import convert

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

    @classmethod
    def read(cls, path: Path) -> CalibrationFile:
        """The entries of a file.

        Raises:
            FreneticError: there is no such file, or it is wrong; the message names the place in it.
        """
        try:
            return convert(tomllib.loads(path.read_text(encoding="utf-8")), cls)
        except FileNotFoundError:
            raise FreneticError(f"there is no file {path}") from None
        except OSError as error:
            raise FreneticError(f"{path} cannot be read: {error.strerror or error}") from None
        except (ValueError, RecursionError) as error:
            raise FreneticError(f"{path} does not say a calibration: {error}") from None

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
