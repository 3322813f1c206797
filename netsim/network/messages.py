"""Settings, commands and events of the process that hosts interfaces and programs of vehicles."""

from typing import Annotated, Literal

from msgspec import Meta, Struct

from foundation.processes.child_protocol import Stop
from netsim.network.bridge import WINDOW_PACKETS
from netsim.wire.messages import Station

NAME = "network"
"""Name of the process in its events."""
INTERFACE = "wlan0"
"""Name of each vehicle's interface on the radio."""
Interfaces = Literal["auto", "veth", "tap"]
"""Kind of ``wlan0``: end of a veth pair, or a TAP interface; "auto": a TAP if the kernel has no pairs."""
Restart = Literal["never", "on_failure", "always"]
Index = Annotated[int, Meta(ge=0)]
"""Position of a program in `NetworkConfig.programs`."""
Port = Annotated[int, Meta(ge=0, le=65_535)]


class ProgramConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A program on a vehicle."""

    name: str
    station: Station
    command: Annotated[tuple[str, ...], Meta(min_length=1)]
    """Program and arguments, without a shell; the program is searched in PATH."""
    log_path: str
    """File to which stdout and stderr are appended"""
    environment: dict[str, str] = {}
    """Variables added to those of the host process"""
    folder: str | None = None
    """Working folder; None: that of the host process"""
    restart: Restart = "never"
    """When it is started again: after an exit status other than 0 or a signal, or after every end."""


class CompanionLink(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The companion link of a vehicle's autopilot, over UDP on the host's loopback interface."""

    station: Station
    companion_host: str
    """IPv4 address to which the autopilot sends"""
    companion_port: Port
    """0: a free one, which `Ready.details` has, ``companion_ports``"""
    autopilot_host: str
    """IPv4 address at which the autopilot receives"""
    autopilot_port: Port
    """0: that from which it sends"""
    checks_owner: bool = True
    """Whether, with ``autopilot_port`` 0, the sender has to be of this user or of root"""


class NetworkConfig(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Settings of the process."""

    run_id: str
    endpoint: str
    """Zenoh endpoint of the emulator"""
    user: str
    """Zenoh user"""
    password: str
    stations: Annotated[tuple[Station, ...], Meta(min_length=1)]
    """Stations that have an interface, each once"""
    companions: tuple[CompanionLink, ...] = ()
    """Links to autopilots, one at most per station, which has ``eth0`` by it"""
    programs: tuple[ProgramConfig, ...] = ()
    """Programs, which are not started before a command"""
    interfaces: Interfaces = "auto"
    window_packets: Annotated[int, Meta(ge=1)] = WINDOW_PACKETS
    """Most packets of a station in the emulator"""


class StartPrograms(Struct, frozen=True, kw_only=True, tag="start programs", tag_field="command"):
    """Command: start programs that have not been started."""

    programs: tuple[Index, ...] | None = None
    """None: all"""


Command = StartPrograms | Stop


class ProgramStarted(Struct, frozen=True, kw_only=True, tag="program started", tag_field="event"):
    """A program has been started; it may still fail to be executed, with exit status 126 or 127."""

    program: int
    station: int
    pid: int
    """Process id in the namespace of the vehicles' processes"""


class ProgramEnded(Struct, frozen=True, kw_only=True, tag="program ended", tag_field="event"):
    """A program has ended."""

    program: int
    name: str
    station: int
    returncode: int
    """Exit status, or minus the signal that killed it; 126 and 127 as of a shell: it cannot be executed, it
    is not found"""
    ran_s: float
    restart_in_s: float | None = None
    """Wall time after which it is started again; None: it is not"""
    was_stopped: bool = False
    """Whether it ended after the command to stop"""


def check(config: NetworkConfig) -> None:
    """Raise ValueError if settings are inconsistent."""
    if len(set(config.stations)) != len(config.stations):
        raise ValueError("stations: each may occur once")
    companions = [each.station for each in config.companions]
    if len(set(companions)) != len(companions) or not set(companions) <= set(config.stations):
        raise ValueError("companions: each is of another station that has an interface")
    for index, program in enumerate(config.programs):
        if program.station not in config.stations:
            raise ValueError(f"programs[{index}].station: {program.station} has no interface")
        if not program.command[0] or any("\0" in argument for argument in program.command):
            raise ValueError(f"programs[{index}].command: no program, or a NUL character")
