"""Folders of the checkout that tests use."""

from pathlib import Path

ROOT = Path(__file__).parents[2]
SCENARIOS = ROOT / "scenarios"
REFERENCE = ROOT / "studies" / "reference"
SUPPORT = ROOT / "tests" / "support"
