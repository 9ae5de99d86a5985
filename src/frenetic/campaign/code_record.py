"""The code of a campaign's parts: versions, sources, folder, signature, and changes since."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from typing import Final

from frenetic._support.json_value import JSONValue, plain
from frenetic.campaign.objective import MOOBD, Objective
from frenetic.campaign.reader import SIGNATURE, SOURCES
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.tester import RoadTester
from frenetic.errors import CampaignError
from frenetic.parts.construction import Construction
from frenetic.parts.named_code import named_code
from frenetic.parts.versions import version_of
from frenetic.search.strategy import Strategy
from frenetic.spec import Spec
from frenetic.spec.part_record import behaviour_versions, changed_parts, describe, sources_of
from frenetic.spec.terms import DriveSetting

SETTING: Final = tuple(item.name for item in fields(DriveSetting))
"""Names of the entries of the configuration that are fields of its `DriveSetting`."""
_FIXED_ENTRIES: Final = (
    *(name for name in SETTING if name != "car"),
    "max_in_flight",
    "objective",
)
"""Names of the entries of the configuration that must be the same when a campaign is resumed."""
_DEFAULTS: Final = {
    **{item.name: item.default for item in fields(DriveSetting) if item.default is not MISSING},
    "objective": MOOBD,
}
"""Values of entries that a campaign does not record, since it is older than the entry."""


@dataclass(frozen=True)
class CodeRecord:
    """The code of a campaign's strategy, driver, simulator and objective."""

    tester: RoadTester
    strategy: Strategy
    objective: Objective
    spec: Spec | None
    """Spec that names all parts; None if a part has no name."""
    is_strategy_named: bool
    """Whether the strategy was made by the spec's name, as a bench's generator is not."""

    @property
    def folder(self) -> Path:
        """Folder from which the parts are loaded."""
        return self.tester.folder or Path.cwd()

    @property
    def _construction(self) -> Construction | None:
        """How the strategy was made by its name; None for a strategy without a name."""
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
        """Versions of our rules and our map, and of the objective if it is the user's."""
        measure = self.objective.measure
        if measure.__module__.partition(".")[0] == "frenetic":
            return behaviour_versions()
        return behaviour_versions() | {"objective": version_of(measure).text}

    @property
    def sources(self) -> dict[str, JSONValue]:
        """Sources of the parts that are the user's: name of a file -> its text."""
        with self.tester.in_folder():
            sources = self.tester.sources | sources_of(self.strategy, self._construction)
        return {**sources, **sources_of(self.objective.measure)}

    def signature(self, sources: JSONValue) -> tuple[dict[str, JSONValue], bool]:
        """Return the fact with the user's signature of the code, and whether signing failed.

        There is no fact if the spec names no code of the user's. Signing fails if the user's key
        cannot be written.

        Args:
            sources: sources of the parts, as `sources` returns them.
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
        """Check that a stored campaign has the terms and parts with which it is to be resumed.

        Args:
            store: the campaign.
            configuration: configuration that the campaign would have if it started now.
            advice: function that returns the end of a message: how to start another campaign.

        Raises:
            CampaignError: a term or a part differs from the campaign's.
        """
        present = json.loads(json.dumps(configuration, default=plain))
        for name in _FIXED_ENTRIES:
            recorded = store.config.get(name, _DEFAULTS.get(name))
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
        """Return a text about each of the user's files that was edited since the start."""
        recorded, sources = store.fact(SOURCES) or {}, self.sources
        return [
            f"{name} was edited"
            for name in sorted(sources)
            if isinstance(recorded, Mapping) and recorded.get(name) != sources[name]
        ]
