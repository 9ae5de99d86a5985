"""The profile of a twin: a driver and a car of the embedded simulator that drive as others do.

`frenetic calibrate` writes it, `--as` reads how it drives, like a failing road's file. It is one
JSON file, which may come from anywhere, so everything in it is validated. It names parts; reading
it makes and imports none.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any, Literal, Self

import msgspec
from msgspec import Struct

from frenetic._support.bounds import Index, Positive
from frenetic._support.files import read_bounded, write_file
from frenetic._support.outside_text import read_json
from frenetic.errors import FreneticError
from frenetic.parts.trust import is_here, named_code
from frenetic.road import LANE_WIDTH
from frenetic.spec import SIGNED, USUAL, Spec


class ProfileRecord(Struct, frozen=True, forbid_unknown_fields=True):
    """An object of a profile; an entry that it does not know is a mistake."""


class Fitted(ProfileRecord, frozen=True, kw_only=True):
    """A fitted parameter."""

    name: str
    """Such as ``driver.braking``, ``vehicle.friction`` or ``condition.delay``."""
    value: float
    low: float
    """Lower bound of the fit."""
    high: float
    """Upper bound of the fit."""
    from_: float = msgspec.field(name="from")
    """Lower end of the interval in which the data leave it."""
    to: float
    """Upper end of that interval."""
    is_determined: bool
    """Whether the data determine it."""
    at_bound: bool
    """Whether that interval ends at one of its bounds, so that the bound decides."""


class PredictionFigures(ProfileRecord, frozen=True, kw_only=True):
    """How well a ranking of roads follows recorded drives; None where the data cannot say."""

    auc: float | None = None
    """Chance that a drive that failed ranks above one that passed."""
    top_tenth: float | None = None
    """Share of failures in the tenth of the roads that rank first, over that in all."""
    twin_failures: Index | None = None
    """Number of drives in which the twin fails."""
    agreement: float | None = None
    """Share of equal outcomes."""
    offset_error: float | None = None
    """Median over drives of the median absolute error of the lateral offset, in m."""


class Validation(ProfileRecord, frozen=True, kw_only=True):
    """The cross-validated figures of a twin and of its baselines."""

    drives: Index
    """Number of recorded drives."""
    failures: Index
    """Number of them that failed."""
    by: Literal["run", "road"]
    """What was held out as a whole."""
    twin: PredictionFigures
    """On drives that its parameters have not seen."""
    baselines: dict[str, PredictionFigures]
    """Name -> figures on the same folds."""
    verdict: Literal["good", "fair", "poor", "unknown"]
    """Whether it is good enough to start from."""
    reason: str
    """Why, in a sentence."""


class TwinProfile(ProfileRecord, frozen=True, kw_only=True):
    """A twin: a driver and a car that drive, in the embedded simulator, as others do.

    Only its name and how it drives are needed; what a fit says about itself may be missing.
    """

    version: Literal[1] = 1
    """Version of the format; another is refused."""
    name: str
    """Name for people."""
    driven: dict[str, Any]
    """Driver, car, conditions and rules, as `frenetic.spec.Spec.driving_spec` gives them."""
    lane_width: Positive = LANE_WIDTH
    """m."""
    fitted: list[Fitted] = []
    recordings: list[str] = []
    """Files and folders that it was fitted on."""
    validation: Validation | None = None

    @classmethod
    def of(cls, name: str, spec: Spec, **about: Any) -> Self:
        """Return the profile of a twin with the parts, rules, map and lanes of a spec.

        Args:
            name: for people.
            spec: names driver and simulator.
            about: other fields.
        """
        driven = Spec.of(USUAL, spec).driving_spec().signed_in(Path.cwd()).entries()
        return cls(name=name, driven=driven, lane_width=spec.terms.lane_width, **about)

    @classmethod
    def read(cls, path: Path | str) -> Self:
        """Return the profile in a file.

        Raises:
            FreneticError: there is none; the message names the file and the place in it.
        """
        Spec.read_driven(path)  # there is a file of a sane size that says how roads are driven
        try:
            return read_json(read_bounded(Path(path)), cls)
        except ValueError as error:
            raise FreneticError(f"{path} is no profile of a twin: {error}") from None

    def write(self, path: Path | str) -> None:
        """Write the profile; the file is replaced whole.

        Raises:
            FreneticError: it cannot be written.
        """
        text = msgspec.json.format(msgspec.json.encode(self), indent=2).decode() + "\n"
        write_file(path, text, remedy="choose another place", parents=True)

    def spec(self) -> Spec:
        """Return the spec of the twin: driver, conditions, car, rules, map and lane width.

        Raises:
            FreneticError: it is out of range, or the driver is code that is not loaded unasked
                (`frenetic.parts.trust`).
        """
        source = f"the profile {self.name!r}"
        twin = Spec.of_driven(self.driven, source=source)
        folder = twin.require_trusted(source, optional=())
        kinds = () if is_here(folder) else named_code(twin.parts)
        twin = twin.with_files_in(dict.fromkeys(kinds, folder))
        return Spec.of(twin, {"lane_width": self.lane_width})

    def digest(self) -> str:
        """A digest of all but its user's signature."""
        driven = {name: value for name, value in self.driven.items() if name != SIGNED}
        data = msgspec.json.encode(msgspec.structs.replace(self, driven=driven))
        return hashlib.sha256(data).hexdigest()
