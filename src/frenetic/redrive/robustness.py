"""Robustness: how often failures repeat, also in worlds that differ a little.

A failing road is driven again and again, in worlds drawn from ranges of the road's friction, the
speed limit, the driver's noise and so on. The result is the share that fails, with an interval, and
the quantities that correlate with the car's worst moment. Without variation each drive is the same
and fails again, unless the driver or simulator is not repeatable. A road may fail in another way
than in the campaign, so the result also tells how many drives have the same failure.

A failure is *robust* if its road fails in at least half of such worlds and *fragile* if in less;
the whole 95 % interval must be on one side.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import Final, Unpack

from frenetic.analysis.statistics import SIGNIFICANT, holm, proportion_interval, spearman
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore, JSONValue
from frenetic.drive import Rules
from frenetic.drivers import Driver
from frenetic.outcome import Outcome
from frenetic.redrive.conditions import Variation, draw_conditions
from frenetic.redrive.drives import (
    RedriveOptions,
    RedriveProgress,
    by_test,
    campaign_tester,
    drive_again,
    latest,
    read_runs,
)
from frenetic.redrive.record import (
    Purpose,
    Redrive,
    Run,
    matches_document,
    matches_text,
    redrive_document,
    verdict_document,
)
from frenetic.simulators.capabilities import check_pair
from frenetic.simulators.simulator import Simulator
from frenetic.simulators.worlds import QUANTITIES, check_can_vary, in_conditions
from frenetic.versions import comparison_key, differences

TIMES: Final = 20
"""Default number of drives of each test."""
LEVEL: Final = 0.5
"""Failing share that separates robust failures (at least) from fragile ones (less)."""
LEAST_DRIVES: Final = 8
"""Fewest drives for a verdict on which quantities matter."""


class Stability(StrEnum):
    """Whether a failure repeats."""

    ROBUST = "robust"
    """It repeats in at least half of the worlds: the interval lies above."""
    UNCLEAR = "unclear"
    """The interval lies on both sides; more drives would decide."""
    FRAGILE = "fragile"
    """It repeats in less than half of the worlds: the interval lies below."""


@dataclass(frozen=True)
class Influence:
    """Influence of a varied quantity on the drives."""

    quantity: str
    spearman: float
    """Rank correlation -1..1 of the quantity with `Redrive.margin`: negative if more is worse."""
    p: float
    """The p that it is chance, corrected by Holm for the number of varied quantities."""

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
    """Repeats of one test's failure."""

    recorded: Test = field(compare=False)
    """The campaign's own test."""
    variations: tuple[Variation, ...]
    seed: int
    """Ranges of the worlds."""
    driver: Mapping[str, JSONValue]
    """In the form of a campaign's description."""
    simulator: Mapping[str, JSONValue]
    """In the form of a campaign's description."""
    drives: tuple[Redrive, ...]
    rules: Rules | None = None
    """Rules; None if unknown."""
    folder: Path | None = field(default=None, compare=False)
    """Folder of the campaign that drove them."""

    @property
    def test_id(self) -> int:
        """The test's id."""
        return self.recorded.id

    def count(self, outcome: Outcome) -> int:
        """Drives with this outcome."""
        return sum(drive.outcome is outcome for drive in self.drives)

    @property
    def failed(self) -> int:
        """Drives that failed."""
        return self.count(Outcome.FAIL)

    @property
    def judged(self) -> int:
        """Drives that passed or failed; the others count neither way."""
        return sum(drive.outcome.is_driven for drive in self.drives)

    @property
    def alike(self) -> int:
        """Drives with the campaign's own failure, see `Redrive.is_alike`."""
        return sum(drive.is_alike for drive in self.drives)

    @property
    def matches(self) -> str:
        """Kinds of failing drives with their numbers, see `Match`."""
        return matches_text(self.drives)

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
        """The ranges of the worlds, for people."""
        return ", ".join(map(str, self.variations)) or "nothing varied"

    @property
    def _setting(self) -> tuple[object, ...]:
        """Key that a later rerun shares with one that it replaces."""
        parts = comparison_key(self.driver, self.simulator)
        return self.test_id, parts, self.rules, frozenset(self.variations)

    @cached_property
    def influences(self) -> tuple[Influence, ...]:
        """Influences of the varied quantities, the strongest first.

        None if fewer than `LEAST_DRIVES` drives were judged, or all failed.
        """
        judged = [drive for drive in self.drives if drive.outcome.is_driven]
        margins = [drive.margin for drive in judged]
        names = [v.quantity for v in self.variations if not v.is_fixed]
        if len(judged) < LEAST_DRIVES or len(set(margins)) == 1:
            return ()
        columns = [[drive.conditions.value(name) or 0.0 for drive in judged] for name in names]
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
        if self.matches:
            text += f": {self.matches}"
        return "; ".join([text, *(str(one) for one in self.influences if one.matters)])


def rerun(
    folder: Path | str,
    simulator: Simulator,
    driver: Driver,
    *,
    test_ids: Iterable[int] | None = None,
    times: int = TIMES,
    variations: Sequence[Variation] = (),
    seed: int = 0,
    on_progress: Callable[[RedriveProgress], None] | None = None,
    **how: Unpack[RedriveOptions],
) -> tuple[Rerun, ...]:
    """Drives failing roads of a campaign again and stores how often they fail.

    Each road is driven in the same worlds as every other. The drives are stored, see
    `frenetic.redrive.drives` and `read_reruns`.

    Args:
        folder: of the campaign.
        simulator: the campaign's, not yet entered.
        driver: the campaign's.
        test_ids: driven tests; all failures by default, the most severe first.
        times: drives of each.
        variations: ranges of the varied quantities; none by default.
        seed: of the worlds.
        on_progress: called after every drive.
        how: see `frenetic.redrive.drives.RedriveOptions`.

    Returns:
        The tests that were driven, in order; after Ctrl-C the last may have fewer drives.

    Raises:
        CampaignError: the campaign or what is kept of earlier reruns is damaged, or a test was not
            driven.
        FreneticError: the simulator cannot vary one of the quantities.
        ValueError: an option is out of range.
    """
    folder, seed = Path(folder), int(seed)  # which may be numpy's
    conditions = draw_conditions(variations, times, seed)
    check_can_vary(simulator, [variation.quantity for variation in variations])
    # All have the same layers over the driver.
    with in_conditions(conditions[0], simulator, driver) as layered:
        check_pair(simulator, layered)
    with CampaignStore.open(folder) as store:
        if test_ids is None:
            records = list(store.tests(Outcome.FAIL, order_by="moobd"))
        else:
            records = [store.test(i, with_trajectory=False) for i in dict.fromkeys(test_ids)]
        tester = campaign_tester(store, simulator, driver)
    run = drive_again(
        folder,
        Purpose.ROBUSTNESS,
        tester,
        records,
        conditions,
        seed=seed,
        variations=variations,
        on_progress=on_progress,
        **how,
    )
    return tuple(_reruns_of(run))


def _reruns_of(run: Run) -> Iterator[Rerun]:
    """The reruns of a run, one per test."""
    for drives in by_test(run.drives).values():
        yield Rerun(
            drives[0].recorded,
            run.variations,
            run.seed or 0,
            run.driver,
            run.simulator,
            drives,
            run.rules,
            run.folder,
        )


def telling_reruns(
    reruns: Iterable[Rerun],
    driver: Mapping[str, JSONValue],
    simulator: Mapping[str, JSONValue],
    rules: Rules | None = None,
) -> dict[int, Rerun]:
    """The most informative rerun of each test with these parts: test id -> rerun.

    Reruns with other parts do not count. One with variations is preferred to one without, and a
    later one to an earlier one.

    Args:
        reruns: as `read_reruns` gives them.
        driver: the campaign's, as its configuration describes it.
        simulator: likewise.
        rules: the campaign's; None to accept any.
    """
    own = [
        one
        for one in reruns
        if not differences("driver", one.driver, driver)
        and not differences("simulator", one.simulator, simulator)
        and (one.rules == rules or None in (one.rules, rules))
    ]
    own.sort(key=lambda one: bool(one.variations))  # stable: the last of each counts
    return {one.test_id: one for one in own}


def read_reruns(folder: Path | str) -> tuple[Rerun, ...]:
    """The stored reruns of a campaign, in the order of the tests' ids.

    A test has one for each driver, simulator and set of ranges, the latest at the end: that with
    most judged drives, the last of equals. `telling_reruns` chooses among them.

    Raises:
        CampaignError: it cannot be read, is damaged, or was written by a newer version.
    """
    runs = read_runs(folder, Purpose.ROBUSTNESS)
    judged = [one for run in runs for one in _reruns_of(run) if one.judged]
    judged.sort(key=lambda one: one.judged)
    kept = latest(judged, lambda one: one._setting)
    return tuple(sorted(kept, key=lambda one: one.test_id))


# JSON


def rerun_document(one: Rerun) -> dict[str, JSONValue]:
    """A rerun as a JSON object, with figures derived from its drives."""
    return {
        "test": one.test_id,
        "stability": None if one.stability is None else str(one.stability),
        "failed": one.failed,
        "judged": one.judged,
        "alike": one.alike,
        "matches": matches_document(one.drives),
        "share": one.share,
        "interval": list(one.interval),
        "influences": [asdict(influence) for influence in one.influences],
        "variations": [asdict(variation) for variation in one.variations],
        "seed": one.seed,
        "driver": dict(one.driver),
        "simulator": dict(one.simulator),
        "recorded": {
            "world": {},
            **verdict_document(one.recorded),
            "trouble": None if one.recorded.outcome.is_driven else one.recorded.reason,
        },
        "drives": [
            {
                "world": dict(drive.test.candidate.conditions),
                **redrive_document(drive),
                "trouble": drive.trouble,
            }
            for drive in one.drives
        ],
    }
