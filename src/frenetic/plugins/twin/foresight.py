"""The search with foresight: a twin predicts how the driver under test will drive a road.

The twin drives in the embedded simulator. Its driver is the driver under test or, where that cannot
drive there, a built-in law. It is fitted to the drives of the search itself, again and again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

from frenetic.drivers.driver import Driver
from frenetic.errors import FreneticError
from frenetic.parts.construction import option_names
from frenetic.parts.registry import hint
from frenetic.parts.versions import SHORT
from frenetic.plugins.twin.law_twin import LawTwin, law_models
from frenetic.plugins.twin.model import TwinModel
from frenetic.plugins.twin.own_driver import DriverUnderTest, OwnDriverTwin
from frenetic.plugins.twin.profile import TwinProfile
from frenetic.plugins.twin.recordings import RecordedTerms
from frenetic.plugins.twin.twin_drives import UnsuitableDriverError
from frenetic.search import Frenetic
from frenetic.search.prediction import Foresight
from frenetic.search.records import Candidate, Evaluation
from frenetic.simulators.conditions import rules_in
from frenetic.simulators.embedded.vehicle import CARS
from frenetic.simulators.simulator import Simulator
from frenetic.spec import Spec


def foresight(
    spec: Spec,
    profile: Path | str | None = None,
    vehicle: str | None = None,
    *,
    driver: Driver | None = None,
    simulator: Simulator | None = None,
    laws: bool = False,
    **options: Any,
) -> Frenetic:
    """Return Frenetic with a twin that foresees how the driver will drive roads.

    Args:
        spec: spec of the campaign.
        profile: file of a twin's profile; this twin foresees from the start, and the fit of its
            parameters continues.
        vehicle: name of the car with which the fit begins, one of `CARS`; by default the car that
            has the simulator's name, if there is one.
        driver: driver of the campaign, which stays as it is: the twin makes its own by the spec's
            name, or copies one without a name. None if somebody else drives.
        simulator: simulator of the campaign, of which the twin reads car, rules and setup.
        laws: whether the twin's driver is one of `law_twin.LAWS`, even if the campaign's driver
            could drive in the twin's car.
        options: options of `Frenetic`.

    Raises:
        FreneticError: the profile cannot be read, or is for other terms; its driver is not
            compiled; or there is no such option.
    """
    known = {*(option_names(Frenetic) or ())} - {"foresight"}
    if unknown := sorted(options.keys() - known):
        raise FreneticError(
            f"the strategy foresight has no option {unknown[0]!r}{hint(unknown[0], known)}"
            f" It has: profile, vehicle, laws, {', '.join(sorted(known - options.keys()))}"
        )
    twin_options: dict[str, Any] = {"laws": True} if laws else {}
    twin: Foresight
    if profile is not None:
        twin = _twin_of_profile(profile, spec)
        twin_options["profile"] = f"{profile} (SHA-256 {_digest(profile)})"
    else:
        name = spec.part("simulator").name
        if vehicle is None and name in CARS:
            vehicle = name
        tested = DriverUnderTest(spec, driver, simulator)
        twin = LawTwin(law_models(vehicle), spec) if laws else SearchTwin(tested, vehicle)
    if vehicle is not None:
        twin_options["vehicle"] = vehicle
    search_options: dict[str, Any] = {
        "seed": spec.seed,
        "map_size": spec.terms.map_size,
        "road_class": spec.road_class,
        "domain": spec.domain,
        **options,
    }
    return ForesightSearch(twin, twin_options, **search_options)


def _digest(profile: Path | str) -> str:
    """Return the short digest of a profile."""
    return TwinProfile.read(profile).digest()[:SHORT]


def _twin_of_profile(profile: Path | str, spec: Spec) -> LawTwin:
    """Return the twin of a profile, which foresees from the start.

    Raises:
        FreneticError: the profile cannot be read, or is for other terms than the search; or its
            driver is not compiled.
    """
    twin_profile = TwinProfile.read(profile)
    profile_terms, search_terms = _terms_of(twin_profile.spec()), _terms_of(spec)
    if differences := profile_terms.differences(search_terms):
        raise FreneticError(
            f"{profile} is the profile of a twin for other terms ({differences}): give the"
            " search the same, or calibrate a twin for them"
        )
    return LawTwin([TwinModel.of_profile(twin_profile)], spec, is_ready=True)


def _terms_of(spec: Spec) -> RecordedTerms:
    """Return the terms of a spec's drives."""
    return RecordedTerms.of(spec.terms, rules_in(spec.conditions, spec.rules))


class ForesightSearch(Frenetic):
    """`Frenetic` with the foresight of a twin.

    Args:
        twin: the twin that foresees.
        twin_options: options that the twin was made with, for a campaign's record.
        options: options of `Frenetic`.
    """

    BEHAVIOUR: ClassVar[int] = 100 * Frenetic.BEHAVIOUR + 2
    """Version of the behaviour; it is raised when proposals change, here or in `Frenetic`."""

    def __init__(self, twin: Foresight, twin_options: Mapping[str, Any], **options: Any) -> None:
        super().__init__(foresight=twin, **options)
        self.options |= twin_options


class SearchTwin:
    """The twin of a search: the driver under test or, where that cannot drive, a law.

    See `frenetic.search.prediction.Foresight`.

    Args:
        tested: driver and simulator of the search.
        vehicle: name of the car with which a fit begins, one of `CARS`; None for the default car.
    """

    def __init__(self, tested: DriverUnderTest, vehicle: str | None) -> None:
        self._spec, self._vehicle = tested.spec, vehicle
        self._early: list[tuple[Candidate, Evaluation]] = []  # drives before the first fit
        self._reason = ""  # why the driver under test does not drive in the twin
        self._twin: OwnDriverTwin | LawTwin
        try:
            self._twin = OwnDriverTwin(tested, vehicle)
        except UnsuitableDriverError as error:
            self._take_law(error)

    def _take_law(self, error: UnsuitableDriverError) -> None:
        """Let a law drive in place of the driver under test."""
        self._reason = str(error)
        self._twin = LawTwin(law_models(self._vehicle), self._spec)
        for candidate, evaluation in self._early:
            self._twin.learn(candidate, evaluation)
        self._early.clear()

    @property
    def is_ready(self) -> bool:
        """Whether the twin can foresee."""
        return self._twin.is_ready

    def learn(self, candidate: Candidate, evaluation: Evaluation) -> None:
        """Learn from a drive; fit the twin after the 20th drive, the 30th, the 45th and so on."""
        if not (self._reason or self._twin.is_ready):
            self._early.append((candidate, evaluation))
        try:
            self._twin.learn(candidate, evaluation)
        except UnsuitableDriverError as error:
            self._take_law(error)
        if self._twin.is_ready:
            self._early.clear()

    def foresee(self, candidates: Sequence[Candidate]) -> Sequence[Evaluation | None]:
        """Return the twin's evaluation of each candidate; None if nothing is foreseen."""
        return self._twin.foresee(candidates)

    def facts(self) -> Mapping[str, Any]:
        """Return facts about the twin, and why the driver under test does not drive in it."""
        reason = {"your driver does not drive in the twin": self._reason} if self._reason else {}
        return {**self._twin.facts(), **reason}
