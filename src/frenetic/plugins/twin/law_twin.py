"""A twin whose driver is a built-in law, which is fitted to the driver under test, as is its car.

It stands in for a driver that cannot drive in the embedded simulator. It is fitted to the drives of
the search itself, again and again, see `frenetic.plugins.twin.fitting`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.campaign.evaluation import evaluate
from frenetic.campaign.objective import Objective
from frenetic.campaign.tester import RoadTester
from frenetic.conditions.condition import SEED, condition_named
from frenetic.errors import FreneticError
from frenetic.plugins.twin.fitting import Fitter
from frenetic.plugins.twin.model import TwinModel
from frenetic.plugins.twin.recorded_drive import MIN_POSITIONS, RecordedDrive, on_grid
from frenetic.plugins.twin.schedule import FitSchedule
from frenetic.road import Road
from frenetic.search.records import Candidate, Evaluation
from frenetic.simulators.capabilities import capabilities
from frenetic.simulators.conditions import rules_in
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

_HOPELESS_LOSS_RATIO: Final = 4.0  # to the least loss, above which a model is not fitted again


def law_models(vehicle: str | None) -> list[TwinModel]:
    """Return the models of `LAWS`, with a car by its name; None for the default car."""
    car = {} if vehicle is None else {"name": vehicle}
    return [
        TwinModel.of(law, [*SPEED, *steering, *CAR], vehicle=car) for law, steering in LAWS.items()
    ]


class LawTwin:
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
        self._schedule = FitSchedule()
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

    def foresee(self, candidates: Sequence[Candidate]) -> list[Evaluation | None]:
        """Return the twin's evaluation of each candidate; None if it neither passes nor fails."""
        driver, simulator = self._parts
        roads = [self._road(candidate) for candidate in candidates]
        conditions = [self._conditions(candidate) for candidate in candidates]
        driven = RoadTester(simulator, driver).drive_many(roads, conditions)
        evaluations = [
            evaluate(candidate, road, drive, objective=self._objective)
            for candidate, road, drive in zip(candidates, roads, driven, strict=True)
        ]
        return [each if each.outcome.is_driven else None for each in evaluations]

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
        if self._schedule.is_due(len(self._drives)):
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
        """Return the drives to which the models are fitted."""
        return [
            RecordedDrive(
                road=self._road(candidate), states=states, conditions=self._conditions(candidate)
            )
            for candidate, states in map(
                self._drives.__getitem__, self._schedule.chosen(len(self._drives))
            )
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
