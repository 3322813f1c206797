"""A scenario's ports: with an offset for a second swarm on the machine, or any free ones."""

import pytest

from harness.scenario.scenario import PortsConfig


def test_an_offset_is_added_to_all_ports_that_are_set():
    ports = PortsConfig(gcs_remote_udp=0)
    raised = ports.raised(100, agents=3)
    assert raised.numbers() == {name: base + 100 if base else 0 for name, base in ports.numbers().items()}
    assert raised.simulator_link == ports.simulator_link
    assert set(ports.free().numbers().values()) == {0}
    assert ports.free().host == ports.host
    # the last of three vehicles is two above the base
    assert ports.raised(65_533 - 18_570, agents=3).gcs_local_udp == 65_533
    with pytest.raises(ValueError, match=r"^a port offset of 46964: expected 0 to 46963, as ports end"):
        ports.raised(65_534 - 18_570, agents=3)
    with pytest.raises(ValueError, match=r"^a port offset of -5000: expected 0 to 46963"):
        ports.raised(-5_000, agents=3)
