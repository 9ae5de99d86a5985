"""Comparison of groups of campaigns, such as one per strategy, each with its repeats.

`measure_campaign` measures a campaign, `compare` compares groups of them: medians and quartiles,
mean ranks, the effect size A12 of Vargha and Delaney, and the Mann-Whitney test for each pair of
groups, corrected by Holm where there are several pairs.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations, count
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from frenetic._support.files import require_list
from frenetic._support.notebook import Shown
from frenetic._support.words import counted, oob_unit
from frenetic.analysis.groups import differing_parts, parts_of, shared_parts
from frenetic.analysis.metrics import (
    HEADLINE,
    MEASURES,
    CampaignMeasures,
    Measure,
    measure_campaign,
)
from frenetic.analysis.sparseness import MOST_COMPARED
from frenetic.analysis.statistics import (
    LEAST_REPEATS,
    SIGNIFICANT,
    Quartiles,
    a12,
    holm,
    magnitude,
    mann_whitney,
    quartiles,
    ranks,
)
from frenetic.errors import FreneticError


@dataclass(frozen=True)
class PairComparison:
    """Two groups, compared by one measure."""

    first: str
    """Name of a group."""
    second: str
    a12: float
    """Chance 0..1 that a campaign of the first group does better than one of the second.

    It is Vargha and Delaney's A12, of the negated values where less is better. Ties count half."""
    p: float
    """The p of the two-sided Mann-Whitney test."""
    p_corrected: float
    """The same p, corrected by Holm for the number of pairs."""
    repeats: tuple[int, int]
    """Campaigns in each group."""

    @property
    def is_told(self) -> bool:
        """Whether there are enough repeats to tell."""
        return min(self.repeats) >= LEAST_REPEATS

    @property
    def magnitude(self) -> str:
        """Size of the effect."""
        return magnitude(self.a12)

    @property
    def verdict(self) -> str:
        """Verdict on the two groups. Where no difference is shown, chance explains the values."""
        if self.better is not None:
            return f"the {'first' if self.better == self.first else 'second'} is better"
        return "no difference shown" if self.is_told else "too few repeats to tell"

    @property
    def better(self) -> str | None:
        """The better group; None if no difference is shown."""
        if not self.is_told or self.p_corrected >= SIGNIFICANT:
            return None
        return self.first if self.a12 > 0.5 else self.second


@dataclass(frozen=True)
class MeasureComparison:
    """All groups, compared by one measure."""

    measure: Measure
    values: Mapping[str, tuple[float, ...]]
    """Name of a group -> value of each of its campaigns."""
    pairs: tuple[PairComparison, ...]
    """Each two groups."""

    def quartiles(self, group: str) -> Quartiles:
        """Quartiles of a group's values."""
        return quartiles(self.values[group])

    def between(self, group: str) -> str:
        """The quartiles of a group for people; empty if they are no numbers."""
        found = self.quartiles(group)
        if found.n == 1 or (math.isinf(found.low) and math.isinf(found.high)):
            return ""
        return f"{self.measure.text(found.low)} to {self.measure.text(found.high)}"

    def median(self, group: str) -> str:
        """The median of a group for people."""
        return self.measure.text(self.quartiles(group).median)

    def text(self, group: str) -> str:
        """The median of a group, and its quartiles in brackets, for people."""
        between, median = self.between(group), self.median(group)
        return f"{median} ({between})" if between else median

    @cached_property
    def _mean_ranks(self) -> Mapping[str, float]:
        """Name of a group -> mean rank of its campaigns among all campaigns; 1 is the best."""
        every = ranks(-self.measure.sign * np.concatenate([*self.values.values()]))
        ends = np.cumsum([len(values) for values in self.values.values()])
        parts = zip(self.values, np.split(every, ends[:-1]), strict=True)
        return {name: float(part.mean()) for name, part in parts}

    @cached_property
    def places(self) -> Mapping[str, int]:
        """Name of a group -> its place from 1, by the median and among equal ones by the mean rank.

        Groups that have both alike share the better place: 1, 1, 3.
        """
        scores = {
            name: (-self.measure.sign * self.quartiles(name).median, round(rank, 9))
            for name, rank in self._mean_ranks.items()
        }
        return {
            name: 1 + sum(other < score for other in scores.values())
            for name, score in scores.items()
        }

    def said(self, pair: PairComparison) -> str:
        """The verdict on two groups in words of this measure, such as "a has more than b"."""
        if pair.better is None:
            return f"{pair.first} and {pair.second}: {pair.verdict}"
        worse = pair.second if pair.better == pair.first else pair.first
        return f"{pair.better} has {self.measure.better} than {worse}"

    @property
    def order(self) -> tuple[str, ...]:
        """The groups by place, the best first."""
        return tuple(sorted(self.values, key=lambda name: self.places[name]))

    def worse_than(self, group: str) -> tuple[str, ...]:
        """The groups that are worse than another."""
        return tuple(
            pair.second if pair.first == group else pair.first
            for pair in self.pairs
            if pair.better == group
        )


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(Shown):
    """Groups of campaigns, compared with each other."""

    groups: Mapping[str, tuple[CampaignMeasures, ...]]
    """Name -> campaigns, which are repeats of each other."""
    measures: tuple[MeasureComparison, ...]
    """One per measure that all campaigns have, in the order of `MEASURES`."""
    notes: tuple[str, ...]
    """Limits of the comparison, each in a sentence."""
    shared: Mapping[str, str] = field(default_factory=dict)
    """Part of a configuration -> its common value in all campaigns, in words."""

    def __repr__(self) -> str:
        """The comparison at a glance."""
        groups = (f"{name} ({counted(len(own), 'campaign')})" for name, own in self.groups.items())
        return f"<Comparison of {', '.join(groups)}>"

    @property
    def headline(self) -> MeasureComparison:
        """The comparison by distinct failures, which orders the groups."""
        return self.by(HEADLINE)

    def by(self, name: str) -> MeasureComparison:
        """The comparison by a measure.

        Raises:
            KeyError: there is none of this name, or not all campaigns have it.
        """
        for comparison in self.measures:
            if comparison.measure.name == name:
                return comparison
        known = ", ".join(comparison.measure.name for comparison in self.measures)
        raise KeyError(f"no measure is called {name!r}: choose from {known}")


def compare(groups: Mapping[str, Iterable[Path | str]]) -> Comparison:
    """Compares groups of campaigns.

    Args:
        groups: name -> folders of campaigns that repeat each other; two groups or more.

    Raises:
        CampaignError: a campaign is not there or damaged.
        FreneticError: fewer than two groups, an empty one, one that is a single folder
            rather than a list, or a campaign that is there twice.
    """
    if len(groups) < 2:
        raise FreneticError(
            f"{len(groups)} group of campaigns: at least two are needed to compare; campaigns that"
            " differ in nothing but the seed are one group"
        )
    listed = {name: require_list(f"group {name}", given) for name, given in groups.items()}
    places: set[Path] = set()
    for name, folders in listed.items():
        if not folders:
            raise FreneticError(f"group {name} has no campaigns: at least one is needed")
        for folder in folders:
            place = Path(folder).resolve()
            if place in places:
                raise FreneticError(f"{folder} is there twice: give each campaign once")
            places.add(place)
    measured = {
        name: tuple(measure_campaign(folder) for folder in folders)
        for name, folders in listed.items()
    }
    parts = {name: [parts_of(folder) for folder in folders] for name, folders in listed.items()}
    return compare_measured(
        measured,
        notes=[*_drivers_differ(parts), *_notes(parts, measured)],
        shared=shared_parts([one for found in parts.values() for one in found]),
    )


def compare_measured(
    groups: Mapping[str, tuple[CampaignMeasures, ...]],
    *,
    notes: Iterable[str] = (),
    shared: Mapping[str, str] = MappingProxyType({}),
) -> Comparison:
    """Compares groups of measured campaigns, as `compare` does."""
    widths = {campaign.lane_width for campaigns in groups.values() for campaign in campaigns}
    compared = (_compare_by(measure, groups) for measure in _measures_on(widths))
    return Comparison(
        groups=groups,
        measures=tuple(one for one in compared if one is not None),
        notes=(*notes, *_weakness(groups)),
        shared=shared,
    )


def _measures_on(lane_widths: Collection[float]) -> Iterator[Measure]:
    """The measures; the unit of the MOOBD says the largest possible one if all lanes are alike."""
    for measure in MEASURES.values():
        is_known = measure.name == "min_moobd" and len(lane_widths) == 1
        yield replace(measure, unit=oob_unit(*lane_widths)) if is_known else measure


def _compare_by(
    measure: Measure, groups: Mapping[str, tuple[CampaignMeasures, ...]]
) -> MeasureComparison | None:
    """Comparison by a measure; None if a campaign lacks it."""
    values: dict[str, tuple[float, ...]] = {}
    for name, campaigns in groups.items():
        found = [measure.of(campaign) for campaign in campaigns]
        values[name] = tuple(value for value in found if value is not None)
        if len(values[name]) < len(found):
            return None
    names = list(combinations(groups, 2))
    p_values = [mann_whitney(values[one], values[other]) for one, other in names]
    pairs = tuple(
        PairComparison(
            first=one,
            second=other,
            a12=a12(measure.sign * np.array(values[one]), measure.sign * np.array(values[other])),
            p=p,
            p_corrected=corrected,
            repeats=(len(values[one]), len(values[other])),
        )
        for (one, other), p, corrected in zip(names, p_values, holm(p_values), strict=True)
    )
    return MeasureComparison(measure, values, pairs)


def least_p(sizes: Sequence[int]) -> float:
    """The least p of two groups that the test can give, corrected by Holm for all pairs of groups.

    It is that of two without ties, all of one better than all of the other: 2 of all ways to deal
    the campaigns to them are as extreme.

    Args:
        sizes: number of campaigns in each of two or more groups.
    """
    pairs = list(combinations(sizes, 2))
    return min(1.0, len(pairs) * min(2.0 / math.comb(n + m, n) for n, m in pairs))


def repeats_needed(groups: int) -> int:
    """Least number of campaigns in each of two or more groups for a difference to be shown."""
    return next(n for n in count(LEAST_REPEATS) if least_p([n] * groups) < SIGNIFICANT)


def _weakness(groups: Mapping[str, Sequence[object]]) -> Iterator[str]:
    """A note if no difference can be shown, however large."""
    sizes = [len(campaigns) for campaigns in groups.values()]
    if len(sizes) < 2 or min(sizes) < LEAST_REPEATS:
        return
    if (least := least_p(sizes)) >= SIGNIFICANT:
        yield (
            f"with so few campaigns and {len(groups)} groups no two can be shown to differ: p after"
            f" correction is {least:.2g} at least; make {repeats_needed(len(groups))} repeats each,"
            " or compare fewer groups"
        )


def _drivers_differ(parts: Mapping[str, Sequence[Mapping[str, Any]]]) -> Iterator[str]:
    """A note if groups have different drivers, about which a comparison of searches says little."""
    own, *others = (configs[0]["driver"] for configs in parts.values())
    if any(driver != own for driver in others):
        yield (
            "the groups have different drivers, and this compares what their searches found, not"
            " which driver is better: for that, compare one campaign with the other driver"
        )


def _notes(
    parts: Mapping[str, Sequence[Mapping[str, Any]]],
    measured: Mapping[str, tuple[CampaignMeasures, ...]],
) -> list[str]:
    """Limits of a comparison."""
    notes = []
    for name, configurations in parts.items():
        mixed = differing_parts(configurations)
        if mixed:
            notes.append(f"the campaigns of {name} are no repeats: they differ in {mixed}")
        seeds = [str(campaign.seed) for campaign in measured[name] if campaign.seed is not None]
        if len(set(seeds)) < len(seeds) and not mixed:
            notes.append(f"campaigns of {name} have the same seed: they are no repeats")
    differing = differing_parts([configurations[0] for configurations in parts.values()])
    if "," in differing:
        notes.append(f"the groups differ in more than one thing: {differing}")
    for name, campaigns in measured.items():
        unfinished = [campaign.folder.name for campaign in campaigns if not campaign.is_finished]
        if unfinished:
            notes.append(f"campaigns of {name} did not finish: {', '.join(unfinished)}")
    spent = {campaign.simulations for campaigns in measured.values() for campaign in campaigns}
    if max(spent) > 1.1 * min(spent):
        notes.append(
            f"the campaigns have from {min(spent)} to {max(spent)} simulations, and more find more:"
            " compare campaigns of equal length, or look at the curves"
        )
    most = max(campaign.failures for campaigns in measured.values() for campaign in campaigns)
    if most > MOST_COMPARED:
        notes.append(
            f"the competition's sparseness of more than {MOST_COMPARED} failures is that of so"
            " many, evenly spaced"
        )
    return notes


# In words


def findings(comparison: Comparison) -> str:
    """Findings of a comparison by its headline measure, in a sentence or two."""
    by = comparison.headline
    order = by.order
    few = order if len(order) <= 4 else (*order[:3], order[-1])
    values = [f"{name} {by.text(name)}" for name in few]
    left = len(order) - len(few)
    rest = f", {counted(left, 'group')} between" if left else ""
    told = f"Median (quartiles) of {by.measure.title}: {'; '.join(values)}{rest}."
    return f"{verdict(comparison)} {told}"


def verdict(comparison: Comparison) -> str:
    """Verdict on the first group by the headline measure, in a sentence."""
    by = comparison.headline
    if len(by.values) == 1:
        return "There is nobody to compare with."
    if min(len(values) for values in by.values.values()) < LEAST_REPEATS:
        return f"Too few repeats to tell: at least {LEAST_REPEATS} campaigns a group are needed."
    if not any(pair.better for pair in by.pairs):
        return f"No difference in {by.measure.title} is shown."
    best, second = by.order[:2]
    worse = by.worse_than(best)
    if by.places[second] == 1 or not worse:
        return f"No group is shown to find the most {by.measure.title}."
    if level := [name for name in by.values if name != best and name not in worse]:
        return (
            f"{best} comes first in {by.measure.title}, shown to find more than {in_short(worse)},"
            f" not than {in_short(level)}."
        )
    evidence = ", which is shown for each of them"
    if len(by.pairs) == 1:
        (pair,) = by.pairs
        odds = max(pair.a12, 1.0 - pair.a12)
        evidence = f" (A12 {odds:.2f}, {pair.magnitude}; p {p_text(pair.p)})"
    return f"{best} finds more {by.measure.title} than {in_short(worse)}{evidence}."


def pair_rows(measures: Iterable[MeasureComparison]) -> Iterator[tuple[str, str, str, str, str]]:
    """Pairs of groups: the measure once, what can be said, A12, effect, p after correction.

    A12 is that of the group that is named first in what is said.
    """
    for by in measures:
        for i, pair in enumerate(by.pairs):
            effect, p = (pair.magnitude, p_text(pair.p_corrected)) if pair.is_told else ("–", "–")
            a12 = 1.0 - pair.a12 if pair.better == pair.second else pair.a12
            yield "" if i else by.measure.title, by.said(pair), f"{a12:.2f}", effect, p


def in_short(names: Sequence[str], most: int = 3) -> str:
    """Names in a row; of many, the first and the number of others."""
    if len(names) > most:
        names = [*names[: most - 1], f"{len(names) - most + 1} others"]
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def p_text(value: float) -> str:
    """A p value with its meaningful digits."""
    if value < 0.001:
        return "< 0.001"
    return f"{value:.2g}" if value < 0.1 else f"{value:.2f}"
