"""What follows from the entries of a run: its parts by name, rules, terms and budget.

Every command's help reads this module, so slow imports are inside functions.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final

from frenetic._support.option_text import read_part
from frenetic.conditions.condition import amounts_in
from frenetic.errors import FreneticError
from frenetic.spec.budget import LIMITS, Budget
from frenetic.spec.parts import USUAL, Part
from frenetic.spec.run_entries import RunEntries
from frenetic.spec.values import read_class, read_criteria, read_domain

if TYPE_CHECKING:
    from frenetic.conditions.domain import Domain
    from frenetic.oracle.drive import Rules
    from frenetic.road.classes import RoadClass
    from frenetic.spec.terms import Terms

TERMS_ENTRIES: Final = ("map_size", "map_margin", "lane_width")
"""Entries that `Terms` has by the same names; a road that exists brings its own values."""


class RunSettings(RunEntries, frozen=True, kw_only=True):
    """The entries of a run with what follows from them.

    Raises:
        ValueError: an entry is out of range.
        FreneticError: no roads, criteria or conditions have this name.
    """

    def part(self, kind: str) -> Part:
        """Return the strategy, driver or simulator; the usual one if the user names none."""
        name, options = read_part(getattr(self, kind) or USUAL[kind])
        return Part(name or USUAL[kind], options)

    @property
    def names_roads(self) -> bool:
        """Whether the entries say which roads may exist: by class, domain or real roads."""
        has_domain_roads = isinstance(self.odd, Mapping) and self.odd.get("roads") is not None
        return self.roads is not None or self.from_roads is not None or has_domain_roads

    @cached_property
    def road_class(self) -> RoadClass | None:
        """Class whose rules the roads keep; None for the competition's roads."""
        if self.roads is not None:
            return read_class(self.roads)
        if self.domain is not None and self.domain.road_class is not None:
            return self.domain.road_class
        if self.from_roads is not None:
            from frenetic.road.real_roads import shown_class  # imports numba

            return shown_class(self.from_roads)
        return None

    @cached_property
    def domain(self) -> Domain | None:
        """Domain whose roads and conditions are searched; None for the usual conditions."""
        return None if self.odd is None else read_domain(self.odd)

    @cached_property
    def rules(self) -> Rules:
        """Rules of the drives, apart from a speed limit among the conditions."""
        from frenetic.oracle.drive import Rules  # imports numba

        return self.rules_over(Rules())

    def rules_over(self, simulator_rules: Rules) -> Rules:
        """Return a simulator's rules with the rules that the user sets.

        Raises:
            FreneticError: a rule is out of range.
        """
        values: dict[str, Any] = {}
        if self.oob_tolerance is not None:
            values["oob_tolerance"] = self.oob_tolerance
        if self.criteria is not None:
            values["criteria"] = read_criteria(self.criteria)
        if self.speed_limit is not None:
            values |= {"speed_limit": self.speed_limit, "road_limits": "ignored"}
        elif self.road_class is not None:
            values |= {"speed_limit": self.road_class.speed_limit, "road_limits": "kept"}
        try:
            return replace(simulator_rules, **values)
        except ValueError as error:
            raise FreneticError(str(error)) from None

    @cached_property
    def terms(self) -> Terms:
        """Map, lanes, roads and conditions of every drive.

        Raises:
            ValueError: two entries do not suit each other, such as a map too small for its margin.
        """
        from frenetic.spec.terms import Terms  # imports numba

        values = {
            name: value for name in TERMS_ENTRIES if (value := getattr(self, name)) is not None
        }
        values |= {"domain": self.domain, "conditions": self.conditions}
        return Terms.of_class(self.road_class, **values)

    @property
    def budget(self) -> Budget | None:
        """Limits of the run; None without limits."""
        limits: dict[str, Any] = {name: getattr(self, name) for name in LIMITS}
        return Budget(**limits) if any(limits.values()) else None

    @property
    def named_objective(self) -> str:
        """Name of the objective: by default the MOOBD, or with criteria the margin to them."""
        has_criteria = self.criteria is not None and bool(read_criteria(self.criteria))
        return self.objective or ("criteria" if has_criteria else "moobd")

    @property
    def amounts(self) -> dict[str, float]:
        """Amounts of the conditions that the user sets, also as options of the simulator."""
        return amounts_in(self.part("simulator").options) | self.conditions
