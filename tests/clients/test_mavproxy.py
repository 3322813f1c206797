"""MAVProxy without a window: on the ground station port of a swarm with --hold, and on vehicles."""

import os
import sys
import time
from pathlib import Path

import pytest
from swarms import ROOT, failures, findings

from harness.launch.swarm import Swarm
from harness.scenario.scenario_file import load
from netsim.network.namespaces import why_not

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


@pytest.mark.skipif(why_not() is not None, reason=str(why_not()))
def test_mavproxy_on_vehicles_sends_their_telemetry_to_another(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    with Swarm(ROOT / "examples" / "telemetry-relay" / "relay.toml", speed=1, out=tmp_path / "run") as swarm:
        log = swarm.path / "logs" / "uav-2-listener.log"
        wall_end_s = time.monotonic() + 60.0
        while log.read_text().count("in sight") < 2 and time.monotonic() < wall_end_s:
            swarm.run_for(0.5)
        swarm.stop()
        assert swarm.leftovers() == []
    seen = {line for line in log.read_text().splitlines() if line.endswith("in sight")}
    assert seen == {"system 1 in sight", "system 2 in sight"}  # not the listener's own vehicle, 3
