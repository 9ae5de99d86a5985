"""Roads that two versions of a driver have driven: `PairedRoads`."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from frenetic._support.json_value import JSONValue
from frenetic.campaign.record import Test
from frenetic.oracle.outcome import Outcome
from frenetic.rerun.stability import Change


class Pair(NamedTuple):
    """Drives of both versions on one road."""

    old: Test
    """Drive of the old version."""
    new: Test
    """Drive of the new version."""

    @property
    def change(self) -> Change:
        """Change of the outcome from the old version to the new one."""
        if not (self.old.outcome.is_driven and self.new.outcome.is_driven):
            return Change.NOT_JUDGED
        return Change.of(*(test.outcome is Outcome.FAIL for test in self))


@dataclass(frozen=True)
class PairedRoads:
    """Drives of both versions on several roads."""

    folder: Path
    """Folder of the campaign that holds the roads, and the old version's drives."""
    pairs: tuple[Pair, ...]
    """Drives on each road."""

    @property
    def judged(self) -> list[Pair]:
        """Pairs whose two drives were both judged."""
        return [pair for pair in self.pairs if pair.change is not Change.NOT_JUDGED]

    @property
    def changes(self) -> Counter[Change]:
        """Number of roads with each change."""
        return Counter(pair.change for pair in self.pairs)

    @property
    def failing(self) -> tuple[int, int]:
        """Numbers of judged roads on which the old and the new version fail."""
        old, new = (sum(pair[i].outcome is Outcome.FAIL for pair in self.judged) for i in range(2))
        return old, new

    def as_json(self) -> dict[str, JSONValue]:
        """Return the counts as a JSON object."""
        old, new = self.failing
        return {
            "campaign": str(self.folder),
            "judged": len(self.judged),
            "failing": {"old": old, "new": new},
            "changes": {str(change): self.changes[change] for change in Change},
        }
