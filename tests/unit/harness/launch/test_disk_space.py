"""The warning before a flight that a disk has no room for."""

from harness.launch.disk_space import expected_bytes, space_warning
from harness.scenario.scenario import RunConfig, Scenario
from netsim.model.config import RadioConfig


def scenario(*, agents=2, duration_s=500.0, **radio):
    return Scenario(name="t", agents=agents, run=RunConfig(duration_s=duration_s), radio=RadioConfig(**radio))


def test_the_estimate_has_the_order_of_measured_flights():
    """Two UAVs wrote 27 MB of raw logs in 544 s."""
    assert 27e6 * 0.9 < expected_bytes(scenario(duration_s=484.0)) < 3.0 * 27e6


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
