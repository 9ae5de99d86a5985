"""The search with foresight: a twin of the driver under test says what a road will bring.

The twin is a law and a car of the embedded simulator. It is fitted to the drives of the search
itself, again and again: Levenberg's and Marquardt's steps towards the least differences of lateral
offset and speed along the roads. A car that slides makes them wild, so a fit begins with the parts
of the drives that keep to the lane's middle, and slopes are first taken over long ways.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Final

import msgspec
import numpy as np

from frenetic._support.arrays import FloatArray
from frenetic.campaign.objective import Objective, evaluate
from frenetic.drive import Drive
from frenetic.drivers.driver import Driver
from frenetic.errors import FreneticError
from frenetic.oracle import assess
from frenetic.quantities import SEED, quantity
from frenetic.registry import STRATEGIES, hint
from frenetic.road import Road
from frenetic.search import Frenetic
from frenetic.search.records import Candidate, Evaluation
from frenetic.simulators.capabilities import capabilities
from frenetic.simulators.embedded import EmbeddedSimulator
from frenetic.simulators.embedded.vehicle import CARS
from frenetic.simulators.worlds import in_conditions
from frenetic.spec import Spec
from frenetic.twin.calibration.parameters import Model
from frenetic.twin.calibration.recordings import on_grid
from frenetic.twin.profile import Profile
from frenetic.versions import SHORT

LAWS: Final = {
    "planner": ("lookahead_time=0.02:1.5", "lookahead_min=1:15"),
    "stanley": ("offset_gain=0.2:6", "softening=0.2:6"),
}
"""Driver -> the parameters of its steering that are fitted."""
SPEED: Final = ("lateral_acceleration=1.5:40", "braking=0.8:10", "speed_gain=0.3:6")
"""Those of its speed."""
CAR: Final = (
    "vehicle.tyre_peak=0.4:1.5",
    "vehicle.steering_lag=0.02:0.6",
    "vehicle.steering_rate=0.15:2",
    "vehicle.engine_acceleration=1.5:12",
)
"""Those of the car."""

_FIRST_FIT: Final = 20  # drives before it
_GROWTH: Final = 1.5  # of the number of drives from one fit to the next
_FITTED: Final = 40  # drives that a fit looks at, half of them the last ones
_STAGES: Final = ((0.7, 20, 6, 0.08), (1.2, 20, 6, 0.04), (2.0, 40, 8, 0.02))
"""Of a fit: offset in m up to which drives are compared, number of drives, steps, first distance
of the places between which slopes are taken."""
_HOPELESS: Final = 4.0  # times the least loss, with which a law is not fitted again
_LITTLE: Final = 0.8  # of the loss before, above which slopes are taken over shorter ways
_SHORTER: Final = 0.4  # times the way, where no step is downwards
_SHORTEST: Final = 0.004
_DAMPING, _LEAST_DAMPING, _RIDGE = 0.01, 1e-4, 1e-4
_LONGEST: Final = 0.2  # step
_LEAST: Final = 4  # places of a drive that are compared, at least
_BEFORE: Final = 15  # places before the worst one that count as much as all together
_WORST: Final = 2.0  # difference in a place
_SPREADS: Final = np.array([[1.0], [2.0]])  # [m, m/s] of offset and speed that count as much


def foresight(
    spec: Spec, profile: Path | str | None = None, vehicle: str | None = None, **options: Any
) -> Frenetic:
    """Frenetic, which first looks in a twin that learns the driver what roads will bring.

    Args:
        spec: of the campaign.
        profile: file of a twin's profile, which foresees from the start; what it says to be fitted
            is fitted on. By default the laws of `LAWS` are.
        vehicle: name of their car, one of `CARS`; by default that with the simulator's name, if
            there is one.
        options: of `Frenetic`.

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
    given = {}
    if profile is None:
        if vehicle is None and spec.simulator.name in CARS:
            vehicle = spec.simulator.name
        fit = {law: [*SPEED, *own, *CAR] for law, own in LAWS.items()}
        models = [Model.of(law, names, vehicle=vehicle) for law, names in fit.items()]
    else:
        read = Profile.read(profile)
        _check_terms(read, spec, source=profile)
        models = [Model.of_profile(read)]
        digest = hashlib.sha256(msgspec.json.encode(read)).hexdigest()[:SHORT]
        given["profile"] = f"{profile} (SHA-256 {digest})"
    own: dict[str, Any] = {
        "seed": spec.seed,
        "map_size": spec.map_size,
        "road_class": spec.road_class,
        "domain": spec.domain,
        **options,
    }
    twin = OnlineTwin(models, spec, is_ready=profile is not None)
    if vehicle is not None:
        given["vehicle"] = vehicle
    return ForesightSearch(twin, given, **own)


class ForesightSearch(Frenetic):
    """`Frenetic` with the foresight of a twin.

    Args:
        twin: which foresees.
        made_with: what the twin was made with, for a campaign's record.
        options: of `Frenetic`.
    """

    BEHAVIOUR: ClassVar[int] = 100 * Frenetic.BEHAVIOUR + 1
    """Raised when its proposals change; campaigns record it."""

    def __init__(self, twin: OnlineTwin, made_with: Mapping[str, Any], **options: Any) -> None:
        super().__init__(foresight=twin, **options)
        self.options |= made_with


@dataclass(frozen=True, eq=False)
class _Driven:
    """A drive of the driver under test."""

    road: Road
    conditions: Mapping[str, int | float]
    states: FloatArray
    """Offsets in m and speeds in m/s every 2 m, (2, n)."""

    def until(self, offset: float) -> _Driven:
        """The drive up to the first place with a larger offset, in m."""
        out = np.flatnonzero(np.abs(self.states[0]) > offset)
        end = max(int(out[0]) + 1, _LEAST) if len(out) else None
        return replace(self, states=self.states[:, :end])

    @cached_property
    def weights(self) -> FloatArray:
        """Weights of the places, (n,): half of all lies on the way to the largest offset."""
        n = self.states.shape[1]
        worst = int(np.argmax(np.abs(self.states[0]))) + 1
        shares = np.full(n, 1.0 / n)
        shares[max(worst - _BEFORE, 0) : worst] += 1.0 / min(worst, _BEFORE)
        weights: FloatArray = np.sqrt(0.25 * shares)
        return weights


class OnlineTwin:
    """A twin that is fitted while it foresees, see `frenetic.search.frenetic.Foresight`.

    Of some models, each a law and a car, the one that follows the drives best foresees.

    Args:
        models: with the parameters that are fitted; without any, a model stays as it is.
        spec: of the search, whose rules, lanes, road class and objective are the twin's.
        is_ready: whether the first model foresees before anything was fitted.

    Raises:
        FreneticError: a model's driver is not compiled.
    """

    def __init__(self, models: Sequence[Model], spec: Spec, *, is_ready: bool = False) -> None:
        self._models = models
        self._spec = spec
        self._objective = Objective.load(spec.objective)
        self._places = [np.array([one.place for one in model.parameters]) for model in models]
        self._losses = [math.inf] * len(models)
        self._best = 0
        self._drives: list[tuple[Candidate, FloatArray]] = []
        self._next_fit = _FIRST_FIT
        self.is_ready = is_ready
        """Whether it can tell what the driver will do."""
        made = [self._made(number, places) for number, places in enumerate(self._places)]
        for model, (driver, simulator) in zip(models, made, strict=True):
            if not simulator.drives_compiled(driver):
                raise FreneticError(
                    f"{model.driver} is no driver for a twin that drives thousands of"
                    " roads: choose one of ours, such as planner or stanley"
                )
        self._parts = made[0]  # the best model's
        self._variable = capabilities(self._parts[1]).variable

    # Foreseeing

    def foresee(self, candidate: Candidate) -> Evaluation | None:
        """The twin's evaluation of a candidate; None if it comes to no end on its road."""
        road = self._road(candidate)
        drive = self._driven(self._parts, road, self._conditions(candidate))
        seen = evaluate(candidate, road, drive, objective=self._objective)
        return seen if seen.outcome.is_driven else None

    def facts(self) -> Mapping[str, Any]:
        """The twin, and its loss in the last fit: 0 if it drives alike."""
        loss, model = self._losses[self._best], self._models[self._best]
        values = model.values(self._places[self._best].tolist())
        words = [f"{name.partition('.')[2]} {value:.3g}" for name, value in values.items()]
        said = {"twin": ", ".join([model.driver, *words])}
        return said if math.isinf(loss) else {**said, "loss": float(f"{loss:.2g}")}

    # Learning

    def learn(self, candidate: Candidate, evaluation: Evaluation) -> None:
        """Takes a drive; fits now and then."""
        trace = evaluation.trace
        if trace is None or len(trace.distance) < 2 or not self._places[self._best].size:
            return
        states = np.array(on_grid(trace.distance, trace.lateral_offset, trace.speed))
        if states.shape[1] < _LEAST:
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
            _Driven(self._road(candidate), self._conditions(candidate), states)
            for candidate, states in (*(earlier[row] for row in rows.tolist()), *last)
        ]
        hopeless = _HOPELESS * min(self._losses)
        for number, loss in enumerate(self._losses):
            if loss <= hopeless:
                self._losses[number], self._places[number] = self._fitted(number, drives)
        self._best = int(np.argmin(self._losses))
        self._parts = self._made(self._best, self._places[self._best])
        self.is_ready = True

    def _fitted(self, number: int, drives: Sequence[_Driven]) -> tuple[float, FloatArray]:
        """Loss and places of a model, fitted to drives from where it is."""
        loss, x = math.inf, self._places[number]
        for offset, count, steps, apart in _STAGES:
            some = [one.until(offset) for one in drives[:: max(len(drives) // count, 1)]]
            loss, x = self._descended(number, x, some, steps, apart)
        return loss, x

    def _descended(
        self, number: int, x: FloatArray, drives: Sequence[_Driven], steps: int, apart: float
    ) -> tuple[float, FloatArray]:
        """Loss and places after some steps; slopes are first taken between places ``apart``."""
        found = self._residuals(number, x, drives)
        if found is None:
            return math.inf, x
        loss, damping = float(found @ found), _DAMPING
        for _ in range(steps):
            slopes = np.zeros((len(found), len(x)))
            for k in range(len(x)):
                moved = x.copy()
                moved[k] += apart if x[k] < 0.5 else -apart
                other = self._residuals(number, moved, drives)
                if other is not None:
                    slopes[:, k] = (other - found) / (moved[k] - x[k])
            normal = slopes.T @ slopes + _RIDGE * np.eye(len(x))
            for more in (1.0, 10.0, 100.0):
                damped = normal + more * damping * np.diag(np.diag(normal))
                step = np.linalg.solve(damped, -slopes.T @ found)
                tried = np.clip(x + np.clip(step, -_LONGEST, _LONGEST), 0.0, 1.0)
                other = self._residuals(number, tried, drives)
                if other is not None and (lower := float(other @ other)) < loss:
                    break
            else:
                apart *= _SHORTER
                if apart < _SHORTEST:
                    break
                continue
            if lower > _LITTLE * loss:
                apart = max(0.5 * apart, _SHORTEST)
            x, found, loss = tried, other, lower
            damping = max(0.25 * more * damping, _LEAST_DAMPING)
        return loss, x

    def _residuals(
        self, number: int, places: FloatArray, drives: Sequence[_Driven]
    ) -> FloatArray | None:
        """Differences of a model's drives from others, (m,), whose square is the loss.

        None if there is no such driver or car.
        """
        try:
            parts = self._made(number, places)
        except (FreneticError, ValueError):
            return None
        found = []
        for one in drives:
            drive = self._driven(parts, one.road, one.conditions)
            seen = assess(one.road, drive, has_shares=False)
            n = len(seen.distance)
            own = np.array(on_grid(seen.distance, seen.lateral_offset, drive.trajectory.speed[:n]))
            m = one.states.shape[1]
            k = min(m, own.shape[1])
            away = np.full((2, m), _WORST)  # where the twin did not come
            away[0] *= np.sign(own[0, k - 1])
            apart = np.nan_to_num(own[:, :k] - one.states[:, :k]) / _SPREADS
            away[:, :k] = _WORST * np.tanh(apart / _WORST)
            found.append((away * one.weights).ravel())
        residuals: FloatArray = np.concatenate(found) / math.sqrt(len(drives))
        return residuals

    # Parts

    def _made(self, number: int, places: FloatArray) -> tuple[Driver, EmbeddedSimulator]:
        model = self._models[number]
        return model.make(model.values(places.tolist()), self._spec.rules)

    def _road(self, candidate: Candidate) -> Road:
        return candidate.road(self._spec.lane_width, road_class=self._spec.road_class)

    def _conditions(self, candidate: Candidate) -> Mapping[str, int | float]:
        """A candidate's conditions, as far as they are the car's and the embedded simulator's."""
        return {
            name: value
            for name, value in candidate.conditions.items()
            if name != SEED and quantity(name).attribute in self._variable
        }

    @staticmethod
    def _driven(
        parts: tuple[Driver, EmbeddedSimulator], road: Road, conditions: Mapping[str, int | float]
    ) -> Drive:
        driver, simulator = parts
        with in_conditions(conditions, simulator, driver) as own:
            return simulator.drive(road, own)


def _check_terms(profile: Profile, spec: Spec, *, source: object) -> None:
    """Refuses a twin of other rules, another map or lane.

    Raises:
        FreneticError: it differs.
    """
    ours, theirs = (
        {
            "speed_limit": one.rules.speed_limit,
            "oob_tolerance": one.rules.oob_tolerance,
            "map_size": one.map_size,
            "lane_width": one.lane_width,
        }
        for one in (spec, profile.spec())
    )
    differing = [
        f"{name.replace('_', ' ')} {theirs[name]:g}, not {ours[name]:g}"
        for name in ours
        if theirs[name] != ours[name]
    ]
    if differing:
        raise FreneticError(
            f"{source} is the profile of a twin for other terms ({'; '.join(differing)}): give the"
            " search the same, or calibrate a twin for them"
        )
