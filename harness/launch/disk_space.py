"""Estimate of the disk space that a run takes, for a warning before the flight."""

from autopilot.logs.vehicle_record import VEHICLE_RECORD
from foundation.durations import duration_text
from harness.scenario.scenario import Scenario
from harness.simulator.truth_record import truth_record
from netsim.emulator.log_layout import RECEPTION_LOG

START_S = 60.0
"""Simulated time before the formation is reached, of the article's scenario with some reserve."""
FRAMES_S = 33.0
"""Frames per UAV and simulated second of the formation application, with its ranging."""
FRAME_BYTES = 120
"""A frame's row, with its share of the sessions' rows."""
CAPTURED_BYTES = 250
"""A frame in a capture, with its headers."""
TABLES_SHARE = 0.6
"""Size of the tables, relative to the raw logs; both exist while the tables are written."""
COLUMNS_SHARE = 1.05
"""Size of the file that holds the flight's columns meanwhile, relative to the logs of truth and estimates."""


def expected_bytes(scenario: Scenario) -> float:
    """Return the most disk space that a run of the scenario takes, about: while its tables are written."""
    agents, radio = scenario.agents, scenario.radio
    seconds = scenario.run.duration_s + (START_S if scenario.forms else 0.0)
    row_bytes = truth_record(scenario.most_rotors).itemsize + VEHICLE_RECORD.itemsize
    recorded_s = row_bytes * 1e6 / scenario.record_period_us
    frame_bytes = float(FRAME_BYTES)
    if radio.log_receptions:
        frame_bytes += RECEPTION_LOG.itemsize * agents
    raw_s = agents * (recorded_s + FRAMES_S * frame_bytes)
    captures = {False: 0, True: 1, "medium": 1, "receivers": agents}[radio.capture]
    captured_s = agents * FRAMES_S * CAPTURED_BYTES * captures
    columns_s = agents * recorded_s * COLUMNS_SHARE
    return seconds * (raw_s * (1.0 + TABLES_SHARE) + columns_s + captured_s)


def space_warning(scenario: Scenario, folder: str, free_bytes: int) -> str | None:
    """Return a line if the folder's device may be full before the end of the run, else None."""
    expected = expected_bytes(scenario)
    if expected <= free_bytes:
        return None
    flight = f"{duration_text(scenario.run.duration_s)} of {scenario.agents} UAVs"
    return (
        f"{folder}: its device has {free_bytes / 1e6:.0f} MB left, and {flight} take about "
        f"{expected / 1e6:.0f} MB: the run may end early"
    )
