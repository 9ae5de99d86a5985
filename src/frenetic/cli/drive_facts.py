"""Facts about a drive for the terminal: speed limit, MOOBD, where it left its lane, signals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from frenetic._support.words import lane_words
from frenetic.cli.console import print_table
from frenetic.conditions.condition import SPEED
from frenetic.criteria.criterion import DRIVER, LANE, signal_named

if TYPE_CHECKING:
    from frenetic.criteria.criterion import CriteriaSet
    from frenetic.oracle.verdict import Finding, Result
    from frenetic.road import Road
    from frenetic.spec.terms import DriveSetting


_SWEPT_LIMITS: Final = {"least_speed", "largest_speed"}
"""Options of a sweep that are its range of speed limits."""


def limit_text(
    setting: DriveSetting,
    road: Road | None = None,
    conditions: Mapping[str, float] = MappingProxyType({}),
) -> str:
    """Return the speed limit on a road as a text, with its origin.

    Args:
        setting: the terms and rules with which the road is driven.
        road: the road; None for the roads of a search.
        conditions: the drive's own conditions, which may hold a speed limit.
    """
    class_name = "" if setting.road_class is None else setting.road_class.name
    return setting.rules_in(conditions).limit_text(road, class_name)


def limit_of_search(setting: DriveSetting, from_roads: object, strategy_options: object) -> str:
    """Return the speed limit of a search's roads as a text, with its origin.

    Args:
        setting: the terms and rules of the search.
        from_roads: folder of the real roads from which the search starts; None without such roads.
        strategy_options: recorded options of the strategy, a mapping; a sweep has a least and a
            largest speed limit.
    """
    if isinstance(strategy_options, Mapping) and strategy_options.keys() >= _SWEPT_LIMITS:
        least, largest = strategy_options["least_speed"], strategy_options["largest_speed"]
        return f"{least:g} to {largest:g} km/h, swept"
    domain, rules = setting.domain, setting.rules_in({})
    if domain is not None and SPEED in domain.conditions:
        return f"drawn from {domain.name}"
    limit = limit_text(setting)
    if from_roads is None or rules.road_limits == "ignored":
        return limit
    scaling = "" if rules.road_limits == "kept" else f", scaled to {rules.speed_limit:.4g} km/h"
    return f"each real road's own{scaling}; of other roads {limit}"


def facts_of_drive(
    result: Result, duration: float | None, lane_width: float
) -> list[tuple[str, str]]:
    """Return facts about a drive as labels and texts.

    Args:
        result: result of the drive, fresh or recorded.
        duration: time that the drive took, in s; None if nothing was driven.
        lane_width: width of the lane, in m.
    """
    facts = []
    if result.moobd is not None and result.moobd_distance is not None:
        facts += [
            (
                "MOOBD",
                f"{result.moobd:.3f} m, at {result.moobd_distance:.1f} m: the car's centre"
                f" {'was' if result.moobd < 0.0 else 'stayed'}"
                f" {lane_words(result.moobd, lane_width)}",
            ),
            ("oob share", f"{result.max_oob_share:.0%} at most"),
        ]
    if duration is not None:
        facts.append(("time", f"{duration:.2f} s"))
    if result.fault is not None:
        facts.append(("fault", f"the {result.fault.part} {result.fault}"))
    departure = result.departure
    if departure is not None:  # otherwise the result's reason names the exceeded criteria
        facts += [
            ("exceeded", _finding_text(finding))
            for finding in result.findings
            if finding.criterion not in (LANE, DRIVER)
        ]
        facts.append(
            (
                "left lane",
                f"to the {departure.side} after {departure.distance:.1f} m and"
                f" {departure.time:.2f} s, at ({departure.x:.1f}, {departure.y:.1f})",
            )
        )
    return facts


def _finding_text(finding: Finding) -> str:
    """Return which signal exceeded its limit, by how much and where."""
    signal = signal_named(finding.criterion)
    side = f" to the {finding.side}" if finding.side else ""
    return (
        f"{signal.words} {signal.text(finding.value)}{side} at {finding.distance:.1f} m and"
        f" {finding.time:.2f} s, the limit is {finding.limit:g}"
    )


def print_measures(rows: Sequence[Mapping[str, Any]], criteria: CriteriaSet) -> None:
    """Print the signals of a drive with the limits of its criteria.

    Args:
        rows: a signal each, as `frenetic.oracle.measures.measures_json` returns them.
        criteria: the criteria of the drive.
    """
    if not rows:
        return
    print_table(
        ("signal", ">worst", "", "where", f">{criteria.name}", ""),
        [
            (
                row["signal"].replace("_", " "),
                f"{round(row['value'], 2) + 0.0:.2f}",  # + 0.0 turns -0.0 into 0.0
                row["unit"],
                f"{row['distance']:.0f} m{f', {side}' if (side := row['side']) else ''}",
                None if row["limit"] is None else f"{row['limit']:g}",
                {None: "", True: "kept", False: "exceeded"}[row["kept"]],
            )
            for row in rows
        ],
    )
