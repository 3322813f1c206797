"""The DDS block of docs/how-to/middleware.md on two vehicles, which find each other by multicast."""

import sys

import pytest
from middleware_peers import block, receives_from_the_other

from netsim.network.namespaces import why_not

pytestmark = [
    pytest.mark.clients,
    pytest.mark.timeout(200),
    pytest.mark.skipif(why_not() is not None, reason=str(why_not())),
]


def test_dds_participants_of_two_vehicles_find_each_other(tmp_path) -> None:
    script = tmp_path / "dds_peer.py"
    script.write_text(block("from cyclonedds"))
    texts = [f"received {uav} " for uav in range(2)]
    frames = receives_from_the_other(tmp_path, [sys.executable, str(script), "{uav}"], texts)
    assert frames["group"] > 0
    assert frames["acknowledged"] > 0
