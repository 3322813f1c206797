"""Campaigns: variations of a scenario, each flown with several seeds, and one table of the results.

`run` is the Python interface; `harness.cli.campaign` is the command line.
"""

from harness.campaign.definition import Campaign, Case, load
from harness.campaign.running import Landed, run
from harness.campaign.store import CampaignError, ClusterError
from harness.campaign.table import Table

__all__ = ["Campaign", "CampaignError", "Case", "ClusterError", "Landed", "Table", "load", "run"]
