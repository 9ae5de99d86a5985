"""Files of a minimised road: the road, a picture of its drive, and a picture of both drives."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from frenetic._support.files import check_writable, write_file
from frenetic.campaign import RoadTester
from frenetic.errors import FreneticError
from frenetic.report.failures import road_entries, verdict_entries
from frenetic.rerun.minimise import Minimised
from frenetic.rerun.minimising_strategy import OPERATOR
from frenetic.spec import DRIVEN, USUAL, Spec

_REMEDY: Final = "choose another place"


@dataclass(frozen=True)
class MinimisedFiles:
    """Paths of a minimised road's files."""

    road: Path
    """Path of the JSON for `frenetic drive`."""
    picture: Path
    """Path of the picture of the drive on the minimised road."""
    comparison: Path
    """Path of the picture with the drives before and after minimising, side by side."""

    @classmethod
    def beside(cls, road: Path) -> MinimisedFiles:
        """Return the paths of a road file and of the pictures beside it."""
        name = road.name.removesuffix(".json")
        return cls(road, road.with_name(f"{name}.png"), road.with_name(f"{name}-before-after.png"))

    def prepare(self) -> None:
        """Make the folder of the files, and check that they can be written.

        Raises:
            FreneticError: the folder cannot be made, or a file cannot be written.
        """
        folder = self.road.parent
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FreneticError(
                f"the folder {folder} cannot be made: {error.strerror or error}; {_REMEDY}"
            ) from None
        for file in (self.road, self.picture, self.comparison):
            check_writable(file, remedy=_REMEDY)


def minimised_document(
    minimised: Minimised, tester: RoadTester, test_id: int | None = None
) -> dict[str, Any]:
    """Return a minimised road as JSON for `frenetic drive` and the competition's tools.

    Args:
        minimised: the minimised road.
        tester: the tester that drove the road.
        test_id: id of the campaign's test; None for a road from a file.
    """
    smallest, setting = minimised.smallest, minimised.smallest.setting
    assert setting is not None
    spec = None
    if tester.spec is not None:
        spec = Spec.of(USUAL, tester.spec).driving_spec().signed_in(tester.folder)
    parents: list[int] = [] if test_id is None else [test_id]
    return {
        **({} if test_id is None else {"id": test_id}),
        "is_valid": True,
        "validation_message": "",
        **verdict_entries(smallest.result),
        "origin": {"operator": OPERATOR, "parents": parents},
        **tester.described,
        "rules": setting.rules.as_json(),
        **({} if spec is None else {DRIVEN: spec.in_conditions(minimised.conditions).entries()}),
        "minimised": {
            "reason": str(minimised.reason),
            "difference": minimised.difference,
            "match": minimised.match,
            "original_length": minimised.original.road.length,
            "drives": minimised.drives,
            "campaign": minimised.folder,
            "test": smallest.id,
            "is_guarded": minimised.is_guarded,
            "ending": str(minimised.stop_reason),
            **({"passes": dict(minimised.passes)} if minimised.passes else {}),
        },
        **road_entries(smallest.road),
    }


def write_minimised(
    minimised: Minimised,
    files: MinimisedFiles,
    document: Mapping[str, Any],
    *,
    name: str,
    is_compared: bool = True,
) -> None:
    """Write the road's file, and draw the pictures.

    Args:
        minimised: the minimised road.
        files: paths of the files; existing files are replaced.
        document: contents of the road file, see `minimised_document`.
        name: name of the original in the pictures.
        is_compared: whether to draw the picture of the drives before and after, too.

    Raises:
        FreneticError: a file cannot be written.
    """
    from frenetic.report.picture import draw_gallery, draw_test  # matplotlib imports slowly

    write_file(files.road, json.dumps(document) + "\n", remedy=_REMEDY)
    before, after = minimised.original, minimised.smallest
    draw_test(after, files.picture, f"{name}, minimised")
    if not is_compared:
        return
    draw_gallery(
        [("Before", before.road, before), ("After", after.road, after)],
        files.comparison,
        title=f"{name}: {minimised.reason}",
    )
