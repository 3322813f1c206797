"""Programs on vehicles that stand-ins for PX4 and ArduPilot fly receive their MAVLink on ``eth0``."""

import json
import sys
import time

import pytest
from ardupilot_swarms import make_swarm
from external_swarms import CALM
from px4_swarms import px4_swarms

from netsim.network.namespaces import why_not

pytestmark = [
    pytest.mark.multiprocess,
    pytest.mark.skipif(why_not() is not None, reason=str(why_not())),
]

LISTENER = (
    "from pymavlink import mavutil\n"
    "link = mavutil.mavlink_connection('udpin:0.0.0.0:14540')\n"
    "while True:\n"
    "    print('system', link.recv_match(type='HEARTBEAT', blocking=True).get_srcSystem(), flush=True)\n"
)
LIMIT_S = 30.0


@pytest.mark.parametrize("kind", ["px4", "ardupilot"])
def test_program_receives_the_autopilots_heartbeats(kind, tmp_path):
    listener = tmp_path / "listener.py"
    listener.write_text(LISTENER)
    command = json.dumps([sys.executable, str(listener)])
    options = (f"programs=[{{name='listener', uav=1, command={command}}}]", "onboard.enabled=false")
    if kind == "px4":
        scenario = tmp_path / "px4s.toml"
        scenario.write_text(CALM, encoding="ascii")
        flown = px4_swarms(tmp_path, scenario)(2, *options, speed=1.0, flies=True)
    else:
        flown = make_swarm(tmp_path, 2, *options, speed=1.0)
    with flown:
        log = flown.path / "logs" / "uav-1-listener.log"
        wall_end_s = time.monotonic() + LIMIT_S
        while "system" not in log.read_text() and time.monotonic() < wall_end_s:
            flown.run_for(0.5)
        assert log.read_text().splitlines()[:1] == ["system 2"]
    assert flown.leftovers() == []
