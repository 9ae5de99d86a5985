"""One search with its budget, on disk."""

from frenetic.campaign.budget import Budget
from frenetic.campaign.campaign import Campaign, Progress, Summary, new_folder
from frenetic.campaign.store import CampaignStore, TestRecord
from frenetic.campaign.tester import RoadTester

__all__ = [
    "Budget",
    "Campaign",
    "CampaignStore",
    "Progress",
    "RoadTester",
    "Summary",
    "TestRecord",
    "new_folder",
]
