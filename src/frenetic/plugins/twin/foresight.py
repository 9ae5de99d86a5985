"""The search with foresight: a twin predicts how the driver under test will drive a road.

The twin is a built-in driver (a law) with a car of the embedded simulator. It is fitted to the
drives of the search itself, again and again, see `frenetic.plugins.twin.fitting`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.campaign.evaluation import evaluate
from frenetic.campaign.objective import Objective
from frenetic.conditions.condition import SEED, condition_named
from frenetic.errors import FreneticError
from frenetic.parts.construction import option_names
from frenetic.parts.registry import hint
from frenetic.parts.versions import SHORT
from frenetic.plugins.twin.fitting import Fitter
from frenetic.plugins.twin.model import TwinModel
from frenetic.plugins.twin.profile import TwinProfile
from frenetic.plugins.twin.recorded_drive import MIN_POSITIONS, RecordedDrive, on_grid
from frenetic.plugins.twin.recordings import RecordedTerms
from frenetic.road import Road
from frenetic.search import Frenetic
from frenetic.search.records import Candidate, Evaluation
from frenetic.simulators.capabilities import capabilities
from frenetic.simulators.conditions import in_conditions, rules_in
from frenetic.simulators.embedded.vehicle import CARS
from frenetic.spec import Spec

LAWS: Final = {
    "planner": ("lookahead_time=0.02:1.5", "lookahead_min=1:15"),
    "stanley": ("offset_gain=0.2:6", "softening=0.2:6"),
}
"""Driver -> the parameters of its steering that are fitted, with bounds of our choice."""
SPEED: Final = ("lateral_acceleration=1.5:40", "braking=0.8:10", "speed_gain=0.3:6")
"""Parameters of either driver's speed that are fitted, with bounds of our choice."""
CAR: Final = (
    "vehicle.tyre_peak=0.4:1.5",
    "vehicle.steering_lag=0.02:0.6",
    "vehicle.steering_rate=0.15:2",
    "vehicle.engine_acceleration=1.5:12",
)
"""Parameters of the car that are fitted, with bounds of our choice."""

# Our choice:
_FIRST_FIT_DRIVES: Final = 20  # after which the first fit is made
_DRIVES_GROWTH: Final = 1.5  # factor of the number of drives from one fit to the next
_DRIVES_OF_FIT: Final = 40  # that a fit looks at, half of them the latest ones
_HOPELESS_LOSS_RATIO: Final = 4.0  # to the least loss, above which a model is not fitted again


def foresight(
    spec: Spec, profile: Path | str | None = None, vehicle: str | None = None, **options: Any
) -> Frenetic:
    """Return Frenetic with a twin that learns the driver and foresees how roads will be driven.

    Args:
        spec: spec of the campaign.
        profile: file of a twin's profile; this twin foresees from the start, and the fit of its
            parameters continues. By default the drivers of `LAWS` are fitted from their defaults.
        vehicle: name of the car of the drivers of `LAWS`, one of `CARS`; by default the car that
            has the simulator's name, if there is one.
        options: options of `Frenetic`.

    Raises:
        FreneticError: the profile cannot be read, or is for other terms; its driver is not
            compiled; or there is no such option.
    """
    known = {*(option_names(Frenetic) or ())} - {"foresight"}
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
        models = _built_in_models(vehicle)
    else:
        twin_profile = TwinProfile.read(profile)
        profile_terms, search_terms = _terms_of(twin_profile.spec()), _terms_of(spec)
        if differences := profile_terms.differences(search_terms):
            raise FreneticError(
                f"{profile} is the profile of a twin for other terms ({differences}): give the"
                " search the same, or calibrate a twin for them"
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


def _built_in_models(vehicle: str | None) -> list[TwinModel]:
    """Return the models of `LAWS`, with a car by its name; None for the default car."""
    car = {} if vehicle is None else {"name": vehicle}
    return [
        TwinModel.of(law, [*SPEED, *steering, *CAR], vehicle=car) for law, steering in LAWS.items()
    ]


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

    BEHAVIOUR: ClassVar[int] = 100 * Frenetic.BEHAVIOUR + 1
    """Version of the behaviour; it is raised when proposals change, here or in `Frenetic`."""

    def __init__(self, twin: OnlineTwin, twin_options: Mapping[str, Any], **options: Any) -> None:
        super().__init__(foresight=twin, **options)
        self.options |= twin_options


class OnlineTwin:
    """A twin that is fitted while it foresees, see `frenetic.search.prediction.Foresight`.

    Several models, each a driver and a car, are fitted. The model of least loss foresees.

    Args:
        models: models with the parameters that are fitted; one without parameters stays as it is.
        spec: spec of the search; its rules, lanes, road class and objective hold for the twin.
        is_ready: whether the first model foresees before the first fit.

    Raises:
        FreneticError: a model's driver is not compiled.
    """

    def __init__(self, models: Sequence[TwinModel], spec: Spec, *, is_ready: bool = False) -> None:
        self._fitters = [Fitter(model, rules_in(spec.conditions, spec.rules)) for model in models]
        self._spec = spec
        self._objective = Objective.load(spec.named_objective)
        # Of each model, before the first fit:
        self._unit_values = [
            np.array([parameter.unit_start for parameter in model.parameters]) for model in models
        ]
        self._losses = [math.inf] * len(models)
        self._best = 0  # number of the model that foresees
        self._drives: list[tuple[Candidate, FloatArray]] = []  # with states every `GRID` m
        self._next_fit = _FIRST_FIT_DRIVES  # number of drives
        self.is_ready = is_ready
        """Whether the twin can predict drives."""
        parts = [
            fitter.parts(unit_values)
            for fitter, unit_values in zip(self._fitters, self._unit_values, strict=True)
        ]
        for model, (driver, simulator) in zip(models, parts, strict=True):
            if not simulator.drives_compiled(driver):
                raise FreneticError(
                    f"{model.driver} is no driver for a twin that drives thousands of"
                    " roads: choose a built-in one, such as planner or stanley"
                )
        self._parts = parts[0]  # of the model that foresees
        self._variable = capabilities(self._parts[1]).variable

    # Foreseeing

    def foresee(self, candidate: Candidate) -> Evaluation | None:
        """Return the twin's evaluation of a candidate; None if it neither passes nor fails."""
        road = self._road(candidate)
        driver, simulator = self._parts
        with in_conditions(self._conditions(candidate), simulator, driver) as changed_driver:
            drive = simulator.drive(road, changed_driver)
        evaluation = evaluate(candidate, road, drive, objective=self._objective)
        return evaluation if evaluation.outcome.is_driven else None

    def facts(self) -> Mapping[str, Any]:
        """Return the driver and parameters of the twin, and its loss in the last fit.

        A loss of 0 means that the twin drives as the driver under test does.
        """
        loss, model = self._losses[self._best], self._fitters[self._best].model
        values = model.values(self._unit_values[self._best].tolist())
        parameters = [f"{name.partition('.')[2]} {value:.3g}" for name, value in values.items()]
        facts = {"twin": ", ".join([model.driver, *parameters])}
        return facts if math.isinf(loss) else {**facts, "loss": float(f"{loss:.2g}")}

    # Learning

    def learn(self, candidate: Candidate, evaluation: Evaluation) -> None:
        """Keep a drive; fit the models after the 20th drive, the 30th, the 45th and so on."""
        trace = evaluation.trace
        has_parameters = self._unit_values[self._best].size > 0
        if trace is None or len(trace.distance) < 2 or not has_parameters:
            return
        states = on_grid(trace.distance, trace.lateral_offset, trace.speed)
        if states.shape[1] < MIN_POSITIONS:
            return
        self._drives.append((candidate, states))
        if len(self._drives) == self._next_fit:
            self._next_fit = math.ceil(_DRIVES_GROWTH * self._next_fit)
            self._fit_models()

    def _fit_models(self) -> None:
        """Fit the models that are not hopeless, and choose the one of least loss."""
        drives = self._drives_to_fit()
        max_loss = _HOPELESS_LOSS_RATIO * min(self._losses)
        for number, loss in enumerate(self._losses):
            if loss <= max_loss:
                fitted = self._fitters[number].fit(self._unit_values[number], drives)
                self._losses[number], self._unit_values[number] = fitted
        self._best = int(np.argmin(self._losses))
        self._parts = self._fitters[self._best].parts(self._unit_values[self._best])
        self.is_ready = True

    def _drives_to_fit(self) -> list[RecordedDrive]:
        """Return the latest drives, and as many that are evenly spread over the earlier ones."""
        half = _DRIVES_OF_FIT // 2
        earlier, latest = self._drives[:-half], self._drives[-half:]
        spread = np.linspace(0, len(earlier) - 1, min(half, len(earlier))).astype(int)
        return [
            RecordedDrive(
                road=self._road(candidate), states=states, conditions=self._conditions(candidate)
            )
            for candidate, states in (*(earlier[i] for i in spread.tolist()), *latest)
        ]

    # Roads and conditions of candidates

    def _road(self, candidate: Candidate) -> Road:
        return candidate.road(self._spec.terms.lane_width, road_class=self._spec.road_class)

    def _conditions(self, candidate: Candidate) -> Mapping[str, int | float]:
        """Return the conditions of a candidate that the embedded simulator applies to its car."""
        return {
            name: value
            for name, value in candidate.conditions.items()
            if name != SEED and condition_named(name).attribute in self._variable
        }
