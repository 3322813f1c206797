"""Write the generated pages of docs/reference: ``python scripts/write_reference.py [--check]``.

``--check`` writes nothing; the status is then 1 if a page is not current.
"""

import argparse
import os
import sys
from collections.abc import Mapping
from pathlib import Path

from harness.launch import kernel_cache

os.environ.update(kernel_cache.environment())  # read when numba is imported, which is next

from antenna.lab.cli import app as antenna_app
from harness.cli.campaign import campaign_app
from harness.cli.export import app as export_app
from harness.cli.fly import app as fly_app
from harness.cli.replay import app as replay_app
from harness.cli.report import app as report_app
from netsim.lab.cli import app as wifi_app
from reference.commands import commands_page
from reference.exit_statuses import statuses_page
from reference.licences import licences_page
from reference.python_api import python_page
from reference.run_tables import tables_page
from reference.scenario_fields import SCHEMA_FILE, scenario_page, scenario_schema
from studies.antenna.cli import validate_antenna_app
from studies.article.cli import article_app
from studies.attacks.cli import attacks_app
from studies.bench.cli import bench_app
from studies.chaos.cli import chaos_app
from studies.codesign.cli import codesign_app
from studies.link_tables.tables import tables_app
from studies.radio.bench_cli import bench_radio_app
from studies.radio.cli import validate_radio_app
from studies.soak.cli import soak_app
from studies.vehicle.bench_cli import bench_app as bench_vehicle_app
from studies.vehicle.cli import validate_app

FOLDER = Path(__file__).parents[1] / "docs" / "reference"
APPLICATIONS = {
    "coflight fly": fly_app, "coflight replay": replay_app, "coflight report": report_app,
    "coflight campaign": campaign_app,
    "coflight radio": wifi_app, "coflight antenna": antenna_app, "coflight export": export_app,
    "coflight bench": bench_app, "coflight study vehicle": validate_app,
    "coflight study radio": validate_radio_app, "coflight study antenna": validate_antenna_app,
    "coflight study codesign": codesign_app, "coflight study article": article_app,
    "coflight study soak": soak_app, "coflight study attacks": attacks_app,
    "coflight study chaos": chaos_app,
    "coflight study vehicle-cost": bench_vehicle_app, "coflight study radio-cost": bench_radio_app,
    "python scripts/link_tables.py": tables_app,
}  # fmt: skip
"""Command lines that the page describes, in its order."""
LICENCES = "licences.md"


def _locks() -> dict[str, str]:
    """Return the texts of the lock files by name, the one that flying needs first."""
    paths = sorted(FOLDER.parents[1].glob("requirements*.lock"), key=lambda path: (len(path.stem), path.name))
    return {path.name: path.read_text(encoding="utf-8") for path in paths}


def outdated(pages: Mapping[str, str], folder: Path) -> list[str]:
    """Return the names of the pages that the folder lacks or has with another text."""
    texts = {path.name: path.read_text(encoding="utf-8") for path in folder.glob("*") if path.name in pages}
    return [name for name, text in pages.items() if texts.get(name) != text]


def main() -> int:
    """Write or check the pages, and return the exit status."""
    parser = argparse.ArgumentParser(description="Write the generated pages of docs/reference.")
    parser.add_argument(
        "--check", action="store_true", help="Write nothing; status 1 if a page is not current."
    )
    check = parser.parse_args().check
    pages = {
        "scenario.md": scenario_page(),
        SCHEMA_FILE: scenario_schema(),
        "command-line.md": commands_page(APPLICATIONS),
        "exit-status.md": statuses_page(),
        "tables.md": tables_page(),
        "python-api.md": python_page(),
        LICENCES: licences_page(_locks(), (FOLDER / LICENCES).read_text(encoding="utf-8")),
    }
    changed = outdated(pages, FOLDER)
    for name in changed:
        if not check:
            (FOLDER / name).write_text(pages[name], encoding="utf-8")
        print(f"docs/reference/{name}: {'not current' if check else 'written'}")
    return 1 if check and changed else 0


if __name__ == "__main__":
    sys.exit(main())
