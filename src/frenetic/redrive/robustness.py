"""Robustness: how often failures repeat, also in worlds that differ a little.

A failing road is driven again and again, in worlds drawn from ranges of the road's friction, the
speed limit, the driver's noise and so on. The result is the share that fails, with an interval, and
the quantities that correlate with the car's worst moment. Without variation each drive is the same
and fails again, unless the driver or simulator is not repeatable.

A failure is *robust* if its road fails in at least half of such worlds and *fragile* if in less;
the whole 95 % interval must be on one side. The result also tells whether the car leaves its lane
at the same place each time.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np

from frenetic.analysis.segments import REACH
from frenetic.analysis.statistics import SIGNIFICANT, holm, proportion_interval, spearman
from frenetic.campaign.record import Attempt, TestRecord, as_text
from frenetic.campaign.store import CampaignStore, JSONValue
from frenetic.drivers import Driver
from frenetic.errors import FreneticError
from frenetic.oracle import Side
from frenetic.outcome import Outcome
from frenetic.redrive.kept import KeptFile, as_number, as_whole
from frenetic.redrive.loop import Task, campaign_tester, drive_again
from frenetic.simulators.capabilities import check_pair
from frenetic.simulators.simulator import Simulator
from frenetic.simulators.worlds import (
    QUANTITIES,
    USUAL,
    Conditions,
    check_can_vary,
    in_conditions,
)
from frenetic.spec import describe

RERUNS: Final = "reruns.json"
"""Name of the file in a campaign's folder that holds how often its failures repeat."""
VERSION: Final = 1
"""Of that file's form."""
TIMES: Final = 20
"""Default number of drives of each test."""
LEVEL: Final = 0.5
"""Failing share that separates robust failures (at least) from fragile ones (less)."""
LEAST_DRIVES: Final = 8
"""Fewest drives for a verdict on which quantities matter."""
_WRITE_INTERVAL: Final = 5.0  # s between two times that what is done is written

_FILE: Final = KeptFile(RERUNS, "reruns", VERSION, "frenetic rerun")


class Stability(StrEnum):
    """Whether a failure repeats."""

    ROBUST = "robust"
    """In at least half of the worlds: the interval lies above."""
    UNCLEAR = "unclear"
    """The interval lies on both sides; more drives would decide."""
    FRAGILE = "fragile"
    """In less than half of the worlds: the interval lies below."""


@dataclass(frozen=True)
class Variation:
    """A quantity of the world and the range from which it is drawn evenly.

    Raises:
        FreneticError: no such quantity, or a range that is none or beyond what is allowed.
    """

    quantity: str
    """Of `frenetic.simulators.worlds.QUANTITIES`."""
    low: float
    high: float
    """Equal to `low` if the quantity is only set, not varied."""

    def __post_init__(self) -> None:
        if self.quantity not in QUANTITIES:
            raise FreneticError(
                f"cannot vary {self.quantity!r}: choose from {', '.join(QUANTITIES)}"
            )
        allowed = QUANTITIES[self.quantity]
        if not allowed.low <= self.low <= self.high <= allowed.high:
            unit = f" {allowed.unit}" if allowed.unit else ""
            raise FreneticError(
                f"cannot vary {self.quantity} from {self.low:g} to {self.high:g}: a range LOW:HIGH"
                f" within {allowed.low:.3g} to {allowed.high:.3g}{unit} is needed"
            )

    @classmethod
    def usual(cls, quantity: str, simulator: Simulator) -> Variation:
        """The default range of a quantity.

        Friction is up to a fifth less than the simulator's, the speed limit a tenth less or more;
        noise is up to 0.2 m, delay up to 0.1 s, the start within 0.3 m and 0.03 rad.

        Raises:
            FreneticError: no such quantity, or the simulator has none.
        """
        if quantity in QUANTITIES:
            check_can_vary(simulator, [quantity])
        match quantity:
            case "friction":
                friction: float = simulator.friction  # type: ignore[attr-defined]
                return cls(quantity, 0.8 * friction, friction)
            case "speed":
                limit = simulator.rules.speed_limit
                return cls(quantity, 0.9 * limit, 1.1 * limit)
        return cls(quantity, *_USUAL.get(quantity, (0.0, 0.0)))

    @property
    def is_fixed(self) -> bool:
        """Whether the quantity is only set, not varied."""
        return self.low == self.high

    def __str__(self) -> str:
        unit = QUANTITIES[self.quantity].unit
        text = f"{self.low:.3g}" if self.is_fixed else f"{self.low:.3g} to {self.high:.3g}"
        return f"{self.quantity} {text}{' ' if unit else ''}{unit}"


_USUAL: Final[Mapping[str, tuple[float, float]]] = {
    "noise": (0.0, 0.2),
    "delay": (0.0, 0.1),
    "start": (-0.3, 0.3),
    "heading": (-0.03, 0.03),
}


def draw_conditions(
    variations: Sequence[Variation], times: int, seed: int
) -> tuple[Conditions, ...]:
    """Worlds with quantities drawn from their ranges.

    They are a Latin hypercube: the range of each quantity is cut into ``times`` equal parts and
    gives one value from each. So the worlds cover the ranges evenly, and the interval of a share
    is, if anything, too wide. With noise, each world has its own errors.

    Raises:
        ValueError: ``times`` is no positive whole number, or a quantity is there twice.
    """
    if isinstance(times, bool) or times != int(times) or times < 1:
        raise ValueError(f"times is {times}: a whole number of at least 1 is needed")
    names = [variation.quantity for variation in variations]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"{name} is varied twice: give one range for it")
    rng = np.random.default_rng(seed)
    worlds = [USUAL] * times
    # In a fixed order, independent of the given one.
    for variation in sorted(variations, key=lambda v: list(QUANTITIES).index(v.quantity)):
        shares = (rng.permutation(times) + rng.random(times)) / times
        values = variation.low + (variation.high - variation.low) * shares
        for i, value in enumerate(values.tolist()):
            changes: dict[str, Any] = {variation.quantity: value}
            if variation.quantity == "noise":
                changes["noise_seed"] = int(rng.integers(2**31))
            worlds[i] = replace(worlds[i], **changes)
    return tuple(worlds)


@dataclass(frozen=True)
class Repeat:
    """One drive of a road, the recorded one or one of those that repeat it."""

    world: Conditions
    outcome: Outcome
    moobd: float | None
    """Minimum oob distance, in m; None unless PASS or FAIL."""
    departure_distance: float | None = None
    """Distance along the road where the car left its lane in m, None if it did not."""
    departure_side: Side | None = None
    trouble: str | None = None
    """Why it could not be judged, None if it was."""

    @classmethod
    def of(cls, world: Conditions, attempt: Attempt) -> Repeat:
        """What became of a drive."""
        result = attempt.result
        departure = result.departure
        return cls(
            world,
            result.outcome,
            result.moobd,
            None if departure is None else departure.distance,
            None if departure is None else departure.side,
            None if result.outcome.is_driven else as_text(result.reason),
        )

    @classmethod
    def recorded(cls, record: TestRecord) -> Repeat:
        """The drive that a campaign has stored."""
        return cls(
            USUAL,
            record.outcome,
            record.moobd,
            record.departure_distance,
            record.departure_side,
            None if record.outcome.is_driven else record.reason,
        )

    @property
    def margin(self) -> float:
        """Distance to failing, in m: the MOOBD of a drive that passed; all failed ones are equal.

        How far out a car is when its drive is ended says more of its speed than of the road.
        """
        return -math.inf if self.outcome is Outcome.FAIL or self.moobd is None else self.moobd

    def fails_like(self, other: Repeat) -> bool:
        """Whether both fail, on the same side and within 30 m along the road."""
        if not self.outcome is other.outcome is Outcome.FAIL:
            return False
        if self.departure_distance is None or other.departure_distance is None:
            return self.departure_distance is other.departure_distance
        near = abs(self.departure_distance - other.departure_distance) <= REACH
        return near and self.departure_side == other.departure_side


@dataclass(frozen=True)
class Influence:
    """How a varied quantity goes with how the car did."""

    quantity: str
    spearman: float
    """Rank correlation -1..1 of the quantity with `Repeat.margin`: negative if more is worse."""
    p: float
    """That it is chance, corrected by Holm for the number of varied quantities."""

    @property
    def matters(self) -> bool:
        """Whether it is more than chance."""
        return self.p < SIGNIFICANT

    def __str__(self) -> str:
        quantity = QUANTITIES[self.quantity]
        worse = quantity.less if self.spearman > 0.0 else quantity.more
        return f"{worse} is worse (Spearman {self.spearman:.2f})"


@dataclass(frozen=True)
class Rerun:
    """How often the failure of one test repeats."""

    test_id: int
    recorded: Repeat
    """The campaign's own drive."""
    variations: tuple[Variation, ...]
    seed: int
    """From which the worlds were drawn."""
    driver: Mapping[str, JSONValue]
    """As a campaign describes it."""
    simulator: Mapping[str, JSONValue]
    """As a campaign describes it."""
    drives: tuple[Repeat, ...]

    def count(self, outcome: Outcome) -> int:
        """Drives with this outcome."""
        return sum(drive.outcome is outcome for drive in self.drives)

    @property
    def failed(self) -> int:
        """Drives that failed."""
        return self.count(Outcome.FAIL)

    @property
    def judged(self) -> int:
        """Drives that passed or failed; of the others nothing is known."""
        return sum(drive.outcome.is_driven for drive in self.drives)

    @property
    def alike(self) -> int:
        """Drives that failed like the campaign's, see `Repeat.fails_like`."""
        return sum(drive.fails_like(self.recorded) for drive in self.drives)

    @property
    def share(self) -> float | None:
        """Share 0..1 of the judged drives that failed, None if there are none."""
        return self.failed / self.judged if self.judged else None

    @cached_property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % interval of the share; 0..1 if no drive was judged."""
        return proportion_interval(self.failed, self.judged) if self.judged else (0.0, 1.0)

    @property
    def stability(self) -> Stability | None:
        """Whether the failure repeats; None if the campaign's own drive did not fail."""
        if self.recorded.outcome is not Outcome.FAIL:
            return None
        low, high = self.interval
        if low >= LEVEL:
            return Stability.ROBUST
        return Stability.FRAGILE if high < LEVEL else Stability.UNCLEAR

    @property
    def what_varied(self) -> str:
        """The ranges from which the worlds were drawn, for people."""
        return ", ".join(map(str, self.variations)) or "nothing varied"

    @property
    def _setting(self) -> tuple[int, str, frozenset[Variation]]:
        """What a later rerun has in common with one that it replaces."""
        parts = json.dumps([self.driver, self.simulator], sort_keys=True)
        return self.test_id, parts, frozenset(self.variations)

    @cached_property
    def influences(self) -> tuple[Influence, ...]:
        """How the varied quantities go with how the car did, the closest first.

        None if there are fewer than `LEAST_DRIVES` drives that were judged, or all failed.
        """
        judged = [drive for drive in self.drives if drive.outcome.is_driven]
        margins = [drive.margin for drive in judged]
        names = [v.quantity for v in self.variations if not v.is_fixed]
        if len(judged) < LEAST_DRIVES or len(set(margins)) == 1:
            return ()
        columns = [[drive.world.value(name) or 0.0 for drive in judged] for name in names]
        found = [spearman(column, margins) for column in columns]
        p_values = holm([p for _, p in found])
        influences = [
            Influence(name, rho, p)
            for name, (rho, _), p in zip(names, found, p_values, strict=True)
        ]
        return tuple(sorted(influences, key=lambda influence: -abs(influence.spearman)))

    def __str__(self) -> str:
        if self.share is None:
            return f"none of {len(self.drives)} drives could be judged"
        low, high = self.interval
        text = (
            f"fails {self.failed} of {self.judged} ({100.0 * self.share:.0f} %, 95 % interval"
            f" {100.0 * low:.0f} to {100.0 * high:.0f} %)"
        )
        if self.alike < self.failed:
            text += f", {self.alike} of them at the same place"
        return "; ".join([text, *(str(one) for one in self.influences if one.matters)])


@dataclass(frozen=True)
class RerunProgress:
    """How far the reruns of a campaign's failures have come."""

    test_id: int
    """Of the last drive."""
    drives: int
    total: int
    failed: int


def rerun(
    folder: Path | str,
    simulator: Simulator,
    driver: Driver,
    *,
    test_ids: Iterable[int] | None = None,
    times: int = TIMES,
    variations: Sequence[Variation] = (),
    seed: int = 0,
    workers: int = 1,
    drive_limit: float | None = None,
    on_progress: Callable[[RerunProgress], None] | None = None,
    on_start: Callable[[], None] | None = None,
    on_interrupt: Callable[[], None] | None = None,
) -> tuple[Rerun, ...]:
    """Drives failing roads of a campaign again and stores how often they fail.

    Each road is driven where it lies, in the same worlds as every other. What is done is kept in
    the campaign's folder, see `read_reruns`, also if Ctrl-C ends it. It replaces what was there of
    the same test with the same parts and ranges. A test none of whose drives could be judged is not
    kept.

    Args:
        folder: of the campaign.
        simulator: the campaign's, not yet entered.
        driver: the campaign's.
        test_ids: tests that were driven; all failures by default, the most severe first.
        times: drives of each.
        variations: what differs between the drives; nothing by default.
        seed: from which the worlds are drawn.
        workers: number of roads driven at once, as for `Campaign`.
        drive_limit: s of wall time, likewise.
        on_progress: called after every drive.
        on_start: called when the simulator has started.
        on_interrupt: called at the first Ctrl-C.

    Returns:
        The tests that were driven, in order; after Ctrl-C the last may have fewer drives.

    Raises:
        CampaignError: the campaign or what is kept of earlier reruns is damaged, or a test was not
            driven.
        FreneticError: the simulator cannot vary what should be varied.
        ValueError: an option is out of range.
    """
    folder = Path(folder)
    worlds = draw_conditions(variations, times, seed)
    check_can_vary(simulator, [variation.quantity for variation in variations])
    with in_conditions(
        worlds[0], simulator, driver
    ) as layered:  # alike in what is laid over the driver
        check_pair(simulator, layered)
    with CampaignStore.open(folder) as store:
        if test_ids is None:
            records = list(store.tests(Outcome.FAIL, order_by="moobd"))
        else:
            records = [store.test(i, with_trajectory=False) for i in dict.fromkeys(test_ids)]
        tester = campaign_tester(store, simulator, driver)
    tasks = [
        Task.of(number * times + i + 1, record, world)
        for number, record in enumerate(records)
        for i, world in enumerate(worlds)
    ]
    kept = _Kept(folder)
    done: list[dict[int, Repeat]] = [{} for _ in records]
    parts = describe(driver), describe(simulator)

    def collect(number: int) -> Rerun:
        drives = tuple(done[number][i] for i in sorted(done[number]))
        record = records[number]
        recorded = Repeat.recorded(record)
        return Rerun(record.candidate.id, recorded, tuple(variations), seed, *parts, drives)

    drives = failed = 0

    def note(attempt: Attempt) -> None:
        nonlocal drives, failed
        number, i = divmod(attempt.candidate_id - 1, times)
        done[number][i] = Repeat.of(worlds[i], attempt)
        drives += 1
        failed += attempt.result.outcome is Outcome.FAIL
        if len(done[number]) == times:
            kept.add(collect(number))
        if on_progress is not None:
            test_id = records[number].candidate.id
            on_progress(RerunProgress(test_id, drives, len(tasks), failed))

    try:
        drive_again(
            tasks,
            tester,
            workers=workers,
            drive_limit=drive_limit,
            on_attempt=note,
            on_start=on_start,
            on_interrupt=on_interrupt,
        )
    finally:
        begun = [collect(number) for number, drives in enumerate(done) if drives]
        kept.add(*(one for one in begun if len(one.drives) < times))
        kept.write()
    return tuple(begun)


class _Kept:
    """The reruns in a campaign's folder, and those that are being added to them."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._fresh: list[Rerun] = []
        self._written = time.monotonic()
        read_reruns(folder)  # complains before anything is driven

    def add(self, *reruns: Rerun) -> None:
        self._fresh += [one for one in reruns if one.judged]
        if time.monotonic() - self._written >= _WRITE_INTERVAL:
            self.write()

    def write(self) -> None:
        if self._fresh:
            write_reruns(self._folder, (*read_reruns(self._folder), *self._fresh))
            self._fresh.clear()
        self._written = time.monotonic()


def telling_reruns(
    reruns: Iterable[Rerun], driver: Mapping[str, JSONValue], simulator: Mapping[str, JSONValue]
) -> dict[int, Rerun]:
    """Of each test the rerun that says most about a failure of these parts: test id -> rerun.

    Reruns with other parts say nothing about it; among the others one in which something varied
    says more than one in which nothing did, and a later more than an earlier one.

    Args:
        reruns: as `read_reruns` gives them.
        driver: the campaign's, as its configuration describes it.
        simulator: likewise.
    """
    own = [one for one in reruns if (one.driver, one.simulator) == (driver, simulator)]
    own.sort(key=lambda one: bool(one.variations))  # stable: the last of each counts
    return {one.test_id: one for one in own}


# What is kept in a campaign's folder


def write_reruns(folder: Path, reruns: Iterable[Rerun]) -> Path:
    """Writes all that is kept of a campaign's reruns in place of what was there; returns the file.

    Of a test that was driven by the same parts in worlds from the same ranges, the last is kept.

    Raises:
        CampaignError: it cannot be written.
    """
    last: dict[tuple[int, str, frozenset[Variation]], Rerun] = {}
    for one in reruns:
        last.pop(one._setting, None)  # so that it stands where it was last written
        last[one._setting] = one
    ordered = sorted(last.values(), key=lambda one: one.test_id)
    return _FILE.write(folder, [rerun_document(one) for one in ordered])


def rerun_document(one: Rerun) -> dict[str, JSONValue]:
    """A rerun as a JSON object, with what follows from its drives for other readers."""
    return {
        "test": one.test_id,
        "stability": None if one.stability is None else str(one.stability),
        "failed": one.failed,
        "judged": one.judged,
        "alike": one.alike,
        "share": one.share,
        "interval": list(one.interval),
        "influences": [asdict(influence) for influence in one.influences],
        "variations": [asdict(variation) for variation in one.variations],
        "seed": one.seed,
        "driver": dict(one.driver),
        "simulator": dict(one.simulator),
        "recorded": _repeat_document(one.recorded),
        "drives": [_repeat_document(drive) for drive in one.drives],
    }


def _repeat_document(drive: Repeat) -> dict[str, JSONValue]:
    world = {k: v for k, v in asdict(drive.world).items() if v is not None}
    if drive.world.noise is None:
        del world["noise_seed"]
    return {
        "world": world,
        **drive_document(drive),
        "trouble": drive.trouble,
    }


def read_reruns(folder: Path | str) -> tuple[Rerun, ...]:
    """What is kept in a campaign's folder, in the order of the tests' ids.

    A test is there once for each driver, simulator and set of ranges with which it was driven, the
    last written at the end; `telling_reruns` chooses among them.

    Raises:
        CampaignError: it cannot be read, is damaged, or was written by a newer version.
    """
    reruns = _FILE.read(Path(folder), _read_rerun)
    return tuple(sorted(reruns, key=lambda one: one.test_id))


def _read_rerun(item: Any) -> Rerun:
    return Rerun(
        test_id=as_whole(item["test"]),
        recorded=_read_repeat(item["recorded"]),
        variations=tuple(_read_variation(one) for one in item["variations"]),
        seed=as_whole(item["seed"]),
        driver=dict(item["driver"]),
        simulator=dict(item["simulator"]),
        drives=tuple(_read_repeat(drive) for drive in item["drives"]),
    )


def _read_variation(item: Any) -> Variation:
    try:
        return Variation(str(item["quantity"]), as_number(item["low"]), as_number(item["high"]))
    except FreneticError as error:
        raise ValueError(str(error)) from None


def _read_repeat(item: Any) -> Repeat:
    trouble = item["trouble"]
    if not isinstance(trouble, str | None):
        raise TypeError(f"a trouble is {trouble!r}")
    names = {one.name for one in fields(Conditions)}
    if unknown := item["world"].keys() - names:
        raise ValueError(f"a world has {', '.join(sorted(unknown))}")
    world: dict[str, Any] = {
        name: as_whole(value) if name == "noise_seed" else as_number(value)
        for name, value in item["world"].items()
    }
    return replace(read_drive(item), world=Conditions(**world), trouble=trouble)


def drive_document(drive: Repeat) -> dict[str, JSONValue]:
    """What became of a drive, whatever its world, as a JSON object."""
    return {
        "outcome": str(drive.outcome),
        "moobd": drive.moobd,
        "departure_distance": drive.departure_distance,
        "departure_side": drive.departure_side,
    }


def read_drive(item: Any) -> Repeat:
    """A drive in the usual world from a `drive_document`.

    Raises:
        LookupError: something is missing.
        TypeError, ValueError: something is not what it has to be.
    """
    moobd, distance, side = (
        item[name] for name in ("moobd", "departure_distance", "departure_side")
    )
    if side not in (None, "left", "right"):
        raise ValueError(f"a departure_side is {side!r}")
    return Repeat(
        USUAL,
        Outcome(item["outcome"]),
        None if moobd is None else as_number(moobd),
        None if distance is None else as_number(distance),
        side,
    )
