"""The search with foresight: a twin of the driver under test says what a road will bring.

The twin is a law and a car of the embedded simulator. It is fitted to the drives of the search
itself, again and again, see `frenetic.plugins.twin.fitting`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.campaign.objective import Objective, evaluate
from frenetic.conditions.condition import SEED, condition_named
from frenetic.errors import FreneticError
from frenetic.parts.registry import STRATEGIES, hint
from frenetic.parts.versions import SHORT
from frenetic.plugins.twin.fitting import LEAST, Fit, RecordedDrive, drive_twin, on_grid
from frenetic.plugins.twin.model import TwinModel
from frenetic.plugins.twin.profile import TwinProfile
from frenetic.plugins.twin.recordings import RecordedTerms
from frenetic.road import Road
from frenetic.search import Frenetic
from frenetic.search.records import Candidate, Evaluation
from frenetic.simulators.capabilities import capabilities
from frenetic.simulators.conditions import rules_in
from frenetic.simulators.embedded.vehicle import CARS
from frenetic.spec import Spec

LAWS: Final = {
    "planner": ("lookahead_time=0.02:1.5", "lookahead_min=1:15"),
    "stanley": ("offset_gain=0.2:6", "softening=0.2:6"),
}
"""Driver -> the parameters of its steering that are fitted."""
SPEED: Final = ("lateral_acceleration=1.5:40", "braking=0.8:10", "speed_gain=0.3:6")
"""Parameters of the driver's speed that are fitted."""
CAR: Final = (
    "vehicle.tyre_peak=0.4:1.5",
    "vehicle.steering_lag=0.02:0.6",
    "vehicle.steering_rate=0.15:2",
    "vehicle.engine_acceleration=1.5:12",
)
"""Parameters of the car that are fitted."""

_FIRST_FIT: Final = 20  # drives before the first fit
_GROWTH: Final = 1.5  # growth of the number of drives from one fit to the next
_FITTED: Final = 40  # drives that a fit looks at, half of them the last ones
_HOPELESS: Final = 4.0  # times the least loss, with which a law is not fitted again


def foresight(
    spec: Spec, profile: Path | str | None = None, vehicle: str | None = None, **options: Any
) -> Frenetic:
    """Return Frenetic with a twin that learns the driver and foresees how roads will be driven.

    Args:
        spec: spec of the campaign.
        profile: file of a twin's profile, which foresees from the start; what it says to be fitted
            is fitted on. By default the laws of `LAWS` are.
        vehicle: name of their car, one of `CARS`; by default that with the simulator's name, if
            there is one.
        options: options of `Frenetic`.

    Raises:
        FreneticError: the profile cannot be read, or is for other terms; its driver is not
            compiled; or there is no such option.
    """
    known = {*(STRATEGIES.option_names(Frenetic) or ())} - {"foresight"}
    if unknown := sorted(options.keys() - known):
        raise FreneticError(
            f"the strategy foresight has no option {unknown[0]!r}{hint(unknown[0], known)}"
            f" It has: profile, vehicle, {', '.join(sorted(known - options.keys()))}"
        )
    twin_options = {}
    if profile is None:
        simulator = spec.part("simulator").name
        if vehicle is None and simulator in CARS:
            vehicle = simulator
        fit = {law: [*SPEED, *steering, *CAR] for law, steering in LAWS.items()}
        car = {} if vehicle is None else {"name": vehicle}
        models = [TwinModel.of(law, names, vehicle=car) for law, names in fit.items()]
    else:
        twin_profile = TwinProfile.read(profile)
        profile_terms, search_terms = (
            _recorded_terms(source) for source in (twin_profile.spec(), spec)
        )
        if differing := profile_terms.differences(search_terms):
            raise FreneticError(
                f"{profile} is the profile of a twin for other terms ({differing}): give the search"
                " the same, or calibrate a twin for them"
            )
        models = [TwinModel.of_profile(twin_profile)]
        twin_options["profile"] = f"{profile} (SHA-256 {twin_profile.digest()[:SHORT]})"
    search_options: dict[str, Any] = {
        "seed": spec.seed,
        "map_size": spec.terms.map_size,
        "road_class": spec.road_class,
        "domain": spec.domain,
        **options,
    }
    twin = OnlineTwin(models, spec, is_ready=profile is not None)
    if vehicle is not None:
        twin_options["vehicle"] = vehicle
    return ForesightSearch(twin, twin_options, **search_options)


def _recorded_terms(spec: Spec) -> RecordedTerms:
    return RecordedTerms.of(spec.terms, rules_in(spec.conditions, spec.rules))


class ForesightSearch(Frenetic):
    """`Frenetic` with the foresight of a twin.

    Args:
        twin: the twin that foresees.
        made_with: what the twin was made with, for a campaign's record.
        options: options of `Frenetic`.
    """

    BEHAVIOUR: ClassVar[int] = 100 * Frenetic.BEHAVIOUR + 1
    """Raised when its proposals change; campaigns record it."""

    def __init__(self, twin: OnlineTwin, made_with: Mapping[str, Any], **options: Any) -> None:
        super().__init__(foresight=twin, **options)
        self.options |= made_with


class OnlineTwin:
    """A twin that is fitted while it foresees, see `frenetic.search.prediction.Foresight`.

    Of some models, each a law and a car, the one that follows the drives best foresees.

    Args:
        models: with the parameters that are fitted; without any, a model stays as it is.
        spec: of the search, whose rules, lanes, road class and objective are the twin's.
        is_ready: whether the first model foresees before anything was fitted.

    Raises:
        FreneticError: a model's driver is not compiled.
    """

    def __init__(self, models: Sequence[TwinModel], spec: Spec, *, is_ready: bool = False) -> None:
        self._fits = [Fit(model, rules_in(spec.conditions, spec.rules)) for model in models]
        self._spec = spec
        self._objective = Objective.load(spec.named_objective)
        self._places = [
            np.array([parameter.place for parameter in model.parameters]) for model in models
        ]
        self._losses = [math.inf] * len(models)
        self._best = 0
        self._drives: list[tuple[Candidate, FloatArray]] = []
        self._next_fit = _FIRST_FIT
        self.is_ready = is_ready
        """Whether it can tell what the driver will do."""
        parts = [fit.parts(places) for fit, places in zip(self._fits, self._places, strict=True)]
        for model, (driver, simulator) in zip(models, parts, strict=True):
            if not simulator.drives_compiled(driver):
                raise FreneticError(
                    f"{model.driver} is no driver for a twin that drives thousands of"
                    " roads: choose one of ours, such as planner or stanley"
                )
        self._parts = parts[0]  # the best model's
        self._variable = capabilities(self._parts[1]).variable

    # Foreseeing

    def foresee(self, candidate: Candidate) -> Evaluation | None:
        """Return the twin's evaluation of a candidate; None if it comes to no end on its road."""
        road = self._road(candidate)
        driver, simulator = self._parts
        drive = drive_twin(simulator, driver, road, self._conditions(candidate))
        evaluation = evaluate(candidate, road, drive, objective=self._objective)
        return evaluation if evaluation.outcome.is_driven else None

    def facts(self) -> Mapping[str, Any]:
        """Return the twin, and its loss in the last fit: 0 if it drives alike."""
        loss, model = self._losses[self._best], self._fits[self._best].model
        values = model.values(self._places[self._best].tolist())
        words = [f"{name.partition('.')[2]} {value:.3g}" for name, value in values.items()]
        facts = {"twin": ", ".join([model.driver, *words])}
        return facts if math.isinf(loss) else {**facts, "loss": float(f"{loss:.2g}")}

    # Learning

    def learn(self, candidate: Candidate, evaluation: Evaluation) -> None:
        """Take a drive; fit now and then."""
        trace = evaluation.trace
        if trace is None or len(trace.distance) < 2 or not self._places[self._best].size:
            return
        states = on_grid(trace.distance, trace.lateral_offset, trace.speed)
        if states.shape[1] < LEAST:
            return
        self._drives.append((candidate, states))
        if len(self._drives) == self._next_fit:
            self._next_fit = math.ceil(_GROWTH * self._next_fit)
            self._fit()

    def _fit(self) -> None:
        half = _FITTED // 2
        earlier, last = self._drives[:-half], self._drives[-half:]
        rows = np.linspace(0, len(earlier) - 1, min(half, len(earlier))).astype(int)
        drives = [
            RecordedDrive(
                road=self._road(candidate), states=states, conditions=self._conditions(candidate)
            )
            for candidate, states in (*(earlier[row] for row in rows.tolist()), *last)
        ]
        hopeless = _HOPELESS * min(self._losses)
        for number, loss in enumerate(self._losses):
            if loss <= hopeless:
                fitted = self._fits[number].fitted(self._places[number], drives)
                self._losses[number], self._places[number] = fitted
        self._best = int(np.argmin(self._losses))
        self._parts = self._fits[self._best].parts(self._places[self._best])
        self.is_ready = True

    # Parts

    def _road(self, candidate: Candidate) -> Road:
        return candidate.road(self._spec.terms.lane_width, road_class=self._spec.road_class)

    def _conditions(self, candidate: Candidate) -> Mapping[str, int | float]:
        """A candidate's conditions, as far as they are the car's and the embedded simulator's."""
        return {
            name: value
            for name, value in candidate.conditions.items()
            if name != SEED and condition_named(name).attribute in self._variable
        }
