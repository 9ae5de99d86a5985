"""Comparison of groups of campaigns, such as one group per strategy with its repeats.

`measure_campaign` measures a campaign, `compare` compares groups of campaigns: medians and
quartiles, mean ranks, the effect size A12 of Vargha and Delaney, and the Mann-Whitney test for each
pair of groups, corrected by Holm for all pairs and all measures that differ between campaigns.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations, count
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from frenetic._support.files import require_list
from frenetic._support.notebook import NotebookRepr
from frenetic._support.words import counted, oob_unit
from frenetic.analysis.campaign_measures import CampaignMeasures, measure_campaign
from frenetic.analysis.groups import differing_parts, parts_of, shared_parts
from frenetic.analysis.measures import HEADLINE, MEASURES, Measure
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
from frenetic.analysis.unlike import MOST_LINKED
from frenetic.errors import FreneticError

_RANK_DIGITS: Final = 9  # decimal places of mean ranks: a rounding error must not order groups
_MOST_UNEQUAL: Final = 1.1
"""Largest ratio of the simulations of two campaigns that compare fairly (our choice)."""


@dataclass(frozen=True)
class PairComparison:
    """Comparison of two groups by one measure."""

    first: str
    """Name of the first group."""
    second: str
    """Name of the second group."""
    a12: float
    """Vargha and Delaney's A12: the chance 0..1 that a campaign of the first group does better than
    a campaign of the second. Ties count half."""
    p: float
    """p of the two-sided Mann-Whitney test."""
    p_corrected: float
    """p, corrected by Holm for the numbers of pairs and measures."""
    repeats: tuple[int, int]
    """Numbers of campaigns in the first and the second group."""
    least_p: float
    """Least p, corrected, that groups of these sizes can have."""

    @property
    def has_enough_repeats(self) -> bool:
        """Whether each group has enough repeats for a verdict."""
        return min(self.repeats) >= LEAST_REPEATS and self.least_p < SIGNIFICANT

    @property
    def magnitude(self) -> str:
        """Size of the effect in words, such as large."""
        return magnitude(self.a12)

    @property
    def verdict(self) -> str:
        """Verdict on the two groups. If no difference is shown, chance may explain the values."""
        if self.better is not None:
            return f"the {'first' if self.better == self.first else 'second'} is better"
        return "no difference shown" if self.has_enough_repeats else "too few repeats to tell"

    @property
    def better(self) -> str | None:
        """Better group; None if no difference is shown."""
        if not self.has_enough_repeats or self.p_corrected >= SIGNIFICANT:
            return None
        return self.first if self.a12 > 0.5 else self.second

    @property
    def worse(self) -> str | None:
        """Worse group; None if no difference is shown."""
        if self.better is None:
            return None
        return self.second if self.better == self.first else self.first


@dataclass(frozen=True)
class MeasureComparison:
    """Comparison of all groups by one measure."""

    measure: Measure
    """Measure by which the groups are compared."""
    values: Mapping[str, tuple[float, ...]]
    """Name of a group -> value of each of its campaigns."""
    pairs: tuple[PairComparison, ...]
    """Comparisons of all pairs of groups."""

    @property
    def is_tested(self) -> bool:
        """Whether the campaigns differ, so that pairs of groups are tested."""
        return len({value for values in self.values.values() for value in values}) > 1

    def quartiles(self, group: str) -> Quartiles:
        """Return the quartiles of a group's values."""
        return quartiles(self.values[group])

    def quartile_range(self, group: str) -> str:
        """Return the first and third quartile of a group as text, such as ``4 to 7``.

        The text is empty for a single campaign, and if both quartiles are infinite.
        """
        values = self.quartiles(group)
        if values.n == 1 or (math.isinf(values.low) and math.isinf(values.high)):
            return ""
        return f"{self.measure.text(values.low)} to {self.measure.text(values.high)}"

    def median(self, group: str) -> str:
        """Return the median of a group as text."""
        return self.measure.text(self.quartiles(group).median)

    def text(self, group: str) -> str:
        """Return the median of a group, with its quartiles in brackets."""
        quartile_range, median = self.quartile_range(group), self.median(group)
        return f"{median} ({quartile_range})" if quartile_range else median

    @cached_property
    def _mean_ranks(self) -> Mapping[str, float]:
        """Name of a group -> mean rank of its campaigns among all campaigns; 1 is the best."""
        all_ranks = ranks(-self.measure.sign * np.concatenate([*self.values.values()]))
        ends = np.cumsum([len(values) for values in self.values.values()])
        ranks_by_group = np.split(all_ranks, ends[:-1])
        return {
            name: float(group_ranks.mean())
            for name, group_ranks in zip(self.values, ranks_by_group, strict=True)
        }

    @cached_property
    def positions(self) -> Mapping[str, int]:
        """Name of a group -> position from 1, the best, by the median, then by the mean rank.

        Groups with equal medians and mean ranks share the better position: 1, 1, 3.
        """
        scores = {
            name: (-self.measure.sign * self.quartiles(name).median, round(rank, _RANK_DIGITS))
            for name, rank in self._mean_ranks.items()
        }
        # A lower score is better.
        return {
            name: 1 + sum(other < score for other in scores.values())
            for name, score in scores.items()
        }

    def pair_text(self, pair: PairComparison) -> str:
        """Return the verdict on two groups in words of the measure, such as "a has more than b"."""
        if pair.better is None:
            return f"{pair.first} and {pair.second}: {pair.verdict}"
        return f"{pair.better} has {self.measure.better} than {pair.worse}"

    @property
    def order(self) -> tuple[str, ...]:
        """Groups by position, the best first."""
        return tuple(sorted(self.values, key=lambda name: self.positions[name]))

    def worse_than(self, group: str) -> tuple[str, ...]:
        """Return the groups that are shown to be worse than another group."""
        return tuple(
            pair.worse for pair in self.pairs if pair.better == group and pair.worse is not None
        )


@dataclass(frozen=True, eq=False, repr=False)
class Comparison(NotebookRepr):
    """Comparison of groups of campaigns."""

    groups: Mapping[str, tuple[CampaignMeasures, ...]]
    """Name of a group -> its campaigns, which are repeats of each other."""
    measures: tuple[MeasureComparison, ...]
    """Comparisons by each measure that all campaigns have, in the order of `MEASURES`."""
    notes: tuple[str, ...]
    """Limits of the comparison, each in a sentence."""
    shared: Mapping[str, str] = field(default_factory=dict)
    """Part of a configuration that all campaigns share -> value of the part as text."""

    def __repr__(self) -> str:
        """Return the groups with their numbers of campaigns."""
        groups = (
            f"{name} ({counted(len(campaigns), 'campaign')})"
            for name, campaigns in self.groups.items()
        )
        return f"<Comparison of {', '.join(groups)}>"

    @property
    def main_measures(self) -> tuple[MeasureComparison, ...]:
        """Comparisons by the measures of short tables, see `Measure.is_main`."""
        return tuple(by for by in self.measures if by.measure.is_main)

    @property
    def headline(self) -> MeasureComparison:
        """Comparison by distinct failures, which decides on the order of the groups."""
        return self.by(HEADLINE)

    @property
    def tested_measures(self) -> int:
        """Number of measures that are not equal in all campaigns."""
        return sum(by.is_tested for by in self.measures)

    @property
    def repeats_needed(self) -> int:
        """Least number of campaigns in each group with which a difference can be shown."""
        return repeats_needed(len(self.groups), max(1, self.tested_measures))

    def by(self, name: str) -> MeasureComparison:
        """Return the comparison by a measure.

        Raises:
            KeyError: no measure has this name, or a campaign lacks the measure.
        """
        for comparison in self.measures:
            if comparison.measure.name == name:
                return comparison
        known = ", ".join(comparison.measure.name for comparison in self.measures)
        raise KeyError(f"no measure is called {name!r}: choose from {known}")


def compare(groups: Mapping[str, Iterable[Path | str]]) -> Comparison:
    """Compare groups of campaigns.

    Args:
        groups: name -> folders of campaigns that repeat each other; two groups or more.

    Raises:
        CampaignError: a campaign does not exist or is damaged.
        FreneticError: there are fewer than two groups, a group is empty or a single folder rather
            than a list, or a campaign is given twice.
    """
    if len(groups) < 2:
        raise FreneticError(
            f"{len(groups)} group of campaigns: at least two are needed to compare; campaigns that"
            " differ in nothing but the seed are one group"
        )
    listed = {name: require_list(f"group {name}", folders) for name, folders in groups.items()}
    _require_different_campaigns(listed)
    measured = {
        name: tuple(measure_campaign(folder) for folder in folders)
        for name, folders in listed.items()
    }
    parts = {name: [parts_of(folder) for folder in folders] for name, folders in listed.items()}
    return compare_measured(
        measured,
        notes=[
            *_note_on_drivers(parts),
            *_notes_on_parts(parts, measured),
            *_notes_on_campaigns(measured, are_as_long=_have_equal_lengths(parts)),
        ],
        shared=shared_parts([campaign for group in parts.values() for campaign in group]),
    )


def _require_different_campaigns(groups: Mapping[str, Sequence[Path | str]]) -> None:
    """Raise a `FreneticError` if a group is empty or a campaign is given twice."""
    paths: set[Path] = set()
    for name, folders in groups.items():
        if not folders:
            raise FreneticError(f"group {name} has no campaigns: at least one is needed")
        for folder in folders:
            path = Path(folder).resolve()
            if path in paths:
                raise FreneticError(f"{folder} is there twice: give each campaign once")
            paths.add(path)


def compare_measured(
    groups: Mapping[str, tuple[CampaignMeasures, ...]],
    *,
    notes: Iterable[str] = (),
    shared: Mapping[str, str] = MappingProxyType({}),
) -> Comparison:
    """Compare groups of measured campaigns, as `compare` does.

    Args:
        groups: name -> campaigns that repeat each other.
        notes: limits of the comparison, each in a sentence.
        shared: see `Comparison.shared`.
    """
    widths = {campaign.lane_width for campaigns in groups.values() for campaign in campaigns}
    values_by_measure = {
        measure: values
        for measure in _measures_on(widths)
        if (values := _values_of(measure, groups)) is not None
    }
    comparison = Comparison(groups, _compare_pairs(values_by_measure), tuple(notes), shared)
    return replace(comparison, notes=(*comparison.notes, *_note_on_power(comparison)))


def _measures_on(lane_widths: Collection[float]) -> Iterator[Measure]:
    """Yield the measures; the MOOBD's unit names its maximum if all lanes have the same width."""
    for measure in MEASURES.values():
        if measure.name == "min_moobd" and len(lane_widths) == 1:
            yield replace(measure, unit=oob_unit(*lane_widths))
        else:
            yield measure


def _values_of(
    measure: Measure, groups: Mapping[str, tuple[CampaignMeasures, ...]]
) -> dict[str, tuple[float, ...]] | None:
    """Return each group's values of a measure; None if a campaign lacks the measure."""
    values: dict[str, tuple[float, ...]] = {}
    for name, campaigns in groups.items():
        measured = [measure.of(campaign) for campaign in campaigns]
        values[name] = tuple(value for value in measured if value is not None)
        if len(values[name]) < len(measured):
            return None
    return values


def _compare_pairs(
    values_by_measure: Mapping[Measure, Mapping[str, tuple[float, ...]]],
) -> tuple[MeasureComparison, ...]:
    """Return the comparisons by each measure, with p values corrected for all that are tested.

    Args:
        values_by_measure: measure -> name of a group -> values of its campaigns.
    """
    untested = [
        MeasureComparison(measure, values, ()) for measure, values in values_by_measure.items()
    ]
    p_values = {
        (by.measure.name, first, second): mann_whitney(by.values[first], by.values[second])
        for by in untested
        if by.is_tested
        for first, second in combinations(by.values, 2)
    }
    corrected = dict(zip(p_values, holm(list(p_values.values())), strict=True))

    def pair_of(by: MeasureComparison, first: str, second: str) -> PairComparison:
        """Return the comparison of two groups by a measure; without a test p is 1."""
        key, sign = (by.measure.name, first, second), by.measure.sign
        sizes = len(by.values[first]), len(by.values[second])
        return PairComparison(
            first=first,
            second=second,
            a12=a12(sign * np.array(by.values[first]), sign * np.array(by.values[second])),
            p=p_values.get(key, 1.0),
            p_corrected=corrected.get(key, 1.0),
            repeats=sizes,
            least_p=_least_corrected(sizes, max(1, len(p_values))),
        )

    return tuple(
        replace(by, pairs=tuple(pair_of(by, *names) for names in combinations(by.values, 2)))
        for by in untested
    )


def _least_corrected(sizes: tuple[int, int], tests: int) -> float:
    """Return the least p that two groups of these sizes can have, corrected by Holm for some tests.

    p is least if all values of one group are better than all of the other. Of all ways to
    distribute the campaigns to the two groups, 2 are that extreme.
    """
    return min(1.0, tests * 2.0 / math.comb(sum(sizes), sizes[0]))


def least_p(sizes: Sequence[int], measures: int = len(MEASURES)) -> float:
    """Return the least p of two groups, corrected by Holm for all pairs of groups and measures.

    Args:
        sizes: number of campaigns in each of two or more groups.
        measures: number of measures that are not equal in all campaigns.
    """
    pairs = list(combinations(sizes, 2))
    return min(_least_corrected(pair, len(pairs) * measures) for pair in pairs)


def repeats_needed(groups: int, measures: int = len(MEASURES)) -> int:
    """Return the least number of campaigns in each group with which a difference can be shown.

    Args:
        groups: number of groups, two or more.
        measures: number of measures that are not equal in all campaigns; by default all, before
            anything was measured.
    """
    return next(n for n in count(LEAST_REPEATS) if least_p([n] * groups, measures) < SIGNIFICANT)


def _note_on_power(comparison: Comparison) -> Iterator[str]:
    """Yield a note if the campaigns are too few to show any difference, however large."""
    sizes = [len(campaigns) for campaigns in comparison.groups.values()]
    measures = comparison.tested_measures
    if len(sizes) < 2 or min(sizes) < LEAST_REPEATS or not measures:
        return
    if (least := least_p(sizes, measures)) >= SIGNIFICANT:
        yield (
            f"with so few campaigns, {len(sizes)} groups and {measures} measures no two can be"
            f" shown to differ: p after correction is {least:.2g} at least; make"
            f" {comparison.repeats_needed} repeats each"
        )


def _note_on_drivers(parts: Mapping[str, Sequence[Mapping[str, Any]]]) -> Iterator[str]:
    """Yield a note if groups have different drivers, which this comparison does not rate."""
    first, *others = (group[0]["driver"] for group in parts.values())
    if any(driver != first for driver in others):
        yield (
            "the groups have different drivers, and this compares what their searches found, not"
            " which driver is better: for that, compare one campaign with the other driver"
        )


def _notes_on_parts(
    parts: Mapping[str, Sequence[Mapping[str, Any]]],
    measured: Mapping[str, tuple[CampaignMeasures, ...]],
) -> Iterator[str]:
    """Yield notes on campaigns that are no repeats, and on groups that differ in several parts."""
    for name, configurations in parts.items():
        mixed = differing_parts(configurations)
        if mixed:
            yield f"the campaigns of {name} are no repeats: they differ in {mixed}"
        seeds = [str(campaign.seed) for campaign in measured[name] if campaign.seed is not None]
        if len(set(seeds)) < len(seeds) and not mixed:
            yield f"campaigns of {name} have the same seed: they are no repeats"
    differing = differing_parts([configurations[0] for configurations in parts.values()])
    if "," in differing:  # a comma separates two parts
        yield f"the groups differ in more than one thing: {differing}"
    ahead = [configurations[0]["max_in_flight"] for configurations in parts.values()]
    if len(set(ahead)) > 1 and None not in ahead:
        numbers = " and ".join(map(str, sorted(set(ahead))))
        yield (
            f"the searches propose {numbers} roads before they know the result of the first"
            " (max_in_flight; a bench's runs 1, 'frenetic run' mostly 16): one search finds other"
            " roads with another number"
        )


def _have_equal_lengths(parts: Mapping[str, Sequence[Mapping[str, Any]]]) -> bool:
    """Return whether all campaigns have one budget, which limits kilometres or simulated time."""
    first, *others = (campaign["budget"] or {} for group in parts.values() for campaign in group)
    is_of_length = any(first.get(name) is not None for name in ("kilometres", "simulated_time"))
    return is_of_length and all(budget == first for budget in others)


def _notes_on_campaigns(
    measured: Mapping[str, tuple[CampaignMeasures, ...]], *, are_as_long: bool
) -> Iterator[str]:
    """Yield notes on campaigns that are unfinished, of unequal length, or have many failures.

    Args:
        measured: measures of the campaigns, by group.
        are_as_long: whether their budget makes them equally long, if not in simulations.
    """
    for name, campaigns in measured.items():
        unfinished = [campaign.folder.name for campaign in campaigns if not campaign.is_finished]
        if unfinished:
            yield f"campaigns of {name} did not finish: {', '.join(unfinished)}"
    simulations = [
        campaign.simulations for campaigns in measured.values() for campaign in campaigns
    ]
    least, most = min(simulations), max(simulations)
    if most > _MOST_UNEQUAL * least and not are_as_long:
        yield (
            f"the campaigns have from {least} to {most} simulations, and more find more: compare"
            " campaigns of equal length, or look at the curves"
        )
    failures = max(campaign.failures for campaigns in measured.values() for campaign in campaigns)
    if failures > MOST_COMPARED:
        yield (
            f"the competition's sparseness of more than {MOST_COMPARED} failures counts"
            f" {MOST_COMPARED} of them, evenly spaced"
        )
    if failures > MOST_LINKED:
        yield (
            f"of more than {MOST_LINKED} failures, {MOST_LINKED}, evenly spaced, are compared in"
            " behaviour, bend and driven road"
        )
