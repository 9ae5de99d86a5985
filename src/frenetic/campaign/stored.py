"""A test that a campaign has stored, made ready to be looked at, drawn or driven again."""

from __future__ import annotations

from dataclasses import dataclass

from frenetic.campaign.store import DATABASE, CampaignStore, TestRecord
from frenetic.errors import CampaignError
from frenetic.outcome import Outcome
from frenetic.road import Pose, Road
from frenetic.simulators.drive import CarBody, Drive, Rules


@dataclass(frozen=True)
class StoredTest:
    """A test of a campaign with its road and its drive made ready again."""

    record: TestRecord
    road: Road
    """Where it lay on the map; at its default place if it fitted nowhere."""
    drive: Drive | None
    """None if nothing was driven or the record was read without its trajectory."""

    @property
    def id(self) -> int:
        """The candidate's id."""
        return self.record.candidate.id


def stored_test(store: CampaignStore, record: TestRecord) -> StoredTest:
    """The road and drive behind a record.

    Raises:
        CampaignError: the campaign's configuration does not say how it was driven.
    """
    config = store.config
    path = store.folder / DATABASE
    try:
        lane_width = float(config["lane_width"])  # type: ignore[arg-type]
        rules = Rules(**config["rules"])  # type: ignore[arg-type]
        car = CarBody(**config["car"])  # type: ignore[arg-type]
    except (KeyError, TypeError, ValueError) as error:
        raise CampaignError(f"{path} is damaged: its configuration lacks {error}") from None
    candidate = record.candidate
    pose = Pose(*record.pose) if record.pose is not None else None
    road = Road(
        candidate.curvatures,
        candidate.step,
        **({} if pose is None else {"pose": pose}),
        lane_width=lane_width,
    )
    drive = None
    if record.trajectory is not None:
        trouble = record.reason if record.outcome is Outcome.ERROR else None
        drive = Drive(record.trajectory, car, rules, trouble)
    return StoredTest(record, road, drive)
