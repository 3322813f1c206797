"""The warning before a flight that a disk has no room for."""

from autopilot.logs.vehicle_record import VEHICLE_RECORD
from harness.launch.disk_space import COLUMNS_SHARE, TABLES_SHARE, expected_bytes, space_warning
from harness.records.tables import FLIGHT_RECORD, OF_QUADROTORS
from harness.scenario.scenario import RunConfig, Scenario
from harness.scenario.scenario_file import load
from netsim.model.config import RadioConfig


def scenario(*, agents=2, duration_s=500.0, **radio):
    return Scenario(name="t", agents=agents, run=RunConfig(duration_s=duration_s), radio=RadioConfig(**radio))


def test_the_estimate_has_the_order_of_measured_flights():
    """Two UAVs of the article wrote 27.1 MB of raw logs in 996 s, 16 s of them before their formation."""
    article = load("article", ["agents=2", "run.duration_s=980"])
    columns = 2 * 996 * 25 * FLIGHT_RECORD.itemsize
    measured = 27.1e6 * (1.0 + TABLES_SHARE) + columns
    assert 0.95 * measured < expected_bytes(article) < 1.2 * measured


def test_the_share_of_the_columns_covers_their_layout():
    assert FLIGHT_RECORD.itemsize <= COLUMNS_SHARE * (OF_QUADROTORS.itemsize + VEHICLE_RECORD.itemsize)


def test_it_grows_with_vehicles_duration_and_logs():
    base = expected_bytes(scenario())
    assert expected_bytes(scenario(agents=4)) == 2.0 * base
    assert expected_bytes(scenario(duration_s=1_000.0)) > 1.8 * base
    assert expected_bytes(scenario(log_receptions=True)) > base
    assert expected_bytes(scenario(capture="receivers")) > expected_bytes(scenario(capture=True)) > base


def test_a_small_disk_is_reported_in_one_line():
    assert space_warning(scenario(), "runs/a", 10**12) is None
    line = space_warning(scenario(), "runs/a", 3_000_000)
    assert line.startswith("runs/a: its device has 3 MB left, and 8 min ")
    assert line.endswith("MB: the run may end early")
