"""The profile of a twin: a driver and a car of the embedded simulator that drive as others do.

`frenetic calibrate` writes a profile, and `--as` reads its driver and simulator as from a failing
road's file. A profile is one JSON file, which may come from anywhere, so everything in it is
validated. It names parts; reading it makes and imports none of them.
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
from frenetic.parts.named_code import named_code
from frenetic.parts.trust import is_here, require_trusted
from frenetic.road import LANE_WIDTH
from frenetic.spec import SIGNED, USUAL, Spec


class ProfileRecord(Struct, frozen=True, forbid_unknown_fields=True):
    """An object in a profile; an unknown entry is an error."""


class Fitted(ProfileRecord, frozen=True, kw_only=True):
    """A fitted parameter."""

    name: str
    """Full name, such as ``driver.braking``, ``vehicle.friction`` or ``condition.delay``."""
    value: float
    """Fitted value."""
    low: float
    """Lower bound of the fit."""
    high: float
    """Upper bound of the fit."""
    from_: float = msgspec.field(name="from")
    """Lower end of the interval of values that follow the drives as well as the fitted value."""
    to: float
    """Upper end of the interval."""
    is_determined: bool
    """Whether the drives determine the value: the interval is narrow and within the bounds."""
    at_bound: bool
    """Whether the interval ends at exactly one of the bounds, so that the bound decides."""


class PredictionFigures(ProfileRecord, frozen=True, kw_only=True):
    """How well a ranking of roads follows recorded drives; None where the drives cannot say.

    The last three are None for a ranking without drives of a twin.
    """

    auc: float | None = None
    """Chance that a drive that failed ranks above one that passed."""
    top_tenth: float | None = None
    """Lift of the top tenth: failures' share among the roads that rank first, over that in all."""
    twin_failures: Index | None = None
    """Number of drives in which the twin fails."""
    agreement: float | None = None
    """Share of roads on which twin and record have the same outcome, 0..1."""
    offset_error: float | None = None
    """Median over drives of the median absolute difference of the lateral offset, in m."""


class Validation(ProfileRecord, frozen=True, kw_only=True):
    """The cross-validated figures of a twin and of its baselines."""

    drives: Index
    """Number of recorded drives."""
    failures: Index
    """Number of recorded drives that failed."""
    by: Literal["run", "road"]
    """Whether all drives of a run were held out together, or all drives of a road."""
    twin: PredictionFigures
    """Figures on drives that the twin was not fitted to."""
    baselines: dict[str, PredictionFigures]
    """Name of a baseline -> its figures."""
    verdict: Literal["good", "fair", "poor", "unknown"]
    """Whether the twin is good enough to start a search from."""
    reason: str
    """Reason for the verdict, in a sentence."""


class TwinProfile(ProfileRecord, frozen=True, kw_only=True):
    """A twin: a driver and a car that drive, in the embedded simulator, as others do.

    Only ``name`` and ``driven`` are needed: a profile may be written without a fit.
    """

    version: Literal[1] = 1
    """Version of the format; another is refused."""
    name: str
    """Name for people."""
    driven: dict[str, Any]
    """Driver, car, conditions and rules, as `frenetic.spec.Spec.driving_spec` gives them."""
    lane_width: Positive = LANE_WIDTH
    """Width of a lane, in m."""
    fitted: list[Fitted] = []
    recordings: list[str] = []
    """Files and folders of the drives that the twin was fitted to."""
    validation: Validation | None = None

    @classmethod
    def of(cls, name: str, spec: Spec, **about: Any) -> Self:
        """Return the profile of a twin with the parts, rules, map and lanes of a spec.

        Args:
            name: name for people.
            spec: spec that names driver and simulator.
            about: other fields of the profile.
        """
        driven = Spec.of(USUAL, spec).driving_spec().signed_in(Path.cwd()).entries()
        return cls(name=name, driven=driven, lane_width=spec.terms.lane_width, **about)

    @classmethod
    def read(cls, path: Path | str) -> Self:
        """Return the profile in a file.

        Raises:
            FreneticError: the file cannot be read or holds no profile; the message names the file
                and the entry.
        """
        Spec.read_driven(path)  # raises a plain error if the file is missing or no profile
        try:
            return read_json(read_bounded(Path(path)), cls)
        except ValueError as error:
            raise FreneticError(f"{path} is no profile of a twin: {error}") from None

    def write(self, path: Path | str) -> None:
        """Write the profile; a file that is there is replaced at once, as a whole.

        Raises:
            FreneticError: the file cannot be written.
        """
        text = msgspec.json.format(msgspec.json.encode(self), indent=2).decode() + "\n"
        write_file(path, text, remedy="choose another place", parents=True)

    def spec(self) -> Spec:
        """Return the spec of the twin: driver, conditions, car, rules, map and lane width.

        Raises:
            FreneticError: an entry is out of range, or the driver is code that its user has not
                trusted (`frenetic.parts.trust`).
        """
        source = f"the profile {self.name!r}"
        twin = Spec.of_driven(self.driven, source=source)
        folder = require_trusted(source, twin.code_claim(), optional=())
        # Files are named relative to the folder in which the profile was made.
        kinds = () if is_here(folder) else named_code(twin.parts)
        twin = twin.with_files_in(dict.fromkeys(kinds, folder))
        return Spec.of(twin, {"lane_width": self.lane_width})

    def digest(self) -> str:
        """Return the SHA-256 digest of the profile without its user's signature."""
        driven = {name: value for name, value in self.driven.items() if name != SIGNED}
        data = msgspec.json.encode(msgspec.structs.replace(self, driven=driven))
        return hashlib.sha256(data).hexdigest()
