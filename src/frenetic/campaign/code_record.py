"""The code of a campaign's parts: versions, sources, folder and signature, and what has changed."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Final

from frenetic._support.json_value import JSONValue, plain
from frenetic.campaign.objective import MOOBD, Objective
from frenetic.campaign.reader import SIGNATURE, SOURCES
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.tester import RoadTester
from frenetic.errors import CampaignError
from frenetic.parts.registry import Construction
from frenetic.parts.trust import named_code
from frenetic.parts.versions import version_of
from frenetic.search.strategy import Strategy
from frenetic.spec import Spec
from frenetic.spec.part_record import changed_parts, describe, describe_terms, sources_of
from frenetic.spec.terms import DriveSetting

SETTING: Final = tuple(item.name for item in fields(DriveSetting))
"""Entries of the configuration that its `DriveSetting` has, too."""
_TERMS: Final = (*(name for name in SETTING if name != "car"), "max_in_flight", "objective")
"""Entries of the configuration that must not change before a resume."""


@dataclass(frozen=True)
class CodeRecord:
    """The code of a campaign's strategy, driver, simulator and objective."""

    tester: RoadTester
    strategy: Strategy
    objective: Objective
    spec: Spec | None
    """Spec that names all parts; None without one."""
    is_strategy_named: bool
    """Whether the spec's name made the strategy, unlike a bench's generator."""

    @property
    def folder(self) -> Path:
        """Folder from which the parts are loaded."""
        return self.tester.folder or Path.cwd()

    @property
    def _construction(self) -> Construction | None:
        """How the strategy's name made it; None for a strategy without a name."""
        if self.spec is None or not self.is_strategy_named:
            return None
        return self.spec.construction("strategy")

    @property
    def strategy_record(self) -> dict[str, JSONValue]:
        """Record of the strategy, see `frenetic.spec.part_record.describe`."""
        with self.tester.in_folder():
            return describe(self.strategy, self._construction)

    @property
    def behaviours(self) -> dict[str, str]:
        """Versions of rules and map, and of an objective of the user's own."""
        measure = self.objective.measure
        if measure.__module__.partition(".")[0] == "frenetic":
            return describe_terms()
        return describe_terms() | {"objective": version_of(measure).text}

    @property
    def sources(self) -> dict[str, JSONValue]:
        """Sources of the parts that are the user's own: name of a file -> its text."""
        with self.tester.in_folder():
            sources = self.tester.sources | sources_of(self.strategy, self._construction)
        return {**sources, **sources_of(self.objective.measure)}

    def signature(self, sources: JSONValue) -> tuple[dict[str, JSONValue], bool]:
        """Return the fact with the user's signature, and whether the key could not be written.

        There is no fact without named code.
        """
        if self.spec is None:
            return {}, False
        if (signed := self.spec.signed_in(self.folder, sources).signed) is not None:
            return {SIGNATURE: signed.signature}, False
        return {}, bool(named_code(self.spec.parts))

    def require_same(
        self,
        store: CampaignStore,
        configuration: Mapping[str, JSONValue],
        advice: Callable[[], str],
    ) -> None:
        """Check that a stored campaign has these terms and parts.

        Args:
            store: the campaign.
            configuration: its configuration if it began now.
            advice: gives the end of a message: how to start another campaign.

        Raises:
            CampaignError: a term or a part is another than the campaign's.
        """
        present = json.loads(json.dumps(configuration, default=plain))
        for name in _TERMS:
            recorded = store.config.get(name, MOOBD if name == "objective" else None)
            if present[name] != recorded:
                raise CampaignError(
                    f"{store.folder} was made with another {name.replace('_', ' ')}:"
                    f" {json.dumps(recorded)[:300]}, not {json.dumps(present[name])[:300]}"
                )
        if changes := changed_parts(store.config, present):
            texts = [text for part_texts in changes.values() for text in part_texts]
            raise CampaignError(
                f"{store.folder} was made with another {' and '.join(changes)}:"
                f" {'; '.join([*self._edited(store), *texts])[:1000]}; restore it, or {advice()}"
            )

    def _edited(self, store: CampaignStore) -> list[str]:
        """Return a text about each of the user's files that was edited since."""
        recorded, sources = store.fact(SOURCES) or {}, self.sources
        return [
            f"{name} was edited"
            for name in sorted(sources)
            if isinstance(recorded, Mapping) and recorded.get(name) != sources[name]
        ]
