"""The profile of a twin: a driver and a car of the embedded simulator that drive as others do.

`frenetic calibrate` writes it, `--as` reads how it drives, like a failing road's file. It is one
JSON file, which may come from anywhere, so everything in it is validated. It names parts; reading
it makes and imports none.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

import msgspec
from msgspec import Meta, Struct

from frenetic._support.files import write_file
from frenetic.errors import FreneticError
from frenetic.spec import MAX_BYTES, Spec, describe, drive_record
from frenetic.trust import NOT_DRIVING
from frenetic.versions import other_version

VERSION: Final = 1
"""Version of the format; a newer one is refused."""

Positive = Annotated[float, Meta(gt=0.0)]
Count = Annotated[int, Meta(ge=0)]


class Record(Struct, frozen=True, forbid_unknown_fields=True):
    """An object of a profile; an entry that it does not know is a mistake."""


class Fitted(Record, frozen=True, kw_only=True):
    """A fitted parameter."""

    name: str
    """Such as ``driver.braking``, ``vehicle.friction`` or ``layer.delay``."""
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


class Recording(Record, frozen=True, kw_only=True):
    """What a twin was fitted on."""

    name: str
    """Name of the file or folder."""
    sha256: str
    """Fingerprint of the drives that were read from it."""
    drives: Count
    failures: Count
    runs: Count


class Figures(Record, frozen=True, kw_only=True):
    """How well a twin follows recorded drives; None where the data cannot say."""

    drives: Count
    """Number of drives."""
    failures: Count
    """Number of them that failed."""
    auc: float | None = None
    """Chance that a drive that failed ranks above one that passed."""
    rank_correlation: float | None = None
    """Spearman's, of the largest oob shares."""
    top_tenth: float | None = None
    """Share of failures in the tenth of the roads that rank first, over that in all."""
    early_half: float | None = None
    """Share of the roads, as ranked, that hold half of all failures."""
    twin_failures: Count | None = None
    """Number of drives in which the twin fails."""
    agreement: float | None = None
    """Share of equal outcomes."""
    offset_error: float | None = None
    """Median over drives of the median absolute error of the lateral offset, in m."""
    speed_error: float | None = None
    """The same of the speed, in m/s, or a share of the mean speed where only shapes compare."""
    departure_gap: float | None = None
    """Median distance along the road between both places of departure, in m."""
    common_departures: Count = 0
    """Number of drives in which both cars leave the lane."""
    near_departures: float | None = None
    """Share of these with a gap of at most 20 m."""


class Link(Record, frozen=True, kw_only=True):
    """The chance of a recorded failure: 1 / (1 + exp(-(intercept + slope * score)))."""

    intercept: float
    slope: float
    """Per m of the score, the twin's MOOBD with the other sign."""


class Validation(Record, frozen=True, kw_only=True):
    """The cross-validated figures of a twin and of its baselines."""

    by: Literal["run", "road"]
    """What was held out as a whole."""
    folds: Count
    twin: Figures
    """On drives that its parameters have not seen."""
    baselines: dict[str, Figures]
    """Name -> figures on the same folds."""
    link: Link | None = None
    verdict: Literal["good", "fair", "poor", "unknown"]
    """Whether it is good enough to screen with."""
    reason: str
    """Why, in a sentence."""


class Fit(Record, frozen=True, kw_only=True):
    """The settings of a fit."""

    seed: Count
    evaluations: Count
    """Number of candidates in each fold and in the final fit."""
    sample: Count
    """Most drives of a fit."""
    weights: dict[str, float]
    """Name of a term of the loss -> its weight."""
    loss: float
    """Of the twin on the drives that it was fitted on."""


class Profile(Record, frozen=True, kw_only=True):
    """A twin: a driver and a car that drive, in the embedded simulator, as others do.

    Only its name and how it drives are needed; what a fit says about itself may be missing.
    """

    version: int = VERSION
    """Version of the format."""
    name: str
    """Name for people."""
    driven: dict[str, Any]
    """Driver, car, layers and rules, as `frenetic.spec.drive_record` has them."""
    lane_width: Positive = 4.0
    """m."""
    parts: dict[str, dict[str, Any]] = {}
    """``driver`` and ``simulator`` as `frenetic.spec.describe` gives them, to notice changes."""
    fitted: list[Fitted] = []
    recordings: list[Recording] = []
    validation: Validation | None = None
    fit: Fit | None = None
    written_by: str = ""
    """Version of frenetic."""

    @classmethod
    def of(cls, name: str, spec: Spec, **about: Any) -> Self:
        """The profile of a twin with the parts, rules, map and lanes of a spec.

        Args:
            name: for people.
            spec: names driver and simulator.
            about: other fields.
        """
        driven = drive_record(spec.with_limit().to_json())
        return cls(name=name, driven=driven or {}, lane_width=spec.lane_width, **about)

    @classmethod
    def read(cls, path: Path | str) -> Self:
        """The profile in a file.

        Raises:
            FreneticError: there is none; the message names the file and the place in it.
        """
        path = Path(path)
        try:
            with path.open("rb") as file:
                data = file.read(MAX_BYTES + 1)
        except FileNotFoundError:
            raise FreneticError(
                f"there is no profile {path}: 'frenetic calibrate' writes one"
            ) from None
        except OSError as error:
            raise FreneticError(f"{path} cannot be read: {error.strerror or error}") from None
        if len(data) > MAX_BYTES:
            raise FreneticError(f"{path} is no profile: it has more than {MAX_BYTES} bytes")
        try:
            document = msgspec.json.decode(data)
            version = document.get("version") if isinstance(document, dict) else None
            if isinstance(version, int) and version > VERSION:
                raise FreneticError(
                    f"{path} was written by a newer version of frenetic: upgrade frenetic"
                )
            profile = msgspec.convert(document, cls)
            if profile.version < 1:
                raise ValueError(f"version is {profile.version}: {VERSION} is needed")
        except (ValueError, RecursionError) as error:
            raise FreneticError(f"{path} is no profile of a twin: {error}") from None
        Spec.from_drive_record(profile.driven, source=path)
        return profile

    def write(self, path: Path | str) -> None:
        """Writes the profile; the file is replaced whole.

        Raises:
            FreneticError: it cannot be written.
        """
        text = msgspec.json.format(msgspec.json.encode(self), indent=2).decode() + "\n"
        write_file(path, text, remedy="choose another place", parents=True)

    def spec(self) -> Spec:
        """The spec of the twin: driver, layers, car, rules, map and lane width.

        Raises:
            FreneticError: it is out of range, or the driver is code that is not loaded unasked
                (`frenetic.trust`).
        """
        source = f"the profile {self.name!r}"
        own = Spec.from_drive_record(self.driven, source=source)
        own.require_trusted(source, NOT_DRIVING)
        return replace(own, lane_width=self.lane_width)

    def changes(self) -> list[str]:
        """How driver and simulator differ from those that were fitted, each in a line.

        Raises:
            FreneticError: the driver cannot be made.
        """
        spec = self.spec()
        ours = {"driver": spec.make_driver(), "simulator": spec.make_simulator()}
        texts = (other_version(kind, self.parts.get(kind), describe(ours[kind])) for kind in ours)
        return [text for text in texts if text]
