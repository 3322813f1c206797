"""Settings of unmodified programs on vehicles, ``[[programs]]``, and of their network, ``[network]``."""

from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

from netsim.network.messages import Interfaces

UavNumber = Annotated[int, Meta(ge=0, le=253)]
Word = Annotated[str, Meta(min_length=1, max_length=4_096, pattern=r"^[^\x00]*$")]
"""An argument of a command: Linux ends it at a NUL."""
Text = Annotated[str, Meta(max_length=65_536, pattern=r"^[^\x00]*$")]
VariableName = Annotated[str, Meta(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]
Start = Literal["at_once", "armed", "formed"]
UAV = "{uav}"
"""Stands for the vehicle's number in commands and environments."""


class NetworkTable(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The ``[network]`` table: the network namespaces of the vehicles."""

    enabled: bool = False
    """Every vehicle has a network namespace, whose interface ``wlan0`` is on the emulated channel, also
    without ``[[programs]]``, which imply it."""
    interfaces: Interfaces = "auto"
    """Kind of ``wlan0``: "veth" or "tap"; "auto": a veth pair, or a TAP where the kernel makes no pairs."""


class VehicleProgram(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An unmodified program in the network namespaces of vehicles: one of ``[[programs]]``."""

    name: Annotated[str, Meta(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,39}$")]
    """Name in messages and of its log files, ``logs/uav-NUMBER-NAME.log``."""
    command: Annotated[tuple[Word, ...], Meta(min_length=1, max_length=256)]
    """Program and arguments; ``{uav}`` stands for the vehicle's number."""
    uav: Literal["all"] | UavNumber | tuple[UavNumber, ...] = "all"
    """Vehicles that it runs on."""
    environment: dict[VariableName, Text] = {}
    """Environment variables that are set or replaced; ``{uav}`` stands for the vehicle's number."""
    start: Start = "at_once"
    """``at_once``: before the flight; ``armed``: when its vehicle is armed first; ``formed``: when the
    formation is reached."""
    restart: Literal["never", "on_failure", "always"] = "never"
    """Whether a program that has ended is started again: after 0.5 s, and twice as late each time up to 10 s;
    after 10 s without an end the first delay is valid again."""
    folder: Text = ""
    """Working folder; "": that of the scenario's file."""

    def vehicles(self, agents: int) -> tuple[int, ...]:
        """Return the numbers of the vehicles that have it, of ``agents``."""
        if self.uav == "all":
            return tuple(range(agents))
        return (self.uav,) if isinstance(self.uav, int) else self.uav

    def command_of(self, uav: int) -> tuple[str, ...]:
        """Return program and arguments for a vehicle."""
        return tuple(word.replace(UAV, str(uav)) for word in self.command)

    def environment_of(self, uav: int) -> dict[str, str]:
        """Return the environment variables for a vehicle."""
        return {name: text.replace(UAV, str(uav)) for name, text in self.environment.items()}


def check(programs: tuple[VehicleProgram, ...], agents: int) -> None:
    """Raise ValueError, which begins with the field's path, for an unknown vehicle or two equal names."""
    numbers: dict[str, int] = {}
    for number, program in enumerate(programs):
        path = f"programs[{number}]"
        vehicles = program.vehicles(agents)
        if not vehicles or len(set(vehicles)) < len(vehicles):
            raise ValueError(f"{path}.uav: expected one or more UAVs, each once")
        for uav in vehicles:
            if uav >= agents:
                raise ValueError(f"{path}.uav: there is no UAV {uav} among {agents}")
        other = numbers.setdefault(program.name, number)
        if other != number:
            raise ValueError(f"{path}.name: programs[{other}] is called {program.name} too")


def with_folder(programs: tuple[VehicleProgram, ...], folder: Path) -> tuple[VehicleProgram, ...]:
    """Return the programs with absolute working folders, relative ones being below ``folder``.

    Raises ValueError, which begins with the field's path, for a folder that does not exist.
    """
    found = []
    for number, program in enumerate(programs):
        path = (folder / program.folder).resolve()
        if not path.is_dir():
            raise ValueError(f"programs[{number}].folder: there is no folder {path}")
        found.append(msgspec.structs.replace(program, folder=str(path)))
    return tuple(found)
