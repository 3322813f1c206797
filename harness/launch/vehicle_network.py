"""The network of a run's vehicles as the launcher sees it: settings of its process, and starts of programs.

`netsim.network` makes the namespaces and interfaces, runs the programs and bridges their packets.
"""

from collections.abc import Iterator
from ipaddress import IPv4Address
from pathlib import Path

import msgspec
import psutil
from msgspec import Struct

from autopilot.parameters.config import RadioEndpoint
from foundation.records.whole_file import write_whole
from harness.launch.run_messages import Message
from harness.scenario.programs import Start, VehicleProgram
from harness.scenario.scenario import Scenario
from harness.simulator.messages import Formed, Paused, Progress
from netsim.network.messages import CompanionLink, NetworkConfig, ProgramConfig
from netsim.transport.radio_users import packets_user


class _Holder(Struct, frozen=True):
    """A process that is in the namespaces of one vehicle."""

    pid: int
    started_s: float
    """Its start, as UNIX time; another process may get the number later"""


def network_config(scenario: Scenario, endpoint: RadioEndpoint, *, run_id: str, logs: Path) -> NetworkConfig:
    """Return the settings of the network's process; ``endpoint`` has the password of its user."""
    user = packets_user(endpoint.password)
    return NetworkConfig(
        run_id=run_id,
        endpoint=endpoint.locator,
        user=user.name,
        password=user.password,
        stations=tuple(range(scenario.agents)),
        companions=tuple(filter(None, (companion_link(scenario, uav) for uav in range(scenario.agents)))),
        programs=tuple(
            ProgramConfig(
                name=program.name,
                station=uav,
                command=program.command_of(uav),
                environment=program.environment_of(uav),
                folder=program.folder or None,
                log_path=str((logs / f"uav-{uav}-{program.name}.log").resolve()),
                restart=program.restart,
            )
            for uav, program in placed_programs(scenario)
        ),
        interfaces=scenario.network.interfaces,
        window_packets=scenario.radio.queue_frames,
    )


def companion_link(scenario: Scenario, uav: int) -> CompanionLink | None:
    """Return the companion link of a vehicle's autopilot that its programs use by ``eth0``.

    Port 0 of the companion, of an autopilot of coflight, is any free one. None if there is no link, or if it
    is of the application beside a PX4 or ArduPilot, or to another machine.
    """
    ports, links, kind = scenario.vehicle_ports(uav), scenario.links, scenario.autopilot.kind_of(uav)
    companion = autopilot = ports.host
    if kind == "own":
        companion = links.companion_host
        if not (IPv4Address(companion).is_loopback or companion == links.host):
            return None
        autopilot = companion if IPv4Address(links.host).is_unspecified else links.host
    elif scenario.onboard.enabled or not ports.companion_remote_udp:
        return None
    return CompanionLink(
        station=uav,
        companion_host=companion,
        companion_port=ports.companion_remote_udp,
        autopilot_host=autopilot,
        autopilot_port=0 if kind == "ardupilot" else ports.companion_local_udp,
        checks_owner=links.local_senders == "own",
    )


def placed_programs(scenario: Scenario) -> Iterator[tuple[int, VehicleProgram]]:
    """Yield the vehicle and the program of each start, in the order of their numbers."""
    for program in scenario.programs:
        for uav in program.vehicles(scenario.agents):
            yield uav, program


class ProgramStarts:
    """When the programs of a run are started; a core."""

    def __init__(self, scenario: Scenario) -> None:
        self._waiting: dict[int, tuple[int, Start]] = {
            number: (uav, program.start) for number, (uav, program) in enumerate(placed_programs(scenario))
        }

    def before_flight(self) -> tuple[int, ...]:
        """Return the numbers of the programs that are started before the flight."""
        return self._take({number for number, (_, start) in self._waiting.items() if start == "at_once"})

    def due(self, message: Message) -> tuple[int, ...]:
        """Return the numbers of the programs that are started because of a message."""
        if not self._waiting:
            return ()
        if isinstance(message, Formed):
            return self._take({number for number, (_, start) in self._waiting.items() if start == "formed"})
        if isinstance(message, Progress | Paused):
            return self._take(
                {
                    number
                    for number, (uav, start) in self._waiting.items()
                    if start == "armed" and message.vehicles[uav].armed
                }
            )
        return ()

    def _take(self, numbers: set[int]) -> tuple[int, ...]:
        for number in numbers:
            del self._waiting[number]
        return tuple(sorted(numbers))


def write_holders(path: Path, holders: dict[str, int]) -> None:
    """Write the processes by which `coflight shell` enters vehicles, for their owner. Raises OSError."""
    content = {uav: _Holder(pid, psutil.Process(pid).create_time()) for uav, pid in holders.items()}
    write_whole(path, msgspec.json.encode(content), private=True)


def read_holders(path: Path) -> dict[int, int]:
    """Return the living processes of `write_holders` by vehicle.

    Raises OSError without the file, and ValueError (as msgspec.DecodeError) for another content.
    """
    content = msgspec.json.decode(path.read_bytes(), type=dict[int, _Holder])
    return {uav: holder.pid for uav, holder in content.items() if _is_running(holder)}


def _is_running(holder: _Holder) -> bool:
    try:
        return bool(psutil.Process(holder.pid).create_time() == holder.started_s)
    except psutil.Error:
        return False
