"""Settings of the processes of ground stations on the radio, one for each station.

Each has a process of its own, since a Zenoh session has one user: its death is the loss of one station, by
name, and another is not affected.
"""

from harness.ground_station.settings import GroundStationConfig
from harness.launch.process_commands import ground_station
from harness.scenario.scenario import Scenario
from harness.simulator.response_watchdog import COMPUTING_LIMIT_S
from netsim.transport.guest_access import GuestLogin

GIVE_UP_MARGIN_S = 10.0
"""Wall time for which a ground station waits longer for the emulator than physics and the launcher do: those
name the emulator and end the run, of which a dead ground station would only be a consequence."""


def settings(
    scenario: Scenario, number: int, login: GuestLogin, *, endpoint: str, run_id: str
) -> GroundStationConfig:
    """Return the settings of the ground station of that number, from 0; ``endpoint`` is the emulator's.

    Its ports follow those of the ground stations before it.
    """
    ports, links, agents = scenario.ports, scenario.links, scenario.agents
    first = ports.gcs_local_udp + number * agents
    return GroundStationConfig(
        name=ground_station(scenario.ground_stations[number].name),
        run_id=run_id,
        endpoint=endpoint,
        user=login.user,
        password=login.password,
        station=login.station,
        answer_limit_s=max(COMPUTING_LIMIT_S, scenario.run.silence_limit_s) + GIVE_UP_MARGIN_S,
        local_ports=tuple(first + i if ports.gcs_local_udp else 0 for i in range(agents)),
        host=links.host,
        remote_host=links.ground_station_host,
        remote_port=ports.gcs_remote_udp + number if ports.gcs_remote_udp else 0,
        queue_frames=scenario.radio.queue_frames,
        queue_lifetime_us=scenario.radio.queue_lifetime_us,
        serial_modems=links.telemetry == "serial-radio",
        local_senders=links.local_senders,
    )
