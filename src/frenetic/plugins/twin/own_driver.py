"""A twin whose driver is the driver under test; its car is fitted to the drives of the search."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.campaign.evaluation import evaluate
from frenetic.campaign.objective import Objective
from frenetic.conditions.condition import SEED, condition_named
from frenetic.drivers import BeamngAi
from frenetic.drivers.driver import Driver
from frenetic.drivers.stack import camera_of, unwrapped
from frenetic.errors import FreneticError
from frenetic.oracle.assessment import assess
from frenetic.oracle.drive import Drive
from frenetic.plugins.twin.car_fit import RecordedMotion, fit_car
from frenetic.plugins.twin.car_model import CarModel
from frenetic.plugins.twin.fitting import residuals_from
from frenetic.plugins.twin.recorded_drive import (
    MIN_POSITIONS,
    RecordedDrive,
    on_grid,
    states_of,
    thinned,
)
from frenetic.plugins.twin.schedule import FitSchedule
from frenetic.plugins.twin.twin_drives import (
    DrivenRoad,
    TwinDrives,
    TwinHost,
    TwinJob,
    UnsuitableDriverError,
)
from frenetic.plugins.twin.twin_simulator import TwinSimulator
from frenetic.road import Road
from frenetic.search.records import Candidate, Evaluation
from frenetic.simulators.conditions import check_pair_in, rules_in
from frenetic.simulators.embedded.vehicle import CARS, Vehicle
from frenetic.simulators.simulator import Simulator
from frenetic.spec import Spec

# Our choice:
_WALL_LIMIT: Final = 20.0  # [s] of a drive of the twin
_COMPARED_DRIVES: Final = 10  # at least, from which the twin's loss follows
_PROBE_BENDS: Final = (  # [1/m] curvatures of two roads that show whether a driver repeats itself
    (0.0, 0.01, 0.03, 0.03, 0.0, -0.03, -0.03, 0.0),
    (0.0, -0.02, -0.04, 0.0, 0.02, 0.0),
)
_OF_CAR: Final = frozenset({"friction", "steering_lag"})
"""Attributes of conditions that are parameters of the car."""
_FITTED_UNDER: Final = _OF_CAR | {"start_offset", "start_heading", "rules", ""}
"""Attributes of the conditions of drives to which the car is fitted; wrappers have none."""


@dataclass(frozen=True)
class DriverUnderTest:
    """What a search knows about its driver and simulator."""

    spec: Spec
    """Spec of the campaign, which names the driver, or not."""
    driver: Driver | None
    """The campaign's driver, which stays as it is; None if somebody else drives."""
    simulator: Simulator | None
    """The campaign's simulator, which stays as it is; None if it is somebody else's."""


class OwnDriverTwin:
    """The driver under test in a car that is fitted while it foresees.

    See `frenetic.search.prediction.Foresight`. The driver drives first after the 20th drive of the
    search, when it first has a car.

    Args:
        tested: driver and simulator of the search.
        vehicle: name of the car with which the fit begins, one of `CARS`; by default the car that
            has the simulator's name, if there is one.

    Raises:
        UnsuitableDriverError: the driver cannot drive in the embedded simulator.
    """

    def __init__(self, tested: DriverUnderTest, vehicle: str | None = None) -> None:
        spec, driver, simulator = tested.spec, tested.driver, tested.simulator
        if driver is None or simulator is None:
            raise UnsuitableDriverError("somebody else drives")
        name = spec.part("simulator").name
        if isinstance(unwrapped(driver), BeamngAi) and name == "beamng":
            raise UnsuitableDriverError("BeamNG.tech itself drives")
        if camera_of(driver) is not None:
            raise UnsuitableDriverError("your driver has a camera, and the twin draws nothing")
        setup = _setup_of(simulator)
        start = Vehicle.named(vehicle or (name if name in CARS else "default"))
        self._model = CarModel.of(start, setup)
        self._simulator = TwinSimulator(
            rules=simulator.rules,
            vehicle=self._model.start,
            body=simulator.car,
            setup=setup,
            wall_limit=_WALL_LIMIT,
        )
        self._spec, self._rules = spec, simulator.rules
        self._driver = driver
        self._check_driver(driver)
        self._drives: TwinDrives | None = None  # started when it is needed first
        self._objective = Objective.load(spec.named_objective)
        self._unit_values = self._model.start_values
        self._car = self._model.start
        self._loss = math.inf
        self._motions: list[RecordedMotion] = []
        self._recorded: list[tuple[Candidate, FloatArray]] = []  # with states every `GRID` m
        self._schedule = FitSchedule()

    def _check_driver(self, driver: Driver) -> None:
        """Check that the driver can drive in the embedded simulator, without driving it.

        Raises:
            UnsuitableDriverError: it cannot.
        """
        try:
            check_pair_in(self._spec.terms.conditions, self._simulator, driver)
        except FreneticError as error:
            raise UnsuitableDriverError(str(error)) from None

    # Foreseeing

    @property
    def is_ready(self) -> bool:
        """Whether the twin can foresee: it has driven, and has not lost too many processes."""
        return self._drives is not None and not self._drives.is_over

    def foresee(self, candidates: Sequence[Candidate]) -> list[Evaluation | None]:
        """Return the twin's evaluation of each candidate; None if it neither passes nor fails."""
        roads = [self._road(candidate) for candidate in candidates]
        drives = self._drive(candidates, roads)
        return [self._evaluation(*values) for values in zip(candidates, roads, drives, strict=True)]

    def _evaluation(
        self, candidate: Candidate, road: Road, drive: Drive | None
    ) -> Evaluation | None:
        """Return the evaluation of a drive; None if it neither passes nor fails."""
        if drive is None:
            return None
        evaluation = evaluate(candidate, road, drive, objective=self._objective)
        return evaluation if evaluation.outcome.is_driven else None

    def _drive(self, candidates: Sequence[Candidate], roads: Sequence[Road]) -> list[Drive | None]:
        """Return the twin's drives; None where the driver broke."""
        assert self._drives is not None
        jobs = [
            TwinJob(road, dict(candidate.conditions))
            for candidate, road in zip(candidates, roads, strict=True)
        ]
        driven = self._drives.drive(self._car, jobs)
        return [self._as_drive(*values) for values in zip(driven, jobs, strict=True)]

    def _as_drive(self, driven: DrivenRoad, job: TwinJob) -> Drive | None:
        """Return a drive with its road and rules; None if the driver broke."""
        if driven.trouble:
            return None
        rules = rules_in(self._spec.terms.conditions_of(job.conditions), self._rules)
        return Drive(driven.trajectory, self._simulator.car, rules, job.road)

    def facts(self) -> Mapping[str, Any]:
        """Return the parameters of the twin's car, and the twin's loss after the last fit.

        A loss of 0 means that the twin drives as the driver under test does.
        """
        values = self._model.values(self._unit_values)
        parameters = [f"{name} {value:.3g}" for name, value in values.items()]
        name = "your driver"
        if self._drives is not None and self._drives.is_over:
            name = "none any more, your driver ended its process or hung too often"
        facts = {"twin": ", ".join([name, *parameters])}
        return facts if math.isinf(self._loss) else {**facts, "loss": float(f"{self._loss:.2g}")}

    # Learning

    def learn(self, candidate: Candidate, evaluation: Evaluation) -> None:
        """Keep a drive; fit the car after the 20th drive, the 30th, the 45th and so on.

        Raises:
            UnsuitableDriverError: before the first fit, the driver does not drive in the embedded
                simulator, or not twice alike.
        """
        trace = evaluation.trace
        if trace is None or trace.trajectory is None or evaluation.fault is not None:
            return
        conditions = self._spec.terms.conditions_of(candidate.conditions)
        attributes = {
            condition_named(name).attribute: value
            for name, value in conditions.items()
            if name != SEED
        }
        if not attributes.keys() <= _FITTED_UNDER or len(trace.distance) < 2:
            return
        states = on_grid(trace.distance, trace.lateral_offset, trace.speed)
        if states.shape[1] < MIN_POSITIONS:
            return
        of_car = {name: attributes[name] for name in _OF_CAR & attributes.keys()}
        self._motions.append(RecordedMotion.of(trace.trajectory, len(trace.distance), of_car))
        self._recorded.append((candidate, states))
        if self._schedule.is_due(len(self._motions)):
            self._fit()

    def _fit(self) -> None:
        """Fit the car, and compare the twin's drives with it."""
        if self._drives is None:
            self._drives = self._started()
        chosen = self._schedule.chosen(len(self._motions))
        motions = [self._motions[i] for i in chosen]
        self._unit_values = fit_car(self._model, self._unit_values, motions)
        self._car = self._model.car(self._unit_values)
        self._loss = self._loss_of(thinned([self._recorded[i] for i in chosen], _COMPARED_DRIVES))

    def _loss_of(self, recorded: Sequence[tuple[Candidate, FloatArray]]) -> float:
        """Return the mean loss of the twin's drives from recorded ones, see `residuals_from`.

        Args:
            recorded: candidates with the recorded states.
        """
        candidates = [candidate for candidate, _ in recorded]
        roads = [self._road(candidate) for candidate in candidates]
        losses = []
        drives = self._drive(candidates, roads)
        for (_, states), road, drive in zip(recorded, roads, drives, strict=True):
            if drive is None:
                return math.inf
            own_states = states_of(drive, assess(road, drive, has_all_shares=False))
            residuals = residuals_from(RecordedDrive(road=road, states=states), own_states)
            losses.append(float(residuals @ residuals))
        return float(np.mean(losses))

    # Driver, roads and conditions

    def _started(self) -> TwinDrives:
        """Return the twin's drives, after the driver has shown that it drives twice alike.

        Raises:
            UnsuitableDriverError: the driver does not drive in the embedded simulator, or not twice
                alike.
        """
        is_named = self._spec.driver is not None
        host = TwinHost(
            self._spec if is_named else None,
            None if is_named else self._driver,
            self._simulator,
            self._spec.terms,
        )
        is_compiled = self._simulator.drives_compiled(self._driver)
        drives = TwinDrives(host, is_compiled=is_compiled, limit=2.0 * _WALL_LIMIT)
        first, second = (Road(np.array(bends), 10.0) for bends in _PROBE_BENDS)
        jobs = [TwinJob(road, {}) for road in (first, second, first)]
        probes = drives.drive(self._model.start, jobs)
        if troubles := [probe.trouble for probe in probes if probe.trouble]:
            raise UnsuitableDriverError(f"your driver broke in the twin's car: {troubles[0]}")
        before, _, after = (probe.trajectory.to_rows() for probe in probes)
        if not np.array_equal(before, after):
            raise UnsuitableDriverError("your driver does not drive twice alike")
        return drives

    def _road(self, candidate: Candidate) -> Road:
        return candidate.road(self._spec.terms.lane_width, road_class=self._spec.road_class)


def _setup_of(simulator: Simulator) -> Any:
    """Return the setup of a drive in a simulator; None if the simulator does not tell it."""
    setup = getattr(simulator, "setup", None)
    return None if setup is None else setup(Road(np.zeros(4), 10.0))
