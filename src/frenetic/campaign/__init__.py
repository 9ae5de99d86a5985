"""One search with its budget, on disk."""

from frenetic.campaign.campaign import Campaign
from frenetic.campaign.defaults import MAX_IN_FLIGHT, new_folder
from frenetic.campaign.evaluation import evaluate
from frenetic.campaign.record import Test
from frenetic.campaign.store import CampaignStore
from frenetic.campaign.summary import Event, Summary
from frenetic.campaign.tester import RoadTester
from frenetic.spec import Budget

__all__ = [
    "MAX_IN_FLIGHT",
    "Budget",
    "Campaign",
    "CampaignStore",
    "Event",
    "RoadTester",
    "Summary",
    "Test",
    "evaluate",
    "new_folder",
]
