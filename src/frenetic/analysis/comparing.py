"""Comparing groups of campaigns, such as one per strategy, each with its repeats.

`measure_campaign` says what a campaign came to, `compare` holds groups of them against each other:
medians and quartiles, the effect size A12 of Vargha and Delaney, and the Mann-Whitney test for each
pair of groups, corrected by Holm where there are several pairs.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from frenetic.analysis.clusters import Failure, cluster_failures
from frenetic.analysis.features import FEATURES, features_of
from frenetic.analysis.segments import segments_of
from frenetic.analysis.statistics import (
    LEAST_REPEATS,
    SIGNIFICANT,
    Magnitude,
    Quartiles,
    a12,
    holm,
    kruskal_wallis,
    magnitude,
    mann_whitney,
    quartiles,
)
from frenetic.campaign.store import DATABASE, CampaignStore
from frenetic.errors import CampaignError, FreneticError
from frenetic.outcome import Outcome

MAP_AXES: Final = ("direction_coverage", "max_curvature", "std_steering", "mean_offset")
"""Features that span the map of which cells are counted: those of the competition of 2023."""
PARTS: Final = (
    "strategy",
    "driver",
    "simulator",
    "rules",
    "budget",
    "map_size",
    "margin",
    "lane_width",
    "lookahead",
)
"""What repeats have in common, of a campaign's configuration; the strategy's seed differs."""


@dataclass(frozen=True, eq=False)
class CampaignMeasures:
    """What a campaign came to."""

    folder: Path
    seed: object
    """Of its strategy."""
    simulations: int
    """Drives, broken ones included."""
    invalid: int
    """Roads that were refused."""
    failures: int
    distinct_failures: int
    """See `frenetic.analysis.cluster_failures`."""
    cells: int
    """Cells of the feature map over `MAP_AXES` that hold a failure."""
    simulations_to_failure: float
    """Drives up to and with the first failure; infinite if there is none."""
    seconds_to_failure: float
    """s of the campaign's time up to the first failure; infinite if there is none."""
    failures_after: npt.NDArray[np.int64]
    """(simulations + 1,) failures found by each number of drives, from 0 on."""
    is_finished: bool
    """Whether its budget was spent."""

    @property
    def failures_per_100(self) -> float:
        """Failures per 100 drives."""
        return 100.0 * self.failures / self.simulations if self.simulations else 0.0

    @property
    def invalid_share(self) -> float:
        """Share 0..1 of the proposed roads that were refused."""
        tests = self.simulations + self.invalid
        return self.invalid / tests if tests else 0.0


@dataclass(frozen=True)
class Measure:
    """A number by which campaigns are compared."""

    name: str
    """Of the attribute of `CampaignMeasures`."""
    title: str
    unit: str
    """Empty if it has none."""
    more_is_better: bool
    """For a search."""
    decimals: int

    def of(self, campaign: CampaignMeasures) -> float:
        """This measure's value."""
        return float(getattr(campaign, self.name))

    def text(self, value: float) -> str:
        """A value for people, without its unit."""
        return "none" if math.isinf(value) else f"{value:.{self.decimals}f}"


MEASURES: Final[Mapping[str, Measure]] = MappingProxyType(
    {
        measure.name: measure
        for measure in (
            Measure("failures", "failures", "", True, 0),
            Measure("distinct_failures", "distinct failures", "", True, 0),
            Measure("cells", "cells of the feature map", "", True, 0),
            Measure("failures_per_100", "failures per 100 simulations", "", True, 1),
            Measure("simulations_to_failure", "simulations to first failure", "", False, 0),
            Measure("seconds_to_failure", "time to first failure", "s", False, 2),
            Measure("invalid_share", "invalid share", "", False, 3),
        )
    }
)
"""Name -> measure, in the order in which they are shown."""


class Verdict(StrEnum):
    """What can be said of two groups."""

    FIRST_IS_BETTER = "the first is better"
    SECOND_IS_BETTER = "the second is better"
    NOT_SHOWN = "no difference shown"
    """It may be there, but chance explains what was seen."""
    TOO_FEW = "too few repeats to tell"


@dataclass(frozen=True)
class PairComparison:
    """Two groups, compared by one measure."""

    first: str
    """Name of a group."""
    second: str
    a12: float
    """Chance 0..1 that a campaign of the first group does better than one of the second.

    Vargha and Delaney's A12; where less is better, of the negated values. Ties count half."""
    p: float
    """Of the two-sided Mann-Whitney test."""
    p_corrected: float
    """Corrected by Holm for the number of pairs."""
    repeats: tuple[int, int]
    """Campaigns in each group."""

    @property
    def magnitude(self) -> Magnitude:
        """How large the effect is."""
        return magnitude(self.a12)

    @property
    def verdict(self) -> Verdict:
        """What can be said."""
        if min(self.repeats) < LEAST_REPEATS:
            return Verdict.TOO_FEW
        if self.p_corrected >= SIGNIFICANT:
            return Verdict.NOT_SHOWN
        return Verdict.FIRST_IS_BETTER if self.a12 > 0.5 else Verdict.SECOND_IS_BETTER

    def __str__(self) -> str:
        match self.verdict:
            case Verdict.FIRST_IS_BETTER:
                return f"{self.first} is better than {self.second}"
            case Verdict.SECOND_IS_BETTER:
                return f"{self.second} is better than {self.first}"
            case verdict:
                return f"{self.first} and {self.second}: {verdict}"


@dataclass(frozen=True)
class MeasureComparison:
    """All groups, compared by one measure."""

    measure: Measure
    values: Mapping[str, tuple[float, ...]]
    """Name of a group -> value of each of its campaigns."""
    pairs: tuple[PairComparison, ...]
    p_overall: float | None
    """Of the Kruskal-Wallis test over all groups; None for two."""

    def quartiles(self, group: str) -> Quartiles:
        """How the values of a group are distributed."""
        return quartiles(self.values[group])


@dataclass(frozen=True, eq=False)
class Comparison:
    """Groups of campaigns, held against each other."""

    groups: Mapping[str, tuple[CampaignMeasures, ...]]
    """Name -> campaigns, which are repeats of each other."""
    measures: tuple[MeasureComparison, ...]
    """One per measure, in the order of `MEASURES`."""
    notes: tuple[str, ...]
    """What limits what the comparison can say, each in a sentence."""

    @property
    def telling(self) -> tuple[MeasureComparison, ...]:
        """The measures without failures per 100 simulations, if all have as many simulations."""
        spent = {c.simulations for campaigns in self.groups.values() for c in campaigns}
        left_out = "failures_per_100" if len(spent) == 1 else ""
        return tuple(one for one in self.measures if one.measure.name != left_out)

    def by(self, name: str) -> MeasureComparison:
        """The comparison by a measure.

        Raises:
            KeyError: there is none of this name.
        """
        for comparison in self.measures:
            if comparison.measure.name == name:
                return comparison
        raise KeyError(f"no measure is called {name!r}: choose from {', '.join(MEASURES)}")


def measure_campaign(folder: Path) -> CampaignMeasures:
    """What a campaign came to.

    Raises:
        CampaignError: there is none, or it is damaged.
    """
    with CampaignStore.open(folder) as store:
        counts = [0]
        first_sims = first_seconds = math.inf
        invalid = 0
        spent = 0.0
        for record in store.tests():
            # Logs of old versions know only what each test took.
            spent = spent + record.seconds if record.elapsed is None else record.elapsed
            if record.outcome is Outcome.INVALID:
                invalid += 1
            elif record.outcome is not Outcome.DROPPED:
                counts.append(counts[-1] + (record.outcome is Outcome.FAIL))
                if counts[-1] == 1 and math.isinf(first_sims):
                    first_sims, first_seconds = len(counts) - 1, spent
        failures, cells = _failures_and_cells(store)
        facts = store.facts
        return CampaignMeasures(
            folder=Path(folder),
            seed=store.config.get("seed"),
            simulations=len(counts) - 1,
            invalid=invalid,
            failures=counts[-1],
            distinct_failures=len(cluster_failures(failures)),
            cells=len(cells),
            simulations_to_failure=first_sims,
            seconds_to_failure=first_seconds,
            failures_after=np.array(counts, dtype=np.int64),
            is_finished="finished_at" in facts and not facts.get("interrupted"),
        )


def _failures_and_cells(store: CampaignStore) -> tuple[list[Failure], set[tuple[int, ...]]]:
    failures: list[Failure] = []
    cells: set[tuple[int, ...]] = set()
    for record, segment in segments_of(store, Outcome.FAIL):
        failures.append(Failure.of(segment, id=record.candidate.id, moobd=record.moobd or 0.0))
        features = features_of(segment)
        cells.add(tuple(FEATURES[name].bin_of(features) for name in MAP_AXES))
    return failures, cells


def compare(groups: Mapping[str, Sequence[Path]]) -> Comparison:
    """Compares groups of campaigns.

    Args:
        groups: name -> folders of the campaigns that are repeats of each other; two groups or more.

    Raises:
        CampaignError: a campaign is not there or damaged.
        FreneticError: fewer than two groups, an empty one, or a campaign that is there twice.
    """
    if len(groups) < 2:
        raise FreneticError(
            f"{len(groups)} group of campaigns: at least two are needed to compare; campaigns that"
            " differ in nothing but the seed are one group"
        )
    places: dict[Path, str] = {}
    for name, folders in groups.items():
        if not folders:
            raise FreneticError(f"group {name} has no campaigns: at least one is needed")
        for folder in folders:
            place = Path(folder).resolve()
            if place in places:
                raise FreneticError(f"{folder} is there twice: give each campaign once")
            places[place] = name
    measured = {
        name: tuple(measure_campaign(folder) for folder in folders)
        for name, folders in groups.items()
    }
    return compare_measured(measured, notes=_notes(groups, measured))


def compare_measured(
    groups: Mapping[str, tuple[CampaignMeasures, ...]], *, notes: Iterable[str] = ()
) -> Comparison:
    """Compares groups of campaigns that were measured already; otherwise as `compare`."""
    measures = tuple(_compare_by(measure, groups) for measure in MEASURES.values())
    return Comparison(MappingProxyType(dict(groups)), measures, tuple(notes))


def _compare_by(
    measure: Measure, groups: Mapping[str, tuple[CampaignMeasures, ...]]
) -> MeasureComparison:
    values = {
        name: tuple(measure.of(campaign) for campaign in campaigns)
        for name, campaigns in groups.items()
    }
    sign = 1.0 if measure.more_is_better else -1.0
    names = list(combinations(groups, 2))
    p_values = [mann_whitney(values[one], values[other]) for one, other in names]
    pairs = tuple(
        PairComparison(
            first=one,
            second=other,
            a12=a12(sign * np.array(values[one]), sign * np.array(values[other])),
            p=p,
            p_corrected=corrected,
            repeats=(len(values[one]), len(values[other])),
        )
        for (one, other), p, corrected in zip(names, p_values, holm(p_values), strict=True)
    )
    overall = kruskal_wallis(list(values.values())) if len(groups) > 2 else None
    return MeasureComparison(measure, MappingProxyType(values), pairs, overall)


# Which campaigns are repeats of each other


def find_campaigns(place: Path) -> list[Path]:
    """The campaigns in a place: the folder of one, or a folder that holds those of several.

    Raises:
        CampaignError: there is none.
    """
    if (place / DATABASE).is_file():
        return [place]
    if not place.is_dir():
        raise CampaignError(f"{place} is no folder: that of a campaign, or of several, is needed")
    try:
        found = sorted(child for child in place.iterdir() if (child / DATABASE).is_file())
    except OSError as error:
        raise CampaignError(f"cannot look into {place}: {error.strerror or error}") from None
    if not found:
        raise CampaignError(
            f"{place} holds no campaign: the folder of one, or a folder of several, is needed"
        )
    return found


def group_campaigns(folders: Iterable[Path]) -> dict[str, list[Path]]:
    """Campaigns put together that differ in nothing but the seed, under names that tell them apart.

    A name is made of what the groups differ in: the strategy, most often.

    Raises:
        CampaignError: a campaign is not there or damaged.
    """
    configurations: dict[str, dict[str, Any]] = {}
    members: dict[str, list[Path]] = {}
    for folder in folders:
        parts = _parts(folder)
        key = json.dumps(parts, sort_keys=True)
        configurations[key] = parts
        members.setdefault(key, []).append(folder)
    names = _names(list(configurations.values()))
    return dict(zip(names, members.values(), strict=True))


def _parts(folder: Path) -> dict[str, Any]:
    """What a campaign has in common with its repeats."""
    with CampaignStore.open(folder) as store:
        config, facts = store.config, store.facts
    parts: dict[str, Any] = {name: config.get(name) for name in PARTS}
    parts["budget"] = facts.get("budget", parts["budget"])
    strategy = parts["strategy"]
    if isinstance(strategy, dict) and isinstance(strategy.get("options"), dict):
        options = {k: v for k, v in strategy["options"].items() if k != "seed"}
        parts["strategy"] = {**strategy, "options": options}
    return parts


def _names(configurations: list[dict[str, Any]]) -> list[str]:
    """A name for each of several different configurations: what they differ in, in short."""
    names = [""] * len(configurations)
    for part in PARTS:
        values = [configuration[part] for configuration in configurations]
        if len(set(names)) < len(names) and any(value != values[0] for value in values):
            names = [
                f"{name} {_word(part, value, values)}".strip()
                for name, value in zip(names, values, strict=True)
            ]
    # Whatever cannot be told in short is numbered.
    return [
        f"{name} {names[: i + 1].count(name)}".strip() if names.count(name) > 1 else name or "all"
        for i, name in enumerate(names)
    ]


def _word(part: str, value: Any, others: Sequence[Any]) -> str:
    """What a part is, as opposed to what it is in other configurations."""
    if not isinstance(value, dict):
        return f"{part}={value}"
    if "class" not in value:
        return _settings(value, others)
    alike = [o for o in others if isinstance(o, dict) and o.get("class") == value["class"]]
    own, inner = value.get("options"), value.get("driver")
    settings = _settings(own, [o.get("options") for o in alike]) if isinstance(own, dict) else ""
    word = str(value["class"]).rpartition(":")[2] + (f"({settings})" if settings else "")
    if isinstance(inner, dict):
        word += f" over {_word(part, inner, [o.get('driver') for o in alike])}"
    return word


def _settings(value: Mapping[str, Any], others: Sequence[Any]) -> str:
    """Those of several settings that differ from others'."""
    told = []
    for name, setting in value.items():
        theirs = [other.get(name) if isinstance(other, dict) else None for other in others]
        if any(setting != one for one in theirs):
            if isinstance(setting, dict):
                told.append(_settings(setting, theirs))
            else:
                told.append(f"{name}={setting}")
    return ", ".join(told)


def _notes(
    groups: Mapping[str, Sequence[Path]], measured: Mapping[str, tuple[CampaignMeasures, ...]]
) -> list[str]:
    """What limits what a comparison can say."""
    notes = []
    parts = {name: [_parts(folder) for folder in folders] for name, folders in groups.items()}
    for name, configurations in parts.items():
        mixed = _differing(configurations)
        if mixed:
            notes.append(f"the campaigns of {name} are no repeats: they differ in {mixed}")
        seeds = [str(campaign.seed) for campaign in measured[name] if campaign.seed is not None]
        if len(set(seeds)) < len(seeds) and not mixed:
            notes.append(f"campaigns of {name} have the same seed: they are no repeats")
    differing = _differing([configurations[0] for configurations in parts.values()])
    if "," in differing:
        notes.append(f"the groups differ in more than one thing: {differing}")
    for name, campaigns in measured.items():
        unfinished = [campaign.folder.name for campaign in campaigns if not campaign.is_finished]
        if unfinished:
            notes.append(f"campaigns of {name} did not finish: {', '.join(unfinished)}")
    spent = {campaign.simulations for campaigns in measured.values() for campaign in campaigns}
    if max(spent) > 1.1 * min(spent):
        notes.append(
            f"the campaigns have from {min(spent)} to {max(spent)} simulations: compare failures"
            " per 100 simulations"
        )
    return notes


def _differing(configurations: Sequence[Mapping[str, Any]]) -> str:
    """The parts in which configurations differ, for people."""
    first = configurations[0]
    return ", ".join(
        part.replace("_", " ")
        for part in PARTS
        if any(configuration[part] != first[part] for configuration in configurations)
    )
