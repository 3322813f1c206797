"""The documented exit statuses and JSON keys of the commands that fly or measure real processes.

Those of ``coflight bench`` are in `test_bench_flights`.
"""

import json
import subprocess
import sys
from pathlib import Path

import forked_command
import pytest

from foundation.exit_status import FAILED, FINE
from reference.exit_statuses import RESULTS, SUMMARY

pytestmark = pytest.mark.multiprocess

WALL_LIMIT_S = 240.0
KEYS = {each.command: set(each.keys) for each in RESULTS}
LOW = "--set formation.height_m=2 --set onboard.localisation=gps"  # reached sooner
FLIGHT = f"article --agents 2 --one-process --json {LOW}"
CAMPAIGN = """
scenario = "article"
seeds = 1
[set]
agents = 2
formation.height_m = 2
onboard.localisation = "gps"
run.duration_s = 0.5
"""


def coflight(folder: Path, command: str) -> tuple[int, str]:
    """Run a command in a folder; return its status and what it prints on stdout."""
    done = forked_command.run(command.split(), folder, limit_s=WALL_LIMIT_S)
    return done.returncode, done.stdout


def test_a_flight_its_report_and_its_deck(tmp_path: Path) -> None:
    status, flown = coflight(tmp_path, f"fly {FLIGHT} --duration 0.5 --out run")
    assert (status, set(json.loads(flown))) == (FINE, set(SUMMARY))
    assert coflight(tmp_path, "report run --json") == (FINE, flown)
    status, deck = coflight(tmp_path, f"export run --time {json.loads(flown)['simulated_s'] - 0.1}")
    assert status == FINE
    assert deck.startswith("CM ")


def test_a_flight_that_fails_has_a_summary(tmp_path: Path) -> None:
    status, flown = coflight(tmp_path, f"fly {FLIGHT} --set run.reach_timeout_s=0.5 --out run")
    assert (status, set(json.loads(flown))) == (FAILED, set(SUMMARY))
    assert json.loads(flown)["status"] == "not_formed"


def test_a_swarm_that_waits(tmp_path: Path) -> None:
    status, flown = coflight(
        tmp_path, "hold article --agents 1 --duration 0.5 --speed max --port-offset 3000 --json --out run"
    )
    assert (status, set(json.loads(flown))) == (FINE, set(SUMMARY))


def test_a_campaign(tmp_path: Path) -> None:
    (tmp_path / "c.toml").write_text(CAMPAIGN)
    done = subprocess.run(  # its workers import the main module of their parent process
        [sys.executable, "-m", "coflight", "campaign", "c.toml", "--workers=1", "--json", "--out=out"],
        cwd=tmp_path, stdout=subprocess.PIPE, text=True, timeout=WALL_LIMIT_S, check=False,
    )  # fmt: skip
    assert (done.returncode, set(json.loads(done.stdout))) == (FINE, KEYS["campaign"])


@pytest.mark.parametrize(
    ("command", "options"),
    [
        ("study vehicle", "--quick --only allocation"),
        ("study radio-cost", "--seconds 0.5 --repeats 1 --stations 2"),
    ],
)
def test_measurements(tmp_path: Path, command: str, options: str) -> None:
    """A busy machine may exceed a limit, which is documented as well."""
    status, printed = coflight(tmp_path, f"{command} {options} --json")
    assert status in {FINE, FAILED}
    assert set(json.loads(printed)) == KEYS[command]
