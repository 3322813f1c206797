"""Campaigns: a scenario's changes, each flown with many seeds, and one table of what came out.

`run` is what programs call; `harness.cli.campaign` is the command line.
"""

from harness.campaign.definition import Campaign, Case, load
from harness.campaign.running import Landed, run
from harness.campaign.store import CampaignError, ClusterError
from harness.campaign.table import Table

__all__ = ["Campaign", "CampaignError", "Case", "ClusterError", "Landed", "Table", "load", "run"]
