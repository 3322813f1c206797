"""MAVProxy without a window, on the ground station port of a swarm with --hold."""

import pytest
from swarms import ROOT, failures, findings

from harness.scenario.scenario_file import load

pytestmark = [pytest.mark.clients, pytest.mark.timeout(300)]


def test_a_session_of_mavproxy(hold, client, tmp_path) -> None:
    site = load(ROOT / "scenarios" / "article.toml").site
    # a single vehicle, since MAVProxy selects one vehicle on the port
    swarm = hold("--agents", "1")
    process = client(
        "mavproxy_session.py",
        swarm.ground_station_port,
        tmp_path,
        site.latitude_deg,
        site.longitude_deg,
        site.altitude_m,
    )
    assert failures(findings(process, wall_limit_s=240.0)) == []
    swarm.end()
