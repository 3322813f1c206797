"""The documented exit statuses and JSON keys, by calling the commands; flights are in tests/multiprocess."""

import json
import sys
from unittest.mock import Mock

import pytest

from coflight.command import COMMANDS, STUDIES, main
from foundation.exit_status import BAD_INPUT, FAILED, FINE, INTERRUPTED
from reference.exit_statuses import RESULTS, STATUSES
from studies.vehicle import bench_cli
from studies.vehicle.bench import StepCost

KEYS = {each.command: set(each.keys) for each in RESULTS}
WRONG = {
    "fly": "no-such-scenario", "hold": "no-such-scenario", "report": "no-such-run",
    "campaign": "no-such-campaign.toml", "radio": "per --mode none --snr-db 1",
    "antenna": "pattern --formation none", "bench": "--agents none", "study vehicle": "--only none",
    "study radio": "--only none", "study antenna": "--only none", "study codesign": "--only none",
    "study soak": "--only none",
    "study attacks": "--only none",
    "study programs": "--only none",
    "study article": "--seeds 0", "study vehicle-cost": "--repeats 0", "study radio-cost": "--rate-mbps 7",
    "study chaos": "--flights 0",
    "export": "no-such-run --time 1", "scenarios": "none",
    "replay": "no-such-run", "shell": "0 --run no-such-run",
}  # fmt: skip
"""Arguments that each command refuses."""
COMPUTED = {
    "radio saturation": "--seconds 0.05",
    "radio broadcast": "--seconds 0.5",
    "radio per": "--mode ofdm6 --snr-db 3",
    "radio ftm": "--sessions 5",
    "radio ftm-mesh": "--seconds 0.2 --stations 2",
    "antenna pattern": "--grid 10",
    "antenna statistics": "--grid 10 --samples 3 --cores 1",
    "campaign --dry-run": "campaigns/wind",
    "study radio": "--only per",
    "study antenna": "--only ideal --quick",
}
"""Arguments that take each command a moment."""


def status_of(command):
    """Run a command; return its status, also of those that end the program."""
    try:
        return main(command.split())
    except SystemExit as end:
        return end.code


def test_every_command_has_its_statuses():
    commands = [name for name in COMMANDS if name != "study"] + [f"study {name}" for name in STUDIES]
    assert sorted(STATUSES) == sorted(commands)
    assert all({FINE, BAD_INPUT} <= set(meanings) for meanings in STATUSES.values())


@pytest.mark.parametrize("command", STATUSES)
@pytest.mark.parametrize("option", [None, "--no-such-option"])
def test_bad_input(command, option, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert status_of(f"{command} {option or WRONG[command]}") == BAD_INPUT
    streams = capsys.readouterr()
    assert streams.out == ""
    assert streams.err.strip()
    assert "Traceback" not in streams.err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", STATUSES)
def test_help_is_fine(command, capsys):
    assert status_of(f"{command} --help") == FINE
    assert capsys.readouterr().out


@pytest.mark.parametrize("command", COMPUTED)
def test_json_is_one_object_with_the_documented_keys(command, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert status_of(f"{command} {COMPUTED[command]} --json") == FINE
    assert set(json.loads(capsys.readouterr().out)) == KEYS[command]


@pytest.mark.parametrize(
    ("command", "called"),
    [
        ("fly article --one-process --out run", "harness.cli.fly.load"),
        ("report .", "harness.cli.report.read_scenario"),
        ("campaign campaigns/wind", "harness.cli.campaign.load"),
        ("radio per --mode ofdm6 --snr-db 3", "netsim.lab.cli.packet_error_rate"),
        ("antenna pattern", "antenna.lab.cli.formation"),
        ("bench", "studies.bench.cli.load"),
        ("study radio", "studies.common.command_line.run_subjects"),
        ("export run --time 1", "harness.cli.export.read_scenario"),
        ("replay .", "harness.cli.replay.read_scenario"),
    ],
)
def test_interrupted(command, called, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(called, Mock(side_effect=KeyboardInterrupt))
    assert status_of(command) == INTERRUPTED
    streams = capsys.readouterr()
    assert streams.out == ""
    says_nothing = command.startswith(("radio", "antenna"))  # nothing is left to be continued
    assert len(streams.err.splitlines()) == (0 if says_nothing else 1)


@pytest.mark.parametrize(("step_us", "expected"), [(1.0, FINE), (1e6, FAILED)])
def test_cost_of_a_vehicle(step_us, expected, capsys, monkeypatch):
    cost = StepCost(step_us=step_us, floor_us=0.5, parts_us={}, longest_us=step_us)
    monkeypatch.setattr(bench_cli, "kernel_cache", Mock())
    monkeypatch.setattr(bench_cli, "keep_stdout", lambda: sys.stdout)
    monkeypatch.setattr(bench_cli, "record_flight", Mock())
    for name in ("measure", "measure_without_compiler"):
        monkeypatch.setattr(bench_cli, name, Mock(return_value=cost))
    assert status_of("study vehicle-cost --json") == expected
    assert set(json.loads(capsys.readouterr().out)) == KEYS["study vehicle-cost"]
